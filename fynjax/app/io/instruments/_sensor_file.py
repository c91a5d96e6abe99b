"""Sensor files, read into sensors."""

import itertools
import tomllib
import warnings
from pathlib import Path
from typing import Any

import numpy as np

from fynjax._core.errors import InputError, names_file
from fynjax._core.tables import open_table
from fynjax._core.validation import checked_rows, columns
from fynjax.app.io.instruments._lidar_file import load_lidar
from fynjax.app.io.instruments._sensor_tables import (
    BandRow,
    CurveRow,
    NoiseRow,
    RadiometricNoiseTable,
    SensorFile,
)
from fynjax.app.io.text import did_you_mean, line_of, read_rows, read_toml, shipped_or_own
from fynjax.sensors import (
    Lidar,
    Sensor,
    build_sensor,
    sensor_folder,
    shipped_lidars,
    shipped_sensors,
)

_NOISE, _GAP = 0.02, 10.0
"""Of a response curve: noise as a share of its largest value, and a step over the usual ones."""
_FEW = 20  # bands of a camera; with more, neighbours of a spectrometer are a width apart


def load_instrument(name_or_path: str | Path) -> Sensor | Lidar:
    """An imaging sensor or a LiDAR, by its shipped name or from a file.

    **Arguments:** `name_or_path`: a shipped name, or the path of a sensor or LiDAR file. A file
    with a table [laser] is that of a LiDAR.

    **Returns:** a `fynjax.sensors.Sensor` or a `fynjax.sensors.Lidar`.

    **Raises:** `InputError` as `load_sensor` and `load_lidar`.
    """
    text = str(name_or_path)
    if text in shipped_lidars():
        return load_lidar(text)
    if text not in shipped_sensors() and _has_laser(Path(text)):
        return load_lidar(text)
    if text not in shipped_sensors() and len(Path(text).parts) == 1 and not Path(text).suffix:
        names = (*shipped_sensors(), *shipped_lidars())
        raise InputError(
            f"expected a shipped sensor or LiDAR, or the path of its file, but got {text!r}."
            f"{did_you_mean(text, names)} Shipped: {', '.join(names)}."
        )
    return load_sensor(text)


def _has_laser(path: Path) -> bool:
    try:
        return "laser" in tomllib.loads(path.read_text("utf-8"))
    except (OSError, RecursionError, ValueError):  # the reader of sensor files says what is wrong
        return False


def load_sensor(name_or_path: str | Path) -> Sensor:
    """A shipped sensor by its name, or a sensor from a file.

    **Arguments:**

    - `name_or_path`: a name such as 'mavic_3m' (see `fynjax.sensors.shipped_sensors`), or the path
      of a sensor file (TOML; `data_schemas/sensor.schema.json`). Paths in the file start from its
      own folder, and stay in it.

    **Returns:** a `fynjax.sensors.Sensor`.

    **Raises:** `InputError` with file, row and key for what cannot be used: unknown keys and
    units, wavelengths in µm, bands that are descending, out of order or there twice, responses
    and noise that do not fit the bands. Warns where the file states a ground sample distance that
    its optics do not give (the optics are used), and where widths look like half widths.

    >>> from fynjax.app.io.instruments import load_sensor
    >>> load_sensor("mavic_3m").bands.names
    ('green', 'red', 'red_edge', 'nir')
    """
    return _read_sensor(shipped_or_own(name_or_path, "sensor", shipped_sensors(), sensor_folder()))


@names_file
def _read_sensor(path: Path) -> Sensor:
    description, text = read_toml(path, SensorFile, within=path.parent)
    tables: dict[Path, list[tuple[int, Any]]] = {}
    bands, noise = description.bands, description.noise
    if bands.table is not None:
        tables[bands.table] = read_rows(bands.table, BandRow, "a table of bands")
        _check_band_rows(bands.table, tables[bands.table], bands.any_order)
    elif bands.centre_nm is not None:
        widths = bands.fwhm_nm or [2.0 * v for v in bands.half_width_nm or []]
        slip = _order_slip(bands.centre_nm, widths, bands.any_order)
        if slip is not None:
            raise InputError(
                slip[1], row=line_of(text, ("bands", "centre_nm")), column="bands.centre_nm"
            )
        _warn_of_half_widths(path, bands.centre_nm, widths)
    elif bands.curves is not None:
        tables[bands.curves] = _check_curve_rows(bands.curves, _curve_rows(bands.curves))
    if isinstance(noise, RadiometricNoiseTable):
        tables[noise.table] = read_rows(noise.table, NoiseRow, "a table of noise coefficients")

    def columns_of(table: Path) -> dict[str, list]:
        given = tables[table]
        fields = [f for f in type(given[0][1]).model_fields if getattr(given[0][1], f) is not None]
        return {field: [getattr(row, field) for _, row in given] for field in fields}

    sensor = build_sensor(description.model_dump(exclude_unset=True), columns_of)
    if not bands.any_order:
        slip = _order_slip(list(sensor.bands.centre), list(sensor.bands.fwhm), any_order=False)
        if slip is not None:
            raise InputError(slip[1])
    return sensor


