"""From a pydantic complaint to one sentence: what was expected, what came, the likely slip."""

import re
import types
import typing
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError
from pydantic.fields import FieldInfo
from pydantic_core import ErrorDetails

from fynjax._core.errors import InputError, did_you_mean, is_odd_number, listed
from fynjax._core.records import Refused, Strict

Row = TypeVar("Row", bound=BaseModel)


def columns(model: type[BaseModel]) -> dict[str, FieldInfo]:
    """The fields of a record by the names that files have for them."""
    return {field.alias or name: field for name, field in model.model_fields.items()}


def is_note(column: str) -> bool:
    """Whether a column of a table holds what its writer notes, which nothing reads: its name begins
    with "note"."""
    return column.strip().lower().startswith("note")


def _bounds(field: FieldInfo) -> str:
    limit: dict[str, Any] = {}
    for entry in field.metadata:
        for name in ("gt", "ge", "lt", "le"):
            if (value := getattr(entry, name, None)) is not None:
                limit[name] = value
    low = limit.get("ge", limit.get("gt"))
    high = limit.get("le", limit.get("lt"))
    if low is None and high is None:
        return ""
    if high is None:
        return f" {'above' if 'gt' in limit else 'of at least'} {low:g}"
    if low is None:
        return f" {'below' if 'lt' in limit else 'of at most'} {high:g}"
    start = f"above {low:g}" if "gt" in limit else f"from {low:g}"
    return f" {start} to {'below ' if 'lt' in limit else ''}{high:g}"


def expected(field: FieldInfo) -> str:
    """What a field takes, in words: kind, range, unit or choices."""
    kinds: Any = [field.annotation]
    if typing.get_origin(field.annotation) in (typing.Union, types.UnionType):
        kinds = [k for k in typing.get_args(field.annotation) if k is not type(None)]
    if typing.get_origin(kinds[0]) is typing.Literal:
        return "one of " + ", ".join(repr(v) for v in typing.get_args(kinds[0]))
    extra = field.json_schema_extra if isinstance(field.json_schema_extra, dict) else {}
    unit = str(extra.get("unit", "-"))
    if kinds[0] in (int, float) and len(kinds) == 1:
        kind = "a whole number" if kinds[0] is int else "a number"
        return kind + _bounds(field) + ("" if unit == "-" else f" {unit}")
    text = " ".join((field.description or "a value").split()).rstrip(".")
    return text[0].lower() + text[1:]


def _number(value: Any) -> float | None:
    if isinstance(value, bool) or (isinstance(value, str) and is_odd_number(value)):
        return None
    try:
        return float(value)
    except (OverflowError, TypeError, ValueError):
        return None


def _as_given(value: Any) -> Any:
    """A value, or a list of values, of a record's field with every `Refused` number as the user
    wrote it."""
    if isinstance(value, list):
        return [_as_given(one) for one in value]
    return value.given if isinstance(value, Refused) else value


def shown(value: Any) -> str:
    """A value as the user wrote it, cut short."""
    text = repr(value) if isinstance(value, str) else str(value)
    text = text.lower() if isinstance(value, bool) else text
    return text if len(text) <= 60 else text[:57] + "..."


