"""A table of plants in somebody's own words, as rows of a species table: what `fynjax init --table`
reads."""

import math
import re
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from pydantic import ValidationError

from fynjax._core.errors import InputError, did_you_mean, listed, names_file
from fynjax._core.tables import numbers_rows
from fynjax._core.validation import columns, number_slip, sentence, shown
from fynjax.app.io.plot._column_words import (
    METRES,
    Heading,
    form_of_words,
    ground_of_words,
    heading,
    words_of,
)
from fynjax.app.io.text import TextTable, open_table
from fynjax.canopy import FORMS, form_of_taxon
from fynjax.scene import (
    CoverDefinition,
    SpeciesRow,
    check_species,
    cover_definition_of,
    cover_range,
    name_classes,
)

_MOST_FAULTS = 20
"""Faults that one message names."""
_OWN = tuple(columns(SpeciesRow))
_NUMBER = re.compile(r"([+-]?(?:\d+(?:[.,]\d+)?|[.,]\d+))\s*([^\d\s].*)?")
_SMALLER, _LARGER = 20.0, 7.0
"""Parts and multiples of the usual size of a growth form beyond which a size is doubted."""
_WIDTH = re.compile(r"\b(width|largeur|breite|ancho|larghezza|largura|breedte)\b")
"""Beside a width a length is that of the crown."""
_AREAS = {"m2", "dm2", "cm2", "ft2"}
_LARGEST_CLASS = 10.0
"""Above it a number is no class of any scale, but percent."""
_MISSING = (
    "",
    "na",
    "nan",
    "n a",
    "nd",
    "n d",
    "s d",
    "s i",
    "k a",
    "no data",
    "sin dato",
    "sin datos",
)
"""What stands for a size that was not measured, in the words of `words_of`."""
_BROAD_FROM_M = 1.5
"""Height from which a plant of which nothing else is known is taken to be broad-leaved [m]."""
_TALLEST_M = 8.0
"""A column of heights without a unit that has larger numbers is in centimetres [m]."""
_WIDEST_M = 6.0
"""A column of crown diameters without a unit in which no number is larger, and one has decimals, is
in metres [m]."""


@dataclass(frozen=True)
class PlantOfTable:
    """A plant of somebody's table, in the columns of a species table."""

    row: int
    """Row of the table, as an editor counts."""
    cells: dict[str, str]
    """What `species.csv` has of it, by column."""
    form_from: str
    """What the growth form was taken from: 'table', 'genus', 'family', 'life form' or 'height'."""
    assumed: tuple[str, ...]
    """Columns that are usual values of the growth form."""
    notes: dict[str, str]
    """What else the table says, by its columns."""
    record: SpeciesRow
    """The row as it is read."""


@dataclass(frozen=True)
class Releve:
    """A table of plants, read."""

    path: Path
    plants: tuple[PlantOfTable, ...]
    note_columns: tuple[str, ...]
    """Columns that are kept as notes, in the order of the table."""
    comments: tuple[str, ...] = ()
    """Lines of comment above the header."""
    ground: dict[str, float] = field(default_factory=dict)
    """Cover of what is no plant [%]: litter, rock, char, bare."""
    said: tuple[str, ...] = ()
    """How the table was taken, in sentences."""

    @property
    def cover_definition(self) -> CoverDefinition:
        """What its covers mean: as the article counts them where it states terms of eq. (10)."""
        return cover_definition_of([plant.record for plant in self.plants])


class _Faults:
    """Faults of a table, of which one message tells all."""

    def __init__(self, path: Path) -> None:
        self.path, self.found = path, list[tuple[int | None, str, str]]()

    def add(self, row: int | None, column: str, what: str) -> None:
        self.found.append((row, column, " ".join(what.split()).rstrip(".")))

    def stop(self) -> None:
        """Raise `InputError` if there are any."""
        if not self.found:
            return
        if len(self.found) == 1:
            ((row, column, what),) = self.found
            raise InputError(f"{what}.", file=self.path, row=row, column=column or None)
        said, in_order = [], sorted(self.found, key=lambda fault: fault[0] or 0)
        for k, (row, column, what) in enumerate(in_order[:_MOST_FAULTS], start=1):
            where = ", ".join(
                [*([] if row is None else [f"row {row}"]), *([f"column {column!r}"] * bool(column))]
            )
            said.append(f"({k}) {where}{': ' if where else ''}{what}.")
        if more := len(self.found) - _MOST_FAULTS:
            said += [f"And {more} more."] if more > 0 else []
        raise InputError(f"{len(self.found)} faults: {' '.join(said)}", file=self.path)


