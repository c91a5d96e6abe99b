"""What the documentation site takes from its owners when it is built.

A line such as `{{ options build }}` in a page is replaced by what a function below makes of the
package: options of a command, keys of a file, parameters, sensors, citations. Pages of the API, of
notebooks and of the project's own files are made here too.

The notebooks are run and shown with their figures, which takes some ten minutes; with
`FYNJAX_DOCS_RUN=0` in the environment their pages have code and text alone.
"""

import importlib
import json
import os
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Literal, get_args, get_origin

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = (
    "fynjax",
    "fynjax.app.jobs",
    "fynjax.leaf",
    "fynjax.canopy",
    "fynjax.canopy.forms",
    "fynjax.canopy.mesh",
    "fynjax.metrics",
    "fynjax.metrics.structure",
    "fynjax.diversity",
    "fynjax.radiation",
    "fynjax.sensors",
    "fynjax.sensors.air",
    "fynjax.sensors.lidar",
    "fynjax.scene",
    "fynjax.inversion",
    "fynjax.app.io.plot",
    "fynjax.app.io.raster",
    "fynjax.app.io.spectra",
    "fynjax.app.io.instruments",
    "fynjax.app.io.captures",
    "fynjax.app.io.frames",
    "fynjax.app.io.text",
    "fynjax.app.terrain",
    "fynjax.app.compare",
    "fynjax.app.compare.structure",
    "fynjax.app.assembly",
    "fynjax.app.report.figures",
    "fynjax.app.report.pages",
    "fynjax.studies.fynbos_2006",
    "fynjax.studies.bioscape",
    "fynjax.studies.communities",
    "fynjax.errors",
)
"""Public packages, in the order of the layers."""
PROJECT_FILES = {"contributing.md": "CONTRIBUTING.md", "changes.md": "CHANGELOG.md"}
"""Pages that are files of the project, by their name on the site."""


def table(headings: tuple[str, ...], rows: list[tuple[str, ...]]) -> str:
    """A Markdown table of texts."""
    lines = [headings, ("---",) * len(headings), *rows]
    return "\n".join(f"| {' | '.join(map(plain, line))} |" for line in lines)


def described(headings: tuple[str, ...], rows: list[tuple[str, ...]]) -> str:
    """A table of names and what they mean, whose second column keeps a width to read."""
    return f'<div class="described" markdown>\n\n{table(headings, rows)}\n\n</div>'


def plain(text: str) -> str:
    """Words on one line, in which nothing outside code is taken for Markdown or a link."""
    parts = re.split(r"(`[^`]*`)", " ".join(text.split()))
    parts[::2] = [re.sub(r"(?<=\])(\s?)\[", r"\1\\[", part) for part in parts[::2]]
    parts[::2] = [re.sub(r"([*<])", r"\\\1", part) for part in parts[::2]]
    return "".join(parts).replace("|", r"\|")


def code(value: object) -> str:
    """A value in the letters of code; nothing where there is none."""
    return "" if value is None or value == "" else f"`{value}`"


# The command line.


def commands() -> dict[str, Any]:
    """Every command by name, as the command line holds it."""
    from fynjax.app.cli._commands import COMMANDS
    from fynjax.app.cli._doors import made

    return {command.name: made(command.name) for command in COMMANDS}


def page_of(name: str) -> str:
    """File of a command's page."""
    return f"{name.replace(' ', '-')}.md"


def options(name: str) -> str:
    """Arguments and options of a command, from its own help."""
    rows = []
    for item in commands()[name].params:
        names = ", ".join(code(o) for o in item.opts)
        if item.param_type_name == "argument":
            names = code(item.metavar or item.name.upper())
        default = item.default
        unset = default is None or default is False or default == ""
        shown = code(" ".join(map(str, default)) if isinstance(default, (list, tuple)) else default)
        words = item.help or ""
        kind = item.type_descriptor.annotation
        if get_origin(kind) is Literal:
            words += f" One of {', '.join(map(code, get_args(kind)))}."
        rows.append((names, words, "required" if item.required else "" if unset else shown))
    return "## Arguments and options\n\n" + described(("name", "meaning", "default"), rows)


def usage(name: str) -> str:
    """First words and example of a command's help."""
    text = commands()[name].help
    words, _, example = text.partition("Example:")
    return f"{words.strip()}\n\n```sh\n{example.strip()}\n```"


# Files.


