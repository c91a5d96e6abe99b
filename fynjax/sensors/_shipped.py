"""Sensors from descriptions: the shipped files, and what a user's file is built with."""

import csv
import tomllib
import warnings
from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache
from importlib.resources import files
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp

from fynjax._core.errors import InputError
from fynjax.sensors._bands import BandSet, band_set_of_curves
from fynjax.sensors._camera import AbstractCamera, FrameCamera, OrthographicCamera, PushbroomCamera
from fynjax.sensors._gains import Gains
from fynjax.sensors._noise import AbstractNoise, CameraNoise, radiometric_noise
from fynjax.sensors._psf import PointSpread
from fynjax.sensors._sensor import Sensor

Table = Mapping[str, Sequence[Any]]
"""Columns of a table, by name."""
_SAME_PIXEL = 0.02
"""Difference between a stated pixel and that of the optics up to which they are the same [-]."""


def sensor_folder() -> Path:
    """Folder of the shipped sensor files."""
    return Path(str(files("fynjax.sensors") / "data"))


def shipped_sensors() -> tuple[str, ...]:
    """Names of the shipped sensors, sorted."""
    return tuple(sorted(path.stem for path in sensor_folder().glob("*.toml")))


def shipped_sensor(name: str) -> Sensor:
    """A shipped sensor by name.

    **Arguments:**

    - `name`: one of `shipped_sensors()`, such as "mavic_3m".

    Warns where its file states a ground sample distance that its optics do not give, which is then
    the pixel of its images (`Sensor.pixel`).

    **Raises:** `InputError` for an unknown name.

    >>> from fynjax.sensors import shipped_sensor
    >>> sensor = shipped_sensor("mavic_3m")
    >>> sensor.bands.names
    ('green', 'red', 'red_edge', 'nir')
    >>> round(float(sensor.ground_sample_distance(50.0)), 4)  # m, from 50 m above the ground
    0.023
    """
    path = sensor_folder() / f"{name}.toml"
    if name not in shipped_sensors():
        raise InputError(
            f"expected a shipped sensor ({', '.join(shipped_sensors())}), but got {name!r}."
        )
    return build_sensor(tomllib.loads(path.read_text("utf-8")), _shipped_table)


def _shipped_table(name: str) -> Table:
    text = (sensor_folder() / name).read_text("utf-8")
    rows = list(csv.DictReader(line for line in text.splitlines() if not line.startswith("#")))
    return {
        column: [r[column] if column in ("name", "band") else float(r[column]) for r in rows]
        for column in rows[0]
    }


@jax.ensure_compile_time_eval()
def build_sensor(description: Mapping[str, Any], read_table: Callable[[Any], Table]) -> Sensor:
    """A sensor from the contents of its file.

    **Arguments:**

    - `description`: tables and keys of a sensor file (`data_schemas/sensor.schema.json`), valid.
    - `read_table`: from what `description` has for a table beside the file to its columns.

    Warns where the file states a ground sample distance that its optics do not give: images have
    the stated one, lines of sight are those of the optics.

    **Raises:** `InputError` for bands or noise that do not fit together.
    """
    bands, pixel = _bands(description["bands"], read_table)
    psf, noise = description.get("psf"), description.get("noise")
    camera = _camera(description["geometry"], description["name"])
    stated = description["geometry"].get("ground_sample_distance_m")
    return Sensor(
        name=description["name"],
        bands=bands,
        camera=camera,
        psf=None if psf is None else PointSpread(psf["kind"], jnp.asarray(psf["width_pixels"])),
        noise=None if noise is None else _noise(noise, bands, read_table),
        band_pixel=pixel,
        pixel_factor=1.0 if stated is None else stated / float(camera.ground_sample_distance),
        calibrations=_calibrations(description.get("calibration", {})),
        source=description["source"],
    )