@names_file
def read_releve(path: str | Path) -> Releve:
    """Read a table of plants whose columns are named in the writer's own words.

    The table may be written as `fynjax.app.io.text.open_table` has it, as CSV or an Excel workbook.
    Its columns are known by their headings in several languages, with a unit in brackets, behind
    or none: then numbers say whether lengths are metres or centimetres, and covers shares or
    percent. Growth forms are those of the table, or of the genus, the life form or the family; else
    they follow from the height. Sizes that the table lacks are the usual ones of the form. A column
    without a name that numbers the rows is left out; other columns are kept as notes.

    **Arguments:** `path`, the file.

    **Returns:** `Releve`, with what was taken for what.

    **Raises:** `InputError` with all faults of the table at once, each with what to write.
    """
    table = open_table(path, "a table of plants")
    path, faults = table.path, _Faults(table.path)
    heads = [heading(name) for name in table.names]
    rows = list(table.records())
    if not rows:
        raise InputError("expected a table of plants, but there is only a header")
    numbered = [0] if numbers_rows(table) else []
    places, said = _places(table, rows, heads, faults)
    faults.stop()
    used = {i for found in places.values() for i in found} | set(numbered)
    own = {name: i for i, name in enumerate(table.names) if name in _OWN and i not in used}
    notes = [i for i in range(table.width) if i not in used and i not in own.values()]
    rows = _with_classes(table, rows, places["cover"][0], heads, said, faults)
    rows, ground = _without_ground(rows, places, said, faults)
    _check_one_plot(table, rows, places, faults)
    taxa = _taxa(table, rows, places, said, faults)
    covers = _covers(table, rows, places, heads, said, faults)
    sizes = {
        kind: _lengths(table, rows, places.get(kind, []), heads, kind, said, faults)
        for kind in ("height", "diameter")
    }
    plants = []
    for k, (number, cells) in enumerate(rows):
        form, source = _form(cells, places, taxa[k], sizes["height"][k])
        given = {"taxon": taxa[k], "cover_percent": covers[k], "growth_form": form}
        assumed = []
        for kind, column, factor in (
            ("diameter", "mean_diameter_cm", 100.0), ("height", "height_max_m", 1.0)
        ):  # fmt: skip
            value = sizes[kind][k]
            if value is None and form in FORMS:
                value = getattr(FORMS[form], kind)
                assumed.append(column)
            given[column] = "" if value is None else f"{factor * value:.6g}"
        given |= {name: table.plain(cells[i], number, name) for name, i in own.items() if cells[i]}
        record = _record(given, number, table, places, faults)
        if record is not None:
            about = {table.names[i] or f"column {i + 1}": cells[i] for i in notes if cells[i]}
            plants.append(PlantOfTable(number, given, source, tuple(assumed), about, record))
    _check_twice(rows, taxa, faults)
    faults.stop()
    _doubt_sizes(path, plants, [k for k, w in places.items() if any(not heads[i].unit for i in w)])
    every = [(plant.row, plant.record) for plant in plants]
    check_species(every, path, cover_definition_of([record for _, record in every]))
    names = tuple(table.names[i] or f"column {i + 1}" for i in notes)
    said += _forms_said(plants)
    above = (table.line(row) for row in range(1, table.row))
    comments = tuple(line for line in above if line.startswith("#"))
    return Releve(path, tuple(plants), names, comments, ground, tuple(said))


