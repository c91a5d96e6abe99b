"""The rows of the table of accuracy: how they are measured, printed and kept."""

import json
import math
import os
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from fynjax.radiation import Accuracy, VoxelScene

Figures = dict[str, float]
"""Worst error per quantity."""


@dataclass(frozen=True)
class Row:
    """One measured figure."""

    test: str
    figure: str
    measured: float
    tolerance: float | None = None
    """None: only reported."""
    default: float | None = None
    """The same figure at `Accuracy()`, where that is not what was measured."""
    unit: str = "%"
    note: str = ""

    @property
    def verdict(self) -> str:
        if self.tolerance is None:
            return "-"
        return "pass" if self.measured <= self.tolerance else "SHORT"


@dataclass(frozen=True)
class Setting:
    """How a table is made."""

    quick: bool = False
    plots: Path | None = None
    data: Path = field(
        default_factory=lambda: Path(
            os.environ.get("FYNJAX_SHARED_DATA", Path(__file__).parents[4] / "shared" / "data")
        )
    )

    @property
    def peers(self) -> Path:
        """Scripts and images of peers, kept beside the data."""
        return self.data.parent / "bench" / "rt"

    def cases(self, name: str) -> list[dict]:
        with open(self.data / "rt" / name, encoding="utf-8") as file:
            return json.load(file)["cases"]


def margin_for(scene: VoxelScene, accuracy: Accuracy) -> Accuracy:
    """`accuracy` with the margin that `solve_light` would choose itself outside `jit`."""
    if scene.boundary == "periodic" or accuracy.margin is not None:
        return accuracy
    reach = scene.height * math.tan(math.radians(float(scene.illumination.sun_zenith)))
    return with_fields(accuracy, margin=math.ceil(reach / scene.horizontal))


def with_fields(accuracy: Accuracy, **fields: object) -> Accuracy:
    """`accuracy` with some fields replaced."""
    return replace(accuracy, **fields)  # type: ignore[arg-type]


def describe(accuracy: Accuracy) -> str:
    """The fields in which it differs from the defaults."""
    mine, plain = vars(accuracy), vars(Accuracy())
    differs = [f"{name}={mine[name]}" for name in mine if mine[name] != plain[name]]
    return ", ".join(differs).replace(" ", "") or "defaults"


def compare(
    test: str,
    measure: Callable[[Accuracy], Figures],
    accuracy: Accuracy,
    tolerances: Mapping[str, float | None],
    unit: str = "%",
) -> Iterator[Row]:
    """Rows of the figures at `accuracy`, and at the defaults beside them."""
    chosen = measure(accuracy)
    plain = measure(Accuracy()) if describe(accuracy) != "defaults" else None
    for name, value in chosen.items():
        yield Row(
            test,
            name,
            float(value),
            tolerances.get(name),
            None if plain is None else float(plain[name]),
            unit,
            describe(accuracy),
        )


def planned_mib(compiled: Any) -> float:
    """Memory that XLA plans for arguments, results and temporaries [MiB]."""
    plan = compiled.memory_analysis()
    total = plan.argument_size_in_bytes + plan.output_size_in_bytes + plan.temp_size_in_bytes
    return float(total) / 2**20


def worst(got: object, want: object, sigma: object = 0.0) -> float:
    """Largest relative difference beyond `sigma` [%]."""
    got, want, sigma = np.broadcast_arrays(
        np.asarray(got, float), np.asarray(want, float), np.asarray(sigma, float)
    )
    return float(100 * np.max(np.maximum(np.abs(got - want) - sigma, 0.0) / np.abs(want)))


HEAD = f"{'test':24s} {'figure':34s} {'tolerance':>10s} {'measured':>10s} {'default':>10s}       "


def line(row: Row) -> str:
    """One line of the table."""

    def number(value: float | None) -> str:
        return "" if value is None else f"{value:.3g}"

    return (
        f"{row.test:24s} {row.figure:34s} {number(row.tolerance):>10s} "
        f"{number(row.measured):>10s} {number(row.default):>10s} {row.unit:5s} "
        f"{row.verdict:5s} {row.note}"
    )


def write(path: Path, rows: list[Row]) -> None:
    """Keep the rows as JSON, beside first and then in place."""
    beside = path.with_name(path.name + ".part")
    with open(beside, "w", encoding="utf-8") as file:
        json.dump([asdict(row) | {"verdict": row.verdict} for row in rows], file, indent=1)
        file.write("\n")
    os.replace(beside, path)
