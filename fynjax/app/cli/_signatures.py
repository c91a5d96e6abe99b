"""What a job takes, read from its source: name, kind, default and description of its arguments.

The command line is made of this. Nothing is imported, so that help is there before JAX would be.
"""

import ast
import functools
import operator
import re
import textwrap
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import fynjax

_ROOT = Path(fynjax.__file__).parents[1]
REQUIRED = object()
"""The default of an argument that must be given."""


class Kind(NamedTuple):
    """What an argument takes, as far as a command line can give it."""

    of: type[bool] | type[int] | type[float] | type[str] = str
    file: bool = False
    """Whether the text may be the path of a file."""
    choices: tuple[str, ...] = ()
    least: float | None = None
    most: float | None = None
    counts: tuple[int, ...] | None = None
    """Of values with commas between, how many there may be, any number if empty; None: one."""
    repeated: bool = False
    """Whether several are taken, each by an option of its own."""


class Argument(NamedTuple):
    """An argument of a job, or a field of a record that is one."""

    name: str
    kind: Kind
    default: Any
    text: str
    """What the docstring says of it."""
    record: str | None = None
    """The argument that it is a field of."""
    position: bool = False
    """Whether it may be given without its name."""


class MadeOf(NamedTuple):
    """An argument of a job that is made of several options, its fields."""

    kind: str
    """Module and class."""
    needed: bool
    """Whether the job has no default for it."""
    usual: dict[str, Any]
    """Fields that the job's default has unlike the class."""


class Signature(NamedTuple):
    """What a job says of itself."""

    about: str
    """Its docstring up to the arguments."""
    returns: str
    arguments: tuple[Argument, ...]
    records: dict[str, MadeOf]
    """Arguments that are made of several options, by name."""


def signature_of(job: str) -> Signature:
    """The signature of a job.

    **Arguments:** `job`: module and function, such as "fynjax.app.jobs:render_plot".

    **Raises:** `LookupError` where there is no such function, where its docstring says nothing of
    an argument, and for an annotation or a default that this cannot read.
    """
    package, _, name = job.partition(":")
    module, node = _found(_module(package), name)
    if not isinstance(node, ast.FunctionDef):
        raise LookupError(f"{job} is no function")
    docstring = ast.get_docstring(node) or ""
    texts = _described(docstring)
    arguments: list[Argument] = []
    records: dict[str, MadeOf] = {}
    for argument, default, position in _arguments(node):
        if argument.arg not in texts:
            raise LookupError(f"the docstring of {job} says nothing of `{argument.arg}`")
        if argument.annotation is None:
            raise LookupError(f"`{argument.arg}` of {job} has no annotation")
        parts = list(_parts(module, argument.annotation))
        made_of = parts[0] if len(parts) == 1 else None
        if not isinstance(made_of, _Class):
            value = REQUIRED if default is None else _value(module, default)
            one = Argument(argument.arg, _kind(parts), value, texts[argument.arg])
            arguments.append(one._replace(position=position))
            continue
        kind, usual = f"{made_of.module.name}:{made_of.node.name}", _stated(module, default)
        records[argument.arg] = MadeOf(kind, default is None, usual)
        fields = _fields(made_of.module, made_of.node, argument.arg)
        arguments += [one._replace(default=usual.get(one.name, one.default)) for one in fields]
    about, _, rest = docstring.partition("**Arguments:**")
    returns = re.search(r"\*\*Returns:\*\*(.*?)(?=\n\*\*|\nExample:|\Z)", rest, re.DOTALL)
    said = returns[1].strip() if returns else ""
    return Signature(about.strip(), said, tuple(arguments), records)


def summary_of(job: str) -> str:
    """The first sentence of a job's docstring, without reading the rest of its source."""
    package, _, name = job.partition(":")
    pattern = rf'^def {name}\(.*?^    """(.*?)(?:\n\n|""")'
    for _ in range(3):
        module = _module(package)
        if found := re.search(pattern, module.text, re.MULTILINE | re.DOTALL):
            return " ".join(found[1].split())
        source = re.search(rf"^from (\S+) import (?:.*\b)?{name}\b", module.text, re.MULTILINE)
        if source is None:
            break
        package = module.absolute(source[1])
    raise LookupError(f"{job} has no docstring")