def _places(
    table: TextTable,
    rows: Sequence[tuple[int, list[str]]],
    heads: Sequence[Heading],
    faults: _Faults,
) -> tuple[dict[str, list[int]], list[str]]:
    """Where the columns of each role stand, and what to say of how they were taken."""
    found: dict[str, list[int]] = {}
    for i, head in enumerate(heads):
        if head.role:
            found.setdefault(head.role, []).append(i)
    said: list[str] = []
    for role, where in found.items():
        if role == "taxon":  # a column of names says more than one of their numbers
            named = [i for i in where if not all(cells[i].isdigit() for _, cells in rows)]
            where = named or where
        if exact := [i for i in where if heads[i].exact]:
            where = exact
        if role not in ("diameter", "height", "form") and len(where) > 1:
            alike = {words_of(table.names[i]) for i in where}
            if role in ("cover",) or len(alike) == 1:
                names = ", ".join(repr(table.names[i]) for i in where)
                faults.add(
                    table.row,
                    table.names[where[1]],
                    f"{names} may each be the {role}: keep one, and begin the others' names with "
                    "note",
                )
            where = where[:1]
        found[role] = where
    across = [i for i in found.pop("length", []) if heads[i].exact]
    if any(_WIDTH.search(words_of(table.names[i])) for i in found.get("diameter", [])):
        found["diameter"] += across
    for role in ("radius", "area"):  # of which a diameter follows, where none is stated
        if instead := found.pop(role, []):
            found.setdefault("diameter", instead)
    if "taxon" not in found and {"genus", "epithet"} <= set(found):
        found["taxon"] = []
    for role, write in (("taxon", "taxon"), ("cover", "cover_percent")):
        if role not in found:
            near = did_you_mean(write, [name for name in table.names if name])
            near = near.replace("Did you mean", "Is it")
            shown_names = listed(n or "one without a name" for n in table.names)
            faults.add(
                table.row,
                "",
                f"no column is the {role}, among {shown_names}.{near} Call it {write}",
            )
    taken = {
        role: found[role] for role in ("taxon", "cover", "diameter", "height") if found.get(role)
    }
    said.append(
        "Columns: "
        + ", ".join(
            f"{role} from {' and '.join(repr(table.names[i]) for i in where)}"
            for role, where in taken.items()
        )
        + "."
    )
    return found, said


def _with_classes(
    table: TextTable,
    rows: Sequence[tuple[int, list[str]]],
    at: int,
    heads: Sequence[Heading],
    said: list[str],
    faults: _Faults,
) -> list[tuple[int, list[str]]]:
    """The rows with classes of cover named as such, as the heading or all the cells tell them."""
    name, covers, scale = table.names[at], [cells[at] for _, cells in rows], heads[at].scale
    found = re.findall(r"\d+(?:[.,]\d+)?", " ".join(covers))
    numbers = [float(one.replace(",", ".")) for one in found]
    percent = "%" in "".join(covers) or max(numbers, default=0.0) > _LARGEST_CLASS
    if scale is not None and percent:
        said.append(f"Under {name!r} stand no classes: taken for percent.")
        return list(rows)
    with warnings.catch_warnings():
        if scale is not None:
            warnings.simplefilter("ignore", UserWarning)
        named = name_classes(covers, stated=scale == "Braun-Blanquet")
    what = {
        None: "",
        "": "the heading says of classes, but not of which scale. If it is that of Braun-Blanquet, "
        "call the column so; else",
        "Braun-Blanquet": "not all cells are classes of Braun-Blanquet (1 to 5, r, +):",
    }.get(scale, f"classes of {scale} cannot be read:")
    numbers_left = any(re.fullmatch(r"[\d.,]*[1-9][\d.,]*", str(cell)) for cell in named)
    if what and (numbers_left or scale not in ("", "Braun-Blanquet")):
        write = "write the middle of each class in percent, and call the column cover_percent"
        faults.add(table.row, name, f"{what} {write}")
    faults.stop()
    return [
        (row, [*cells[:at], str(cell), *cells[at + 1 :]])
        for (row, cells), cell in zip(rows, named, strict=True)
    ]


def _without_ground(
    rows: list[tuple[int, list[str]]],
    places: dict[str, list[int]],
    said: list[str],
    faults: _Faults,
) -> tuple[list[tuple[int, list[str]]], dict[str, float]]:
    """The rows that are plants, and the cover of those that are ground [%]."""
    (at,) = places["cover"]
    names = [*places["taxon"], *places.get("genus", [])]
    kept, ground, left = [], dict[str, float](), []
    for row, cells in rows:
        kind = next((ground_of_words(cells[i]) for i in names if cells[i]), "")
        if not kind:
            kept.append((row, cells))
            continue
        between = cover_range(cells[at])
        number = _NUMBER.fullmatch(cells[at])
        value = (
            0.5 * sum(between) if between else float(number[1].replace(",", ".")) if number else 0.0
        )
        if kind == "total":
            left.append(f"row {row} ({next(cells[i] for i in names if cells[i])})")
        else:
            ground[kind] = ground.get(kind, 0.0) + value
    if left:
        said.append(f"Sums are no plants and left out: {', '.join(left)}.")
    if ground:
        words = ", ".join(f"{kind} {value:g} %" for kind, value in ground.items())
        said.append(f"Rows of ground are no plants: {words} went into [ground].")
    if not kept:
        faults.add(None, "", "no row of the table is a plant")
        faults.stop()
    return kept, ground