def _limits(entry: dict[str, Any]) -> str:
    lower = next((f"{sign} {entry[k]:g}" for k, sign in _LOWER.items() if k in entry), "")
    upper = next((f"{sign} {entry[k]:g}" for k, sign in _UPPER.items() if k in entry), "")
    if lower.startswith("≥") and upper.startswith("≤"):
        return f"{lower[2:]} to {upper[2:]}"
    return ", ".join(limit for limit in (lower, upper) if limit)


_LOWER = {"minimum": "≥", "exclusiveMinimum": ">"}
_UPPER = {"maximum": "≤", "exclusiveMaximum": "<"}
_KINDS = {"string": "text", "number": "number", "integer": "whole number", "boolean": "true, false"}


def _kind(entry: dict[str, Any], tables: dict[str, Any]) -> str:
    if "$ref" in entry:
        return f"table {code(entry['$ref'].rsplit('/', 1)[-1])}"
    if "const" in entry or "enum" in entry:
        return ", ".join(code(value) for value in entry.get("enum", [entry.get("const")]))
    kind = entry.get("type", "")
    if kind == "array":
        items = _kind(entry["items"], tables) if entry.get("items") else "number"
        return f"list of {items}"
    if kind == "object":
        inner = entry.get("additionalProperties", {})
        return f"table of {_kind(inner, tables)}s by name" if inner else "table"
    return _KINDS.get(kind, kind)


def _key_table(schema: dict[str, Any], tables: dict[str, Any], key: str) -> str:
    rows = []
    for name, stated in schema.get("properties", {}).items():
        choices = [e for e in stated.get("anyOf", [stated]) if e.get("type") != "null"]
        limits = next((text for e in choices if (text := _limits(e))), "")
        default = stated.get("default")
        shown = "" if default is None else code(json.dumps(default, ensure_ascii=False))
        if name in schema.get("required", ()):
            shown = "required"
        kinds = " or ".join(dict.fromkeys(_kind(e, tables) for e in choices))
        unit = stated.get("unit", "")
        words = stated.get("description", "")
        rows.append((code(name), words, kinds, "" if unit == "-" else unit, limits, shown))
    return described((key, "meaning", "value", "unit", "range", "default"), rows)


def _references(entry: dict[str, Any]) -> list[tuple[str, bool]]:
    """Tables of the schema that a key may hold, and whether it is a list of them."""
    if "$ref" in entry:
        return [(entry["$ref"].rsplit("/", 1)[-1], False)]
    if "$ref" in entry.get("items", {}):
        return [(entry["items"]["$ref"].rsplit("/", 1)[-1], True)]
    choices = entry.get("anyOf", entry.get("oneOf", ()))
    return [reference for choice in choices for reference in _references(choice)]


def keys(name: str) -> str:
    """Every key of a file, or every column of a table, from the schema of its model."""
    from fynjax.app.jobs._schemas import json_schema

    schema = json_schema(name)
    tables = schema.get("$defs", {})

    def sections(entry: dict[str, Any], path: str) -> Iterator[str]:
        inner = {k: r for k, v in entry.get("properties", {}).items() if (r := _references(v))}
        plain = {k: v for k, v in entry.get("properties", {}).items() if k not in inner}
        if plain:
            if path:
                yield f"### `{path}`\n\n{entry.get('description', '')}"
            yield _key_table({**entry, "properties": plain}, tables, "column" if row else "key")
        for key, references in inner.items():
            below = f"{path.strip('[]')}.{key}".strip(".")
            for reference, many in references:
                yield from sections(tables[reference], f"[[{below}]]" if many else f"[{below}]")

    row = name.endswith("_row")
    return "\n\n".join(sections(schema, ""))


# Physics.


def parameters() -> str:
    """Every parameter with what its record says, by group."""
    from fynjax.scene import parameter_reference

    def number(value: float, unit: str = "") -> str:
        return "" if value != value else f"{value:g} {'' if unit == '-' else unit}".strip()

    text = []
    titles = {"species": "Plants", "leaf": "Leaves", "ground": "Ground", "light": "Sun and sky"}
    for group, rows in parameter_reference().groupby("group", sort=False):
        text.append(f"## {titles[group]}")
        for row in rows.to_dict("records"):
            prior = number(row["prior_sd"], row["unit"])
            if row["prior_relative_sd"] == row["prior_relative_sd"]:
                prior = f"{row['prior_relative_sd']:.0%} of the value"
            cells = (
                code(row["symbol"]),
                "" if row["unit"] == "-" else row["unit"],
                "" if row["shown_unit"] == "-" else row["shown_unit"],
                number(row["default"]),
                f"{row['lower']:g} to {row['upper']:g}",
                f"{row['usual_lower']:g} to {row['usual_upper']:g}",
                prior or "cannot be free",
            )
            source = f"*Source:* {row['source']}"
            headings = ("symbol", "unit", "unit in files", "default", "bounds", "usual", "prior sd")
            text += [f"### {row['name']}", f"`{row['parameter']}`. {row['description']}", source]
            text.append(table(headings, [cells]))
    return "\n\n".join(text)