def _order_slip(
    centres: list[float], widths: list[float], any_order: bool
) -> tuple[int, str] | None:
    """The first band that is out of order or there twice, and what to say of it."""
    first_index: dict[tuple[float, float], int] = {}
    for index, band in enumerate(zip(centres, widths)):
        if band in first_index:
            return index, (
                f"band {index + 1} is a duplicate of band {first_index[band] + 1}: both lie at "
                f"{band[0]:g} nm with a width of {band[1]:g} nm. Leave one out."
            )
        first_index[band] = index
    steps = np.diff(centres)
    if any_order or np.all(steps > 0):
        return None
    at = int(np.argmax(steps <= 0)) + 1
    if np.all(steps < 0):
        return at, (
            f"expected bands by rising wavelength, but they are descending from {centres[0]:g} to "
            f"{centres[-1]:g} nm. Reverse them (and the data), or set any_order = true."
        )
    return at, (
        f"expected bands by rising wavelength, but {centres[at]:g} nm follows "
        f"{centres[at - 1]:g} nm. Sort them, or set any_order = true if images have this order."
    )


@names_file
def _check_band_rows(path: Path, rows: list, any_order: bool) -> None:
    first = rows[0][1]
    for field in ("name", "fwhm_nm", "half_width_nm", "ground_sample_distance_m"):
        for number, row in rows:
            if (getattr(row, field) is None) != (getattr(first, field) is None):
                words = "expected this column in all rows or in none, but some cells are empty"
                raise InputError(words, row=number, column=field)
    centres = [row.centre_nm for _, row in rows]
    widths = [row.fwhm_nm or 2.0 * row.half_width_nm for _, row in rows]
    slip = _order_slip(centres, widths, any_order)
    if slip is not None:
        raise InputError(slip[1], row=rows[slip[0]][0], column="centre_nm")
    _warn_of_half_widths(path, centres, widths)


@names_file
def _curve_rows(path: Path) -> list[tuple[int, CurveRow]]:
    """A table of curves: a row a point, or a column of wavelengths and one of each band."""
    what = "a table of response curves"
    table = open_table(path, what)
    first, *names = table.names
    known = columns(CurveRow)
    if len(names) < 1 or not first.lower().startswith("wavelength") or known.keys() & set(names):
        return read_rows(path, CurveRow, what)
    if len(set(names)) < len(names) or not all(names):
        words = f"expected one name for each band after {first!r}, but got {', '.join(names)}"
        raise InputError(words, row=table.row)
    cells = [
        (row, {"band": name, "wavelength_nm": wave, "response": table.plain(cell, row, name)})
        for place, name in enumerate(names)
        for row, (wave, *others) in table.records()
        if (cell := others[place])
    ]
    return checked_rows(cells, CurveRow, path)


@names_file
def _check_curve_rows(path: Path, rows: list) -> list:
    """The rows, noise below 0 as 0, after their order and their curves are checked."""
    done: set[str] = set()
    for (_, before), (number, row) in itertools.pairwise(rows):
        if row.band != before.band:
            done.add(before.band)
            if row.band in done:
                words = f"expected all rows of band {row.band!r} together, but they start again"
                raise InputError(words, row=number, column="band")
        elif row.wavelength_nm <= before.wavelength_nm:
            slip = "Sort the rows."
            if row.wavelength_nm == before.wavelength_nm:
                slip = "A duplicate: leave one out."
            raise InputError(
                f"expected rising wavelengths within band {row.band!r}, but "
                f"{row.wavelength_nm:g} nm follows {before.wavelength_nm:g} nm. {slip}",
                row=number,
                column="wavelength_nm",
            )
    for band, grouped in itertools.groupby(rows, lambda item: item[1].band):
        _check_curve(band, list(grouped))
    return [(n, row.model_copy(update={"response": max(row.response, 0.0)})) for n, row in rows]


def _check_curve(band: str, rows: list) -> None:
    """Refuse a curve that is negative by more than noise, or has a point far from all others."""
    high = max(row.response for _, row in rows)
    for number, row in rows:
        if row.response < -_NOISE * max(high, 0.0):
            raise InputError(
                f"expected a response of at least 0, or noise of {_NOISE:g} of the band's largest "
                f"below it, but got {row.response:g}. Set it to 0.",
                row=number,
                column="response",
            )
    steps = np.diff([row.wavelength_nm for _, row in rows])
    for step, (_, low), (number, row) in zip(steps, rows, rows[1:]):
        if step > _GAP * np.median(steps) and max(low.response, row.response) > _NOISE * high:
            raise InputError(
                f"expected the curve of band {band!r} in even steps, but none lies between "
                f"{low.wavelength_nm:g} and {row.wavelength_nm:g} nm, where it is not 0. A stray "
                "point? Leave it out, or set the response to 0 on both sides.",
                row=number,
                column="wavelength_nm",
            )


def _warn_of_half_widths(path: Path, centres: list[float], widths: list[float]) -> None:
    """A spectrometer's channels overlap: widths of half their distance are half widths."""
    if len(centres) < _FEW:
        return
    share = float(np.median(np.asarray(widths[1:]) / np.abs(np.diff(centres))))
    if 0.3 < share < 0.7:
        warnings.warn(
            f"{path}: the full widths of the bands are {share:.2g} of the distance between them. "
            "Channels of a spectrometer overlap: are these half widths (half_width_nm)?",
            UserWarning,
            stacklevel=4,
        )