def _check_one_plot(
    table: TextTable,
    rows: Sequence[tuple[int, list[str]]],
    places: dict[str, list[int]],
    faults: _Faults,
) -> None:
    for at in places.get("plot", []):
        plots = list(dict.fromkeys(cells[at] for _, cells in rows if cells[at]))
        if 1 < len(plots) < len(rows):
            faults.add(
                None,
                table.names[at],
                f"{len(plots)} plots are in the table ({listed(plots)}): keep the rows of one in a "
                "file of its own",
            )


def _taxa(
    table: TextTable,
    rows: Sequence[tuple[int, list[str]]],
    places: dict[str, list[int]],
    said: list[str],
    faults: _Faults,
) -> list[str]:
    """Names of the plants, those of several layers with their layer."""
    at, genus, epithet, layer = (
        next(iter(places.get(role, [])), None) for role in ("taxon", "genus", "epithet", "layer")
    )
    names = []
    for row, cells in rows:
        name = "" if at is None else " ".join(cells[at].split())
        first = "" if genus is None else cells[genus]
        if not name and epithet is not None:
            name = cells[epithet]
        if first and not name:
            name = f"{first} sp."
        elif first and " " not in name and name != first:
            name = f"{first} {name}"  # genus and epithet in columns of their own
        if not name:
            faults.add(
                row,
                "" if at is None else table.names[at],
                "the plant has no name: write one, such as 'Unknown shrub', or delete the row",
            )
        names.append(name)
    twice = {name for name in names if name and names.count(name) > 1}
    if names and all(name.isdigit() for name in names):
        faults.add(
            None,
            "" if at is None else table.names[at],
            "numbers are no names of plants: write the names, or 'Species 12' for 12",
        )
    if twice and layer is not None:
        in_layers = [
            f"{name} ({cells[layer]})" if name in twice and cells[layer] else name
            for name, (_, cells) in zip(names, rows, strict=True)
        ]
        said.append(f"In several layers, and so there with the layer: {', '.join(sorted(twice))}.")
        return in_layers
    return names


def _check_twice(
    rows: Sequence[tuple[int, list[str]]], taxa: Sequence[str], faults: _Faults
) -> None:
    first: dict[str, int] = {}
    for (row, _), taxon in zip(rows, taxa, strict=True):
        if taxon and first.setdefault(taxon, row) != row:
            faults.add(
                row,
                "",
                f"{taxon!r} is there twice, first in row {first[taxon]}: add the covers up in one "
                "row, or give the two different names",
            )


def _covers(
    table: TextTable,
    rows: Sequence[tuple[int, list[str]]],
    places: dict[str, list[int]],
    heads: Sequence[Heading],
    said: list[str],
    faults: _Faults,
) -> list[str]:
    """Covers as a species table has them: percent, or classes and ranges as they are written."""
    (at,) = places["cover"]
    name, unit = table.names[at], heads[at].unit
    if unit not in ("", "%", "fraction"):
        faults.add(
            table.row,
            name,
            f"covers in {unit} are no shares of the ground: divide them by the plot's own "
            f"{'area' if unit.endswith('2') else 'length'}, times 100, and write % for the unit",
        )
    found: list[str] = []
    for row, cells in rows:
        cell = cells[at]
        if not cell:
            faults.add(row, name, "no cover: write percent, a class such as +, or 0.1 for a trace")
        elif cover_range(cell) is None and not _NUMBER.fullmatch(cell):
            hint = number_slip(cell) or " Write percent, a class such as + or 2a, or a range"
            faults.add(row, name, f"expected a cover, but got {shown(cell)}.{hint}")
        plain = cell.removesuffix("%").strip()
        found.append(plain.replace(",", ".") if _NUMBER.fullmatch(plain) else cell)
    numbers = [float(cell) for cell in found if re.fullmatch(r"(\d*\.)?\d+", cell)]
    shares = unit == "fraction"
    if not shares and unit != "%" and len(numbers) == len(found) > 1:
        decimals = any("." in cell for cell in found)
        shares = decimals and max(numbers) <= 1.0 and 0.2 < sum(numbers) <= 3.0
        if shares:
            said.append(
                f"No cover in {name!r} is above 1, and they sum to {sum(numbers):.3g}: taken for "
                "shares. If they are percent, write % behind the name of the column."
            )
    return [f"{100 * float(cell):.6g}" for cell in found] if shares else found