def forms() -> str:
    """What is taken for a growth form where a table states nothing."""
    from fynjax.canopy import FORMS

    shown = ("leaf_area_index", "wood_area_index", "shoot_clumping", "dead_fraction")
    rows = [
        (code(form), *(f"{getattr(values, field):.3g}" for field in shown))
        for form, values in FORMS.items()
    ]
    return table(("growth form", *(field.replace("_", " ") for field in shown)), rows)


def form_gallery() -> str:
    """Each growth form: pictures, real plants and defaults."""
    from fynjax.canopy import FORMS

    text = []
    for form, one in FORMS.items():
        genera = " ".join([one.flat_leaved.genera, one.round_leaved.genera]).split()
        families = " ".join([one.flat_leaved.families, one.round_leaved.families]).split()
        plants = f"*Plants:* {', '.join(sorted(genera)) or 'any that are dead'}"
        plants += f"; {', '.join(sorted(families))}." if families else "."
        leaf = f"{one.leaf_area_index:.3g}, of which {100 * one.dead_fraction:.0f} % dead or woody"
        usual = (
            f"*Where a table states nothing:* {100 * one.diameter:.3g} cm wide, "
            f"{100 * one.height:.3g} cm high; leaf area index within the crown {leaf}; leaf angles "
            f"{one.leaf_angle}; {one.leaf_mass_per_area:.3g} g m-2 of dry mass."
        )
        picture = f"![{form} from the side and from above](images/form_{form}.png)"
        text += [f"## {form}", picture, plain(one.description), plants, usual]
    return "\n\n".join(text)


def sensors() -> str:
    """The shipped sensors."""
    from fynjax.sensors import sensor_reference

    rows = []
    for row in sensor_reference().to_dict("records"):
        ends = dict.fromkeys(f"{row[end]:.0f}" for end in ("lower_nm", "upper_nm"))
        height = "" if row["altitude_m"] != row["altitude_m"] else f"{row['altitude_m']:g}"
        cells = str(row["bands"]), " to ".join(ends), f"{row['pixel_m']:.2g}", height
        rows.append((code(row["name"]), str(row["kind"]), *cells))
    return table(("name", "kind", "bands", "nm", "pixel, m", "flown at, m"), rows)


def band_terms() -> str:
    """Letters of the formulas of vegetation indices."""
    from fynjax.metrics import BAND_TERMS

    rows = [
        (
            code(letter),
            term.word.replace("_", " "),
            f"{term.shortest:g} to {term.longest:g}",
            f"{term.widest:g}",
            f"{term.usual:g}",
            " to ".join(f"{end:g}" for end in term.window),
        )
        for letter, term in BAND_TERMS.items()
    ]
    return table(
        ("letter", "", "centre, nm", "at most wide, nm", "usual centre, nm", "of spectra, nm"), rows
    )


def indices() -> str:
    """The vegetation indices, and which shipped sensors give them."""
    from fynjax.metrics import VEGETATION_INDICES, index_bands
    from fynjax.sensors import shipped_sensor, shipped_sensors

    names = [name for name in shipped_sensors() if not name.endswith("_paper")]
    given = {name: index_bands(shipped_sensor(name).bands) for name in names}
    spectrometers = [name for name in names if len(shipped_sensor(name).bands) > 20]

    def of(index: str) -> str:
        have = [name for name in names if index in given[name]]
        short = {tuple(names): "all", tuple(spectrometers): "spectrometers"}.get(tuple(have))
        others = [code(name) for name in have if name not in spectrometers]
        return short or ", ".join(["spectrometers", *others])

    rows = [
        (code(name), code(index.formula), plain(index.source), of(name))
        for name, index in VEGETATION_INDICES.items()
    ]
    return table(("name", "formula", "source", "sensors"), rows)


