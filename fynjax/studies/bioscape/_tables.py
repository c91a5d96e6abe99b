"""Rows of the BioSCape tables, checked cell by cell."""

from datetime import datetime
from pathlib import Path
from typing import Annotated, Any, ClassVar

from pydantic import BeforeValidator, ConfigDict, Field

from fynjax._core.errors import InputError
from fynjax.app.io.text import Slip, Strict, did_you_mean, in_unit


def not_available(value: object) -> object:
    """`None` for NA, which R writes into an empty cell, and its like."""
    return None if str(value).strip().lower() in ("na", "nan", "none", "") else value


OptionalNumber = Annotated[float | None, BeforeValidator(not_available)]
OptionalText = Annotated[str | None, BeforeValidator(not_available)]


def percent(description: str, default: Any = ...) -> Any:
    """Field of a cover."""
    return in_unit("%", of=description, default=default, ge=0, le=100)


def _over_100(value: float) -> str | None:
    return "A decimal point lost?" if value > 100 else None


class TableRow(Strict):
    """A row of a table made elsewhere: other columns may stand beside those used here."""

    model_config = ConfigDict(extra="ignore", frozen=True)


class CoverRow(TableRow):
    """Cover of a plot."""

    slips: ClassVar[dict[str, Slip]] = {
        f"Percent{name}": _over_100
        for name in ("BareSoil", "BareRock", "DeadVegetation", "LiveVegetation")
    }
    unique = "Plot"
    Plot: str = Field(description="Name of the plot.", min_length=1)
    PercentBareSoil: float = percent("Bare soil")
    PercentBareRock: float = percent("Bare rock")
    PercentDeadVegetation: float = percent("Dead vegetation")
    PercentLiveVegetation: float = percent("Live vegetation")


class SpeciesCoverRow(TableRow):
    """Live cover of a species on a plot."""

    slips: ClassVar[dict[str, Slip]] = {
        "PercentCoverAlive": lambda v: "Leave the row out." if v == 0 else _over_100(v)
    }
    Plot: str = Field(description="Name of the plot.", min_length=1)
    GenusSpecies: str = Field(description="Scientific name.", min_length=1)
    Family: OptionalText = Field(default=None, description="Its family.")
    PercentCoverAlive: float = in_unit("%", of="Live cover", gt=0, le=100)


def _mass_slip(value: float) -> str | None:
    if value < 1:
        return f"g cm-2? In g m-2 this is {value * 1e4:g}."
    return f"mg cm-2? In g m-2 this is {value * 10:g}." if value < 20 else None


class TraitRow(TableRow):
    """Mean traits of a species."""

    slips: ClassVar[dict[str, Slip]] = {
        "Mean_Nitrogen": lambda v: f"Percent? In mg g-1 this is {v * 10:g}." if v < 1 else None,
        "Mean_Carbon": lambda v: f"Percent? In mg g-1 this is {v * 10:g}." if v < 100 else None,
        "Mean_Leaf_Mass_Per_Area": _mass_slip,
        "Mean_Water_Content": lambda v: (
            f"A fraction? In % this is {v * 100:g}."
            if v < 1
            else "Of dry mass? Of fresh mass is expected."
        ),
    }
    GenusSpecies: str = Field(description="Scientific name.", min_length=1)
    Family: str = Field(description="Its family.", min_length=1)
    Mean_Nitrogen: OptionalNumber = in_unit(
        "mg g-1", of="Nitrogen of dry mass", default=None, ge=1, le=80
    )
    Mean_Carbon: OptionalNumber = in_unit(
        "mg g-1", of="Carbon of dry mass", default=None, ge=200, le=700
    )
    Mean_Leaf_Mass_Per_Area: OptionalNumber = in_unit(
        "g m-2", of="Dry mass over projected area", ge=20, le=3000
    )
    Mean_Water_Content: OptionalNumber = in_unit("%", of="Water, share of fresh mass", gt=1, le=97)


class VisitRow(TableRow):
    """Place and time of a spectrum of a plot."""

    BScpPID: str = Field(description="Name of the plot.", min_length=1)
    X: float = in_unit("degree", of="Longitude, WGS84", ge=-180, le=180)
    Y: float = in_unit("degree", of="Latitude, WGS84", ge=-90, le=90)
    QltyFlg: OptionalText = Field(default=None, description="Remark of the crew.")
    start_time: str = Field(description="Start of the flight line, ISO 8601.", min_length=10)


def flight_time(text: str, path: Path, row: int) -> datetime:
    """Start of a flight line from ISO 8601; `InputError` for another text."""
    try:
        return datetime.fromisoformat(text)
    except ValueError as error:
        raise InputError(
            f"expected a time such as 2023-11-09 13:31:24+00:00, but got {text!r}",
            file=path,
            row=row,
            column="start_time",
        ) from error


COVER = "*CoverData.csv", "a table of cover by plot"
SPECIES = "*VegData.csv", "a table of species by plot"
TRAITS = "*TraitLibrary.csv", "a library of traits"
VISITS = "*VegCenters.csv", "a table of spectra by plot"
"""File of each table, and what it is."""


def find_table(folder: Path, kind: tuple[str, str]) -> Path | None:
    """The file of a folder that holds a table, or `None`. `InputError` if there are two."""
    paths = sorted(folder.glob(kind[0]))
    if len(paths) > 1:
        raise InputError(
            f"expected one {kind[0]} ({kind[1]}), but there are "
            f"{', '.join(p.name for p in paths)}. Leave one in the folder.",
            file=folder,
        )
    return paths[0] if paths else None


def needed_table(folder: Path, kind: tuple[str, str]) -> Path:
    """The file of a folder that holds a table; `InputError` if there is none."""
    path = find_table(folder, kind)
    if path is None:
        beside = sorted(p.name for p in folder.glob("*.csv"))
        raise InputError(
            f"expected a file {kind[0]} ({kind[1]}), but there is none."
            f"{did_you_mean(kind[0].strip('*'), beside)} The folder has "
            f"{', '.join(beside) or 'no CSV file'}.",
            file=folder,
        )
    return path