def _lengths(
    table: TextTable,
    rows: Sequence[tuple[int, list[str]]],
    where: Sequence[int],
    heads: Sequence[Heading],
    kind: str,
    said: list[str],
    faults: _Faults,
) -> list[float | None]:
    """Heights or crown diameters [m]; None where the table has none."""
    largest = [
        i
        for i in where
        if re.search(r"\b(max|maxim\w*|greatest|top|hmax)\b", words_of(table.names[i]))
    ]
    first = largest[:1] if kind == "height" and len(where) > 1 else []
    columns_of = {
        i: _column_of_lengths(table, rows, i, heads[i], kind, said, faults) for i in where
    }
    if len(where) > 1 and not first:
        how = "the largest" if kind == "height" else "the mean"
        said.append(f"The {kind} is {how} of {' and '.join(repr(table.names[i]) for i in where)}.")
    values: list[float | None] = []
    fell_back = False
    for k in range(len(rows)):
        known = {i: v for i in where if (v := columns_of[i][k]) is not None}
        own = [known[i] for i in first if i in known] or list(known.values())
        fell_back |= bool(own) and not known.keys() >= set(first)
        if not own:
            values.append(None)
        else:
            values.append(max(own) if kind == "height" else sum(own) / len(own))
    if fell_back:
        others = " or ".join(repr(table.names[i]) for i in where if i not in first)
        said.append(f"Where {table.names[first[0]]!r} is empty, the height is that of {others}.")
    return values


def _column_of_lengths(
    table: TextTable,
    rows: Sequence[tuple[int, list[str]]],
    at: int,
    head: Heading,
    kind: str,
    said: list[str],
    faults: _Faults,
) -> list[float | None]:
    name, numbers, units = table.names[at], list[float | None](), list[str]()
    if head.scale is not None and not head.unit:
        faults.add(
            table.row,
            name,
            f"classes are no {kind}: write the middle of each in m, and (m) for the unit, or begin "
            "the name of the column with note",
        )
    for row, cells in rows:
        cell = "" if words_of(cells[at]) in _MISSING else cells[at]
        match = _NUMBER.fullmatch(cell)
        unit = heading(f"x ({match[2]})").unit if match and match[2] else ""
        if cell and (match is None or (match[2] and unit not in METRES)):
            hint = number_slip(cell) or " Write one number"
            faults.add(row, name, f"expected a {kind}, but got {shown(cell)}.{hint}")
            match = None
        numbers.append(float(match[1].replace(",", ".")) if match else None)
        units.append(unit)
    known = [v for v, own in zip(numbers, units, strict=True) if v is not None and not own]
    area, unit = head.role == "area", head.unit
    if area:
        if unit not in _AREAS:
            faults.add(table.row, name, "an area needs its unit: write m2 or cm2 in brackets")
        unit = unit.removesuffix("2") if unit in _AREAS else "m"
        said.append(f"The diameter is that of a circle as large as {name!r}.")
    elif head.role == "radius":
        said.append(f"The diameter is twice {name!r}.")
    if unit and unit not in METRES:
        faults.add(table.row, name, f"{unit} is no unit of length: write cm or m in brackets")
        unit = "m"
    if not unit:
        if kind == "height":
            unit = "cm" if known and max(known) > _TALLEST_M else "m"
        else:
            decimals = any(value != round(value) for value in known)
            unit = "m" if known and max(known) <= _WIDEST_M and decimals else "cm"
        if known:
            said.append(
                f"{name!r} states no unit; up to {max(known):g}, it is taken to be in {unit}."
            )
    if area:
        numbers = [None if v is None else math.sqrt(max(v, 0.0) / math.pi) for v in numbers]
    factor = 2.0 if head.role in ("radius", "area") else 1.0
    return [
        None if value is None else factor * value * METRES[own or unit]
        for value, own in zip(numbers, units, strict=True)
    ]


def _doubt_sizes(path: Path, plants: Sequence[PlantOfTable], without_unit: Sequence[str]) -> None:
    """Warn of sizes without a unit that their growth forms do not have."""
    for kind, column, factor in (
        ("height", "height_max_m", 1.0), ("diameter", "mean_diameter_cm", 0.01)
    ):  # fmt: skip
        odd = []
        for plant in plants if kind in without_unit else ():
            usual = getattr(FORMS[plant.record.growth_form], kind)
            size = factor * float(plant.cells[column])
            if column not in plant.assumed and not 1 / _SMALLER < size / usual < _LARGER:
                odd.append(f"{plant.cells['taxon']} {size:g} m, for a usual {usual:g} m")
        if odd:
            more = f" and {len(odd) - 3} more" if len(odd) > 3 else ""
            warnings.warn(
                f"{path}: a {kind} of {'; '.join(odd[:3])}{more}. No unit is stated, and m or cm "
                "taken by the numbers: write it behind the name of the column, as in (cm).",
                UserWarning,
                stacklevel=3,
            )