def _calibrations(table: Mapping[str, Any]) -> tuple[Gains, ...]:
    ways = sorted((way for way in table if way != "usual"), key=lambda way: way != table["usual"])
    return tuple(Gains(table[way]["gain_sd"], table[way]["gain_shared"], way) for way in ways)


def _bands(
    table: Mapping[str, Any], read_table: Callable[[str], Table]
) -> tuple[BandSet, tuple[float, ...] | None]:
    response = table.get("response", "gaussian")
    if response == "tabulated":
        curves: dict[str, tuple[list[float], list[float]]] = {}
        columns = read_table(table["curves"])
        for name, *point in zip(columns["band"], columns["wavelength_nm"], columns["response"]):
            curve = curves.setdefault(name, ([], []))
            for values, value in zip(curve, point):
                values.append(value)
        bands, given = band_set_of_curves(curves), table
    else:
        given = table if "table" not in table else read_table(table["table"])
        centre = given["centre_nm"]
        # A half width is counted from the centre to half the maximum.
        width = given.get("fwhm_nm") or [2.0 * v for v in given["half_width_nm"]]
        names = given.get("name") or [f"band_{i + 1}" for i in range(len(centre))]
        bands = BandSet(tuple(names), tuple(centre), tuple(width), response)
    pixel = given.get("ground_sample_distance_m")
    return bands, None if pixel is None else tuple(float(v) for v in pixel)


def _camera(table: Mapping[str, Any], name: str) -> AbstractCamera:
    if table["kind"] == "orthographic":
        angles = (table.get("view_zenith_deg", 0.0), table.get("view_azimuth_deg", 0.0))
        return OrthographicCamera(table["pixel_m"], *angles)
    pushbroom = table["kind"] == "pushbroom"
    frame = FrameCamera(
        position=jnp.asarray([0.0, 0.0, table["altitude_m"]]),
        focal_length_mm=table["focal_length_mm"],
        pixel_pitch_um=table["pixel_pitch_um"],
        array=(table["columns"], 1 if pushbroom else table["rows"]),
        tilt=table.get("tilt_deg", 0.0),
        heading=table.get("heading_deg", 0.0),
    )
    stated, optics = table.get("ground_sample_distance_m"), float(frame.ground_sample_distance)
    if stated is not None and abs(stated / optics - 1.0) > _SAME_PIXEL:
        height = float(frame.position[2])
        warnings.warn(
            f"{name}: the stated ground sample distance of {stated:g} m disagrees with the "
            f"optics, which give {optics:.4g} m at {height:g} m, and the stated one at "
            f"{height * stated / optics:.4g} m. Images have the stated pixel.",
            stacklevel=2,
        )
    return PushbroomCamera(frame) if pushbroom else frame


def _noise(
    table: Mapping[str, Any], bands: BandSet, read_table: Callable[[str], Table]
) -> AbstractNoise:
    if table["kind"] == "camera":
        levels = ("saturation_radiance", "full_well_electrons", "read_noise_electrons")
        for key in levels:
            count = jnp.size(jnp.asarray(table[key]))
            if count not in (1, len(bands)):
                raise InputError(
                    f"noise.{key} needs one value, or one for each of {len(bands)} bands, but has "
                    f"{count}."
                )
        saturation, well, read = (table[key] for key in levels)
        return CameraNoise(saturation, well, read, table["bits"])
    columns = read_table(table["table"])
    return radiometric_noise(
        columns["wavelength_nm"],
        *(columns[name] for name in "abc"),
        centre=bands.centre,
        unit=table["radiance_unit"],
        integrations=table.get("integrations", 1),
    )


@lru_cache
def mavic_3m() -> BandSet:
    """Bands of the DJI Mavic 3 Multispectral: green, red, red edge, near infrared.

    The maker states half widths of 16, 16, 16 and 26 nm about the centre (DJI, Mavic 3M Image
    Processing Guide v1.0, 2023); they are read as half widths at half maximum of a Gaussian,
    since no curves are published.
    """
    return shipped_sensor("mavic_3m").bands