_SLIPS = tuple(
    (re.compile(pattern, re.IGNORECASE), slip)
    for pattern, slip in (
        (r"[r+]|[1-5][abm]", "A cover class? Write the middle of the class in percent."),
        (
            r"[+-]?\d{1,3}([.,' \xa0\u202f\u2019]\d{3})+([.,]\d+)?",
            "Marks between thousands? Leave them out.",
        ),
        (r"[+-]?\d+(_\d+)+\.?\d*", "Marks between thousands? Leave them out."),
        (r"(<|>|=|≤|≥|~|≈|ca?\.?)+ *[\d.,]+ *%?", "A limit? Write the number to take for it."),
        (r"tr(ace)?s?\.?|present|x", "Write the number to take for it."),
        (r"[\d.,]+ *(-|–|—|\.\.+|to|bis) *[\d.,]+ *%?", "A range? Write one number, its middle."),
        (r"[\d.,]+ *(±|\+/?-).*", "Write the number alone, without its error."),
        (r"#[\w/]+[!?]?", "An error of the spreadsheet: mend its formula."),
        (r"n[./]?[ad]\.?|nan|none|null|-+|\?+|", "Not measured? Leave it, or its row, out."),
        (r"[\[(]?([cmnµu]?m|%|°|deg|m2|g)[\])]?", "A row of units? Leave it out."),
        (r"[−–—][\d.,]+", "Write the minus as a hyphen."),
        (r"[\d.,]*[OlI][\d.,OlI]*", "A letter for a digit?"),
    )
)


def number_slip(cell: str) -> str:
    """What a text that stands for no number was probably meant to be; begins with a blank.

    **Arguments:** `cell`, as the user wrote it.
    """
    text = cell.strip()
    comma = ""
    if "," in text and _number(text.replace(",", ".")) is not None:
        comma = f" A decimal comma? Write {text.replace(',', '.')}."
        if not re.fullmatch(r"[+-]?[1-9]\d{0,2},\d{3}", text):
            return comma
    for pattern, slip in _SLIPS:
        if pattern.fullmatch(text):
            return f"{comma} {slip}"
    head = text.rstrip("%abcdefghijklmnopqrstuvwxyzµ²/ ")
    if head and head != text and _number(head) is not None:
        # The written unit may be another than the expected one.
        unit = text[len(head) :].strip()
        shown_so = " Or format the cells of the workbook as numbers." if unit == "%" else ""
        return (
            f" Leave out the unit, {unit!r}: write the number alone, in the unit that is expected."
            f"{shown_so}"
        )
    return ""


def sentence(error: ErrorDetails, model: type[BaseModel], name: str) -> str:
    """One sentence of a validation error: what was expected, what came, and the likely slip.

    **Arguments:**

    - `error`: as pydantic gives it.
    - `model`: the record that was refused.
    - `name`: of the field.
    """
    kind, value = error["type"], _as_given(error["input"])
    known = columns(model)
    if kind == "extra_forbidden":
        return f"unknown name {name!r}.{did_you_mean(name, known)} Known: {', '.join(known)}."
    field = known.get(name)
    if kind == "missing":
        return f"expected {name!r} ({expected(field) if field else 'a value'}), but it is missing"
    if kind == "value_error":
        return str(error["ctx"]["error"])
    if kind == "union_tag_invalid":
        known_tags, tag = error["ctx"]["expected_tags"], error["ctx"]["tag"]
        near = did_you_mean(tag, known_tags.replace("'", "").split(", "))
        return f"expected one of {known_tags}, but got {tag!r}.{near}"
    if kind == "union_tag_not_found":
        return f"expected {name!r}, which says what the other keys are, but it is missing"
    if field is None:
        return f"{error['msg']}, but got {shown(value)}"
    hint = ""
    if isinstance(value, str):
        hint = number_slip(value)
        options = expected(field)
        if options.startswith("one of"):
            hint = did_you_mean(value, [o.strip().strip("'") for o in options[7:].split(",")])
    if (n := _number(value)) is not None and issubclass(model, Strict):
        slip = model.slips.get(name)
        hint = f" {s}" if slip is not None and (s := slip(n)) else hint
    as_written = f"{n:g}" if (n is not None and n == n) else shown(value)
    return f"expected {expected(field)}, but got {as_written}.{hint}"


def first_error(error: ValidationError) -> ErrorDetails:
    """The part of a validation `error` to show first.

    Unknown names come first, as they explain missing ones; then missing names, then values.
    """
    errors = error.errors(include_url=False)
    return min(errors, key=lambda e: (e["type"] != "extra_forbidden", e["type"] != "missing"))