def citations() -> str:
    """BibTeX of all models."""
    import fynjax

    return f"```bibtex\n{fynjax.cite()}\n```"


# The project's own files.


_OWNERS: dict[str, Callable[..., str]] = {
    function.__name__: function
    for function in (
        *(options, usage, keys, parameters, forms, form_gallery, sensors, band_terms, indices),
        citations,
    )
}
_LINE = re.compile(r"^\{\{ (\w+)(?: ([\w -]+?))? \}\}$", re.MULTILINE)


def filled(markdown: str) -> str:
    """A page with its `{{ ... }}` lines replaced."""
    return _LINE.sub(lambda m: _OWNERS[m[1]](*filter(None, [m[2]])), markdown)


def public_names(package: str) -> list[str]:
    """Names that a package exports, without packages inside it."""
    module = importlib.import_module(package)
    names = getattr(module, "__all__", None) or [n for n in vars(module) if n[0] != "_"]
    inner = [n for n in names if type(getattr(module, n)).__name__ == "module"]
    return [n for n in names if n not in inner]


def api_page(package: str) -> str:
    """API of a package: its docstring, every public name, and its constants with their values."""
    module = importlib.import_module(package)
    values = {name: getattr(module, name) for name in public_names(package)}
    constants = {k: v for k, v in values.items() if isinstance(v, str | int | float)}
    parts = [f"# {package}", module.__doc__ or ""]
    parts += [f"::: {package}.{name}" for name in values if name not in constants]
    if constants:
        parts.append("## Constants")
        parts.append(table(("name", "value"), [(code(k), code(v)) for k, v in constants.items()]))
    return "\n\n".join(parts) + "\n"


def notebook_page(path: Path, folder: str) -> tuple[str, dict[str, bytes]]:
    """A notebook as Markdown, and its figures by file; run unless the environment says no."""
    import nbformat
    from nbconvert import MarkdownExporter

    notebook = nbformat.read(path, as_version=4)
    notebook.metadata["language_info"] = {"name": "python"}  # which colours the code
    if os.environ.get("FYNJAX_DOCS_RUN") != "0":
        import tempfile

        from nbclient import NotebookClient

        os.environ["MPLBACKEND"] = "module://matplotlib_inline.backend_inline"
        with tempfile.TemporaryDirectory() as place:
            resources = {"metadata": {"path": place}}
            NotebookClient(notebook, timeout=900, resources=resources).execute()
    text, resources = MarkdownExporter().from_notebook_node(
        notebook, resources={"unique_key": path.stem}
    )
    # Links to pages, and from one notebook to another.
    text = text.replace("](../docs/", "](../").replace(".ipynb)", ".md)")
    return text, {f"{folder}/{name}": data for name, data in resources.get("outputs", {}).items()}


def _project_page(name: str) -> str:
    """A file of the project, its links set to the pages of the site."""
    text = (ROOT / name).read_text("utf-8")
    return text.replace("(docs/", "(")


# mkdocs calls what follows.


def on_config(config: Any) -> Any:
    """Complete the navigation with what is generated."""
    generated = {
        "Commands": ["commands/index.md", *(f"commands/{page_of(name)}" for name in commands())],
        "Notebooks": [f"notebooks/{p.stem}.md" for p in notebooks()],
        "Python": [{package: f"api/{package}.md"} for package in PACKAGES],
    }
    for entry in config.nav:
        for title, pages in generated.items():
            if title in entry:
                entry[title] = [*(entry[title] or []), *pages]
    return config


def notebooks() -> list[Path]:
    """The notebooks in their order."""
    return sorted((ROOT / "notebooks").glob("*.ipynb"))


def on_files(files: Any, config: Any) -> Any:
    """Add the generated pages."""
    from mkdocs.structure.files import File

    def add(path: str, content: str | bytes) -> None:
        files.append(File.generated(config, path, content=content))

    for package in PACKAGES:
        add(f"api/{package}.md", api_page(package))
    for path in notebooks():
        text, figures = notebook_page(path, "notebooks")
        add(f"notebooks/{path.stem}.md", text)
        for name, data in figures.items():
            add(name, data)
    for page, name in PROJECT_FILES.items():
        add(page, _project_page(name))
    return files


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Fill in what a page takes from its owners."""
    if page.file.src_uri == "architecture.md":
        markdown = markdown.replace("(../CONTRIBUTING.md", "(contributing.md")
    return filled(markdown)