class _Module:
    """The source of a module, or the stub of a package."""

    def __init__(self, name: str) -> None:
        self.name = name
        path = _ROOT.joinpath(*name.split("."))
        self.package = path.is_dir()
        files = (path / "__init__.pyi", path / "__init__.py", path.with_suffix(".py"))
        file = next((file for file in files if file.is_file()), None)
        if file is None:
            raise LookupError(f"there is no module {name}")
        self.text = file.read_text("utf-8")

    @functools.cache  # noqa: B019 - modules are few, and kept
    def statement(self, name: str) -> ast.stmt:
        """Where a name is defined or imported at the top; the rest of the file is not read."""
        found = re.search(
            rf"^(?:def|class) {name}\b|^(?:\w+, )*{name}\b[^=\n]*=|"
            rf"^(?: {{4}})?from \S+ import (?:[^\n(]*|\([^)]*)\b{name}\b(?! as )",
            self.text,
            re.MULTILINE,
        )
        if found is None:
            raise LookupError(f"{self.name} has no {name}")
        end = re.compile(r"^[^\s)\]}]", re.MULTILINE).search(self.text, found.end())
        text = textwrap.dedent(self.text[found.start() : end and end.start()])
        return ast.parse(text).body[0]

    def absolute(self, name: str) -> str:
        """The full name of a module that is imported here."""
        inner = name.lstrip(".")
        up = len(name) - len(inner)
        if not up:
            return name
        parts = self.name.split(".")
        return ".".join([*parts[: len(parts) - up + self.package], inner])


@functools.cache
def _module(name: str) -> _Module:
    return _Module(name)


def _found(module: _Module, name: str) -> tuple[_Module, ast.AST]:
    """Where a name is defined, and the definition: of a constant, its value."""
    node = module.statement(name)
    if isinstance(node, ast.ImportFrom):
        source = module.absolute("." * node.level + (node.module or ""))
        if source.split(".")[0] != "fynjax":
            return module, node
        alias = next(alias for alias in node.names if (alias.asname or alias.name) == name)
        return _found(_module(source), alias.name)
    if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Tuple):
        names = [ast.unparse(one) for one in node.targets[0].elts]
        return module, node.value.elts[names.index(name)]  # type: ignore[attr-defined]
    value = getattr(node, "value", None)
    return module, node if value is None else value


def _arguments(node: ast.FunctionDef) -> Iterator[tuple[ast.arg, ast.expr | None, bool]]:
    """Arguments with their defaults, and whether they have a position."""
    places = [*node.args.posonlyargs, *node.args.args]
    defaults = [None] * (len(places) - len(node.args.defaults)) + node.args.defaults
    for argument, default in zip(places, defaults, strict=True):
        yield argument, default, True
    for argument, default in zip(node.args.kwonlyargs, node.args.kw_defaults, strict=True):
        yield argument, default, False


def _described(docstring: str) -> dict[str, str]:
    """What a docstring says of each argument."""
    part = docstring.partition("**Arguments:**")[2]
    part = re.split(r"\n\n(?!- )|\n\*\*", part.lstrip("\n"), maxsplit=1)[0]
    found: dict[str, str] = {}
    for item in re.split(r"^- ", textwrap.dedent(part), flags=re.MULTILINE)[1:]:
        names, _, text = item.partition(": ")
        found |= dict.fromkeys(re.findall(r"`(\w+)`", names), " ".join(text.split()))
    return found


class _Class(NamedTuple):
    """A class among the alternatives of an annotation."""

    module: _Module
    node: ast.ClassDef


class _Many(NamedTuple):
    """A sequence among the alternatives of an annotation."""

    parts: list[Any]
    items: int
    """How many, 0 for any number."""
    names: bool = False


class _Number(NamedTuple):
    of: type[int] | type[float]
    least: float | None = None
    most: float | None = None


_PLAIN = {"bool": bool, "int": _Number(int), "float": _Number(float), "str": str, "Path": Path}


def _parts(module: _Module, node: ast.expr) -> Iterator[Any]:
    """The alternatives of an annotation; None is left out."""
    if isinstance(node, ast.BinOp):
        nodes = _alternatives(node)
        text = any(isinstance(one, ast.Name) and one.id == "str" for one in nodes)
        for one in nodes:  # beside a text, objects are for Python alone
            if not (text and isinstance(one, ast.Name) and one.id not in {*_PLAIN, "Names"}):
                yield from _parts(module, one)
    elif isinstance(node, ast.Constant) and isinstance(node.value, str):
        yield from _parts(module, ast.parse(node.value, mode="eval").body)
    elif isinstance(node, ast.Name) and node.id in _PLAIN:
        yield _PLAIN[node.id]
    elif isinstance(node, ast.Name):
        where, meant = _found(module, node.id)
        if isinstance(meant, ast.ClassDef):
            yield _Class(where, meant)
        elif isinstance(meant, ast.expr):
            parts = list(_parts(where, meant))
            yield from ([p._replace(names=True) for p in parts] if node.id == "Names" else parts)
        # What another package defines, no text is.
    elif isinstance(node, ast.Subscript):
        yield from _subscript(module, ast.unparse(node.value), node.slice)
    elif not (isinstance(node, ast.Constant) and node.value is None):
        raise LookupError(f"{module.name}: no option can be of the type {ast.unparse(node)}")