def _form(
    cells: Sequence[str], places: dict[str, list[int]], taxon: str, height: float | None
) -> tuple[str, str]:
    """Growth form of a plant, and what it was taken from."""
    stated = [cells[i] for i in places.get("form", []) if cells[i]]
    for word in stated:
        name = words_of(word).replace(" ", "_")
        if name in FORMS:
            return name, "table"
    family = next((cells[i] for i in places.get("family", [])), "")
    words = taxon.replace("×", " ").split()
    genus = words[0].capitalize() if words else ""
    by_words = next((form for word in stated if (form := form_of_words(word))), "")
    found = form_of_taxon(genus)
    if found is not None and not (by_words in _NOT_SHRUBS and found.growth_form not in _NOT_SHRUBS):
        return found.growth_form, "genus"
    family = family or (genus if genus.endswith("aceae") else "")
    by_family = form_of_taxon("", family.capitalize())
    herb = by_words == "rounded_shrub" and any(_HERB.search(words_of(word)) for word in stated)
    if by_words and not (herb and by_family and by_family.growth_form in _NOT_SHRUBS):
        return by_words, "life form"
    if by_family is not None:
        return by_family.growth_form, "family"
    if by_taxon := form_of_words(taxon):
        return by_taxon, "name"
    tall = height is not None and height >= _BROAD_FROM_M
    return ("broad_leaved" if tall else "rounded_shrub"), "height"


_NOT_SHRUBS = (
    "deadwood",
    "moss_layer",
    "climber",
    "tussock",
    "sward",
    "cushion",
    "mat",
    "rosette",
    "succulent",
    "column",
)
"""Forms that a life form tells more surely than a genus does."""
_HERB = re.compile(
    r"\b(herb|hierba|erba|erva|kraut|kruid|forb|annual|perennial|annuelle|vivace|bulb|geo[pf]|"
    r"h?emicr|thero|terof)|^(h|t|th|g)$"
)
"""Life forms that grasses and their like share with herbs: of these the family says more."""


def _record(
    given: dict[str, str], row: int, table: TextTable, places: dict[str, list[int]], faults: _Faults
) -> SpeciesRow | None:
    """A row of the species table; None, with its faults, where it cannot be one."""
    filled = {name: cell for name, cell in given.items() if cell}
    try:
        return SpeciesRow.model_validate(filled)
    except ValidationError as error:
        named = {"mean_diameter_cm": "diameter", "height_max_m": "height", "cover_percent": "cover"}
        already = {(at, column) for at, column, _ in faults.found}
        for one in error.errors(include_url=False):
            column = str(one["loc"][0]) if one["loc"] else ""
            where = places.get(named.get(column, column), [])
            theirs = table.names[where[0]] if where else column
            if (row, theirs) not in already and not (
                column == "taxon" and one["type"] == "missing"
            ):
                faults.add(row, theirs, sentence(one, SpeciesRow, column))
        return None


def _forms_said(plants: Sequence[PlantOfTable]) -> list[str]:
    """Sentences on what growth forms were taken from, and on sizes that are usual ones."""
    said = []
    words = {
        "genus": "by genus", "family": "by family", "life form": "by life form",
        "name": "by the name", "height": "by height alone",
    }  # fmt: skip
    for source, how in words.items():
        mine = [p for p in plants if p.form_from == source]
        if mine:
            forms = "; ".join(f"{p.cells['taxon']} {p.cells['growth_form']}" for p in mine)
            doubt = " Look at these: nothing else is known of them." if source == "height" else ""
            said.append(f"Growth forms {how}: {forms}.{doubt}")
    for column, word in (("mean_diameter_cm", "Crown diameters"), ("height_max_m", "Heights")):
        mine = [p for p in plants if column in p.assumed]
        if mine:
            of = (
                "all plants"
                if len(mine) == len(plants)
                else ", ".join(p.cells["taxon"] for p in mine)
            )
            said.append(f"{word} of {of} are usual ones of the growth form: measure them.")
    return said