def checked_row(
    model: type[Row],
    given: Mapping[str, Any],
    *,
    file: Path | None = None,
    row: int | None = None,
    within: Path | None = None,
) -> Row:
    """A record of what a row of a table states.

    **Arguments:** `model`: class of the record; `given`: values by column, without those of empty
    cells; `file`, `row`: that hold it; `within`: folder in which files must lie that a `NamedFile`
    of the record names.

    **Raises:** `InputError` with the column, what was expected, what came and the likely slip.
    """
    context = None if file is None else {"owner": file, "within": within}
    try:
        return model.model_validate(given, context=context)
    except ValidationError as error:
        first = first_error(error)
        name = str(first["loc"][0]) if first["loc"] else None
        raise InputError(
            sentence(first, model, name or ""), file=file, row=row, column=name
        ) from error


def checked_rows(
    given: Iterable[tuple[int, Mapping[str, Any]]],
    model: type[Row],
    file: Path | None = None,
    *,
    within: Path | None = None,
) -> list[tuple[int, Row]]:
    """Records of the rows of a table, each with its number.

    **Arguments:** `given`: number of each row, and its values as `checked_row` takes them; `model`:
    class of the record; `file`: that holds the table; `within`: as of `checked_row`.

    **Raises:** `InputError` as `checked_row`, and for rows that share what must be `unique`.
    """
    rows: list[tuple[int, Row]] = []
    first: dict[Any, int] = {}
    rules = model if issubclass(model, Strict) else Strict
    key = rules.unique
    if rules.of_table.__func__ is not Strict.of_table.__func__:  # type: ignore[attr-defined]
        numbered = list(given)
        whole = rules.of_table([dict(cells) for _, cells in numbered])
        given = zip((number for number, _ in numbered), whole, strict=True)
    for number, cells in given:
        row = checked_row(model, cells, file=file, row=number, within=within)
        value = None if key is None else getattr(row, key)
        if value is not None and first.setdefault(value, number) != number:
            raise InputError(
                f"{value!r} is there twice, first in row {first[value]}. {rules.if_twice}".rstrip(),
                file=file,
                row=number,
                column=key,
            )
        rows.append((number, row))
    return rows


def check_header(header: Sequence[str], model: type[BaseModel], **where: Any) -> None:
    """Raise `InputError` for a column that is missing, unknown or there twice.

    Every table may have columns of notes (`is_note`); a record that ignores what it does not name
    takes tables with any further columns.

    **Arguments:** `header`: names of a table's columns; `model`: the record of a row; `where`: file
    and row, as `InputError` takes them.
    """
    known = columns(model)
    rules = model if issubclass(model, Strict) else Strict
    needed = [name for name, f in known.items() if f.is_required() or name in rules.must_have]
    missing = [name for name in needed if name not in header]
    strange = [name for name in header if name not in known and not is_note(name)]
    if missing:
        near = did_you_mean(missing[0], strange)
        near = near.replace("Did you mean", "Is it").replace("?", " in this table?")
        words = f"expected a column {missing[0]!r}, but the header has {listed(header)}.{near}"
        raise InputError(words, **where, column=missing[0])
    if strange and model.model_config.get("extra") != "ignore":
        what = repr(strange[0]) if strange[0] else "a column without a name"
        raise InputError(
            f"unknown column {what}.{did_you_mean(strange[0], known)} Known: {', '.join(known)}; "
            "columns whose names begin with note are yours.",
            **where,
            column=strange[0],
        )
    twice = [name for k, name in enumerate(header) if name in header[:k] and name in known]
    if twice:
        raise InputError("this column is there twice", **where, column=twice[0])


def is_of_numbers(field: FieldInfo) -> bool:
    """Whether a field of a record takes numbers."""
    return not {int, float}.isdisjoint({field.annotation, *typing.get_args(field.annotation)})