def _alternatives(node: ast.expr) -> list[ast.expr]:
    if not isinstance(node, ast.BinOp):
        return [node]
    return [*_alternatives(node.left), *_alternatives(node.right)]


def _subscript(module: _Module, name: str, inside: ast.expr) -> Iterator[Any]:
    items = inside.elts if isinstance(inside, ast.Tuple) else [inside]
    if name == "Literal":
        yield tuple(_value(module, item) for item in items)
    elif name == "Annotated":
        bounds = {}
        for call in items[1:]:
            for word in getattr(call, "keywords", ()):
                if word.arg not in _BOUNDS:
                    raise LookupError(f"{module.name}: bounds are ge and le, no {word.arg}")
                bounds[_BOUNDS[word.arg]] = _value(module, word.value)
        yield from (part._replace(**bounds) for part in _parts(module, items[0]))
    elif name == "Sequence":
        yield _Many(list(_parts(module, items[0])), 0)
    elif name == "tuple":
        yield _Many(list(_parts(module, items[0])), len(items))
    else:
        raise LookupError(f"{module.name}: no option can be of the type {name}")


_BOUNDS = {"ge": "least", "le": "most"}


def _kind(parts: list[Any]) -> Kind:
    """What a command line can give of alternatives: texts again and again, numbers and `Names` with
    commas between, pairs of numbers both."""
    many = [part for part in parts if isinstance(part, _Many)]
    if not many:
        return _single(parts)
    inner = [part for one in many for part in one.parts]
    pairs = [part for part in inner if isinstance(part, _Many)]
    if pairs:
        one = _kind(pairs)
        return one._replace(repeated=True)
    one = _single(inner)
    if one.of is str and not any(part.names for part in many):
        return one._replace(repeated=True)
    counts = {part.items for part in many}
    alone = any(isinstance(part, _Number) for part in parts)
    return one._replace(counts=() if 0 in counts else tuple(sorted({*counts, *([1] * alone)})))


def _single(parts: list[Any]) -> Kind:
    choices = [choice for part in parts if type(part) is tuple for choice in part]
    numbers = [part for part in parts if isinstance(part, _Number)]
    if choices:
        return Kind(choices=tuple(choices))
    if str in parts or Path in parts:
        return Kind(file=Path in parts)
    if bool in parts:
        return Kind(bool)
    if not numbers:
        raise LookupError(f"no option can be any of {parts}")
    widest = max(numbers, key=lambda number: number.of is float)
    return Kind(widest.of, least=widest.least, most=widest.most)


def _fields(module: _Module, node: ast.ClassDef, of: str) -> Iterator[Argument]:
    """The fields of a record as arguments; those of a `TypedDict` need not be given."""
    for one, after in zip(node.body, [*node.body[1:], ast.Pass()], strict=True):
        if not isinstance(one, ast.AnnAssign) or not isinstance(one.target, ast.Name):
            continue
        name = one.target.id
        said = after.value if isinstance(after, ast.Expr) else None
        if not isinstance(said, ast.Constant) or not isinstance(said.value, str):
            raise LookupError(f"{node.name} says nothing of `{name}`")
        default = None if one.value is None else _value(module, one.value)
        kind = _kind(list(_parts(module, one.annotation)))
        yield Argument(name, kind, default, " ".join(said.value.split()), of)


def _stated(module: _Module, node: ast.AST | None) -> dict[str, Any]:
    """What a call of a record states of its fields, by name."""
    if isinstance(node, ast.Name):
        return _stated(*_found(module, node.id))
    if not isinstance(node, ast.Call):
        return {}
    return {str(word.arg): _value(module, word.value) for word in node.keywords}


_OPERATORS = {ast.Add: operator.add, ast.Sub: operator.sub, ast.Mult: operator.mul,
              ast.Pow: operator.pow, ast.Div: operator.truediv}  # fmt: skip


def _value(module: _Module, node: ast.AST) -> Any:
    """The value of a constant."""
    if isinstance(node, ast.Name):
        return _value(*_found(module, node.id))
    if isinstance(node, ast.Tuple | ast.List):
        return tuple(_value(module, item) for item in node.elts)
    if isinstance(node, ast.BinOp) and type(node.op) in _OPERATORS:
        return _OPERATORS[type(node.op)](_value(module, node.left), _value(module, node.right))
    try:
        return ast.literal_eval(node)
    except ValueError:
        raise LookupError(f"{module.name}: no constant is {ast.unparse(node)}") from None
