"""The job of `fynjax init --table`: a plot file and its tables from somebody's own table of plants,
a place, an image and leaf spectra."""

import csv
import io
import json
import math
import os
import re
import shlex
import shutil
import warnings
from collections.abc import Collection, Iterable
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta, timezone
from pathlib import Path
from typing import Literal

import numpy as np

from fynjax._core.errors import InputError, in_file
from fynjax._core.precision import double_precision
from fynjax.app.io.instruments import load_sensor
from fynjax.app.io.plot import (
    DEFAULT_PRIOR,
    NO_PRIOR,
    PlantOfTable,
    Releve,
    example_folder,
    in_the_cape,
    raster_place,
    read_plot,
    read_prior,
    read_releve,
    spectra_by_taxon,
    state_population,
)
from fynjax.app.io.raster import RasterFile, open_image
from fynjax.app.io.text import existing_file, staged_folder
from fynjax.app.jobs._result import JobResult
from fynjax.canopy import band_word
from fynjax.sensors import Sensor, shipped_sensors, sun_position

_SIDE_M = 10.0
"""Side of the plot that is written, unless the image is smaller, or crowns or pixels wider [m]."""
_STEP_M = 0.1
"""Voxel of the plot file, of which a side is a whole number [m]."""
_LOWEST_SUN = 85.0
"""Zenith angle of the sun up to which a time may be that of an image [degree]."""
_SAME_BAND_NM = 25.0
"""Difference of band centres up to which a camera may be that of an image [nm]."""


class InitResult(JobResult):
    """Result of `init`: the files that were written."""

    command: Literal["init"] = "init"


def check_nothing_there(folder: Path, names: Collection[str]) -> None:
    """Raise `InputError` where one of the files that are to be written is there.

    **Arguments:** `folder` of the files; `names` of them in it.
    """
    there = [name for name in names if (folder / name).exists()]
    if there:
        raise InputError(
            f"expected a folder without {there[0]!r}; `init` overwrites nothing. Name another.",
            file=folder,
        )


@dataclass(frozen=True)
class _Image:
    """What an image says of how it was taken."""

    path: Path
    target: str
    """The file, as a command in the folder of the plot names it."""
    place: tuple[float, float] | None
    pixel_m: float | None
    across_m: float | None
    """Shorter side of what it covers [m]."""
    sensor: str
    """A shipped sensor with its bands; empty where none has."""
    altitude_m: float | None
    time: datetime | None
    said: tuple[str, ...]


@double_precision
def init_from_table(
    folder: str | Path,
    table: str | Path,
    *,
    place: tuple[float, float] | None = None,
    image: str | Path | None = None,
    leaves: str | Path | None = None,
    prior: str | Path | None = None,
    seed: int = 0,
    name: str | None = None,
) -> InitResult:
    """Write a commented plot file and its tables from a table of plants in its writer's own words.

    **Arguments:**

    - `folder`: where to write, made if missing.
    - `table`: CSV or Excel workbook of plants, as of `read_releve`.
    - `place`: latitude and longitude of the plot [degree]; left out, those of the image.
    - `image`: image of the plot, of which place, time, camera and pixel are taken.
    - `leaves`: folder, or table, of leaf spectra by taxon, which is copied beside the plot file.
    - `prior`: learned population (`read_prior`) whose means and spreads the files state; left out,
      plants are those of fynbos in the Cape and else of shrublands at large; "none": the latter.
    - `seed`: seed of every random number of the plot.
    - `name`: of the plot; that of the table if left out.

    **Returns:** `InitResult`, whose headline says how the table was taken and what was assumed.

    **Raises:** `InputError` where a file would be overwritten, with all faults of the table at
    once, for a place that is none, an image that cannot be read or lies elsewhere, and as
    `read_prior`.
    """
    folder = Path(folder)
    learned = None if prior is None else read_prior(prior)
    with warnings.catch_warnings(record=True) as of_table:
        warnings.simplefilter("always", UserWarning)
        releve = read_releve(table)
    seen = None if image is None else _image(Path(image), folder)
    place, of_place = _place(place, seen)
    fynbos = prior != NO_PRIOR and place is not None and in_the_cape(*place)
    plants = "fynbos" if fynbos or (learned and prior == DEFAULT_PRIOR) else "generic"
    files = {
        "plot.toml": "the plot, its light and sensor, and what to calibrate",
        "species.csv": f"{len(releve.plants)} taxa, from {releve.path.name}",
        "README.txt": "what to do with them",
    }
    if leaves is not None:
        files["leaf_spectra"] = "leaf spectra, copied"
    check_nothing_there(folder, files)
    said = [*releve.said, of_place, *(seen.said if seen else ())]
    with staged_folder(folder) as staged, warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", UserWarning)
        (staged / "species.csv").write_text(_species_csv(releve), encoding="utf-8")
        spectra = None if leaves is None else _copied_leaves(Path(leaves), releve, staged)
        text = _plot_toml(
            name or releve.path.stem, releve, place, seen, spectra, plants=plants, seed=seed
        )
        if learned is not None:
            text, unlearned = state_population(learned, text, staged)
            said += unlearned
        (staged / "plot.toml").write_text(text, encoding="utf-8")
        (staged / "README.txt").write_text(_guide(releve, seen), encoding="utf-8")
        read_plot(staged / "plot.toml")  # what is written can be read
    if spectra is not None:
        files[spectra] = files.pop("leaf_spectra")
    if learned is not None and prior != DEFAULT_PRIOR:
        whose = f"the prior {learned.path.name}, and of published shrublands where it is silent"
    elif plants == "fynbos":
        whose = "fynbos, learned from 18 plots in the Cape"
    else:
        whose = "published shrublands of the world"
    said.append(f"Leaf area, dead tissue and leaves that nobody measured: those of {whose}.")
    said.append(
        "Ground: assumed to be the shipped dry soil, with "
        f"{'what the table says on it' if releve.ground else '20 % of it under litter'}. Put a "
        "spectrum of yours under [ground]."
    )
    said.append(
        "Covers are shares of the ground below the crowns, as seen from above."
        if releve.cover_definition == "projected"
        else "The table has packing, fill, branches or a least area, by which covers are those of "
        'the article, eq. (10): cover_definition = "article".'
    )
    heard = [" ".join(str(one.message).split()) for one in (*of_table, *caught)]
    heard = [one.replace(f"{staged}/", "") for one in dict.fromkeys(heard)]
    return InitResult(output=str(folder), seed=seed, headline=said, files=files, warnings=heard)


def _place(
    stated: tuple[float, float] | None, image: _Image | None
) -> tuple[tuple[float, float] | None, str]:
    """Latitude and longitude, and a sentence on where they are from."""
    if stated is not None:
        north, east = stated
        if not (-90 <= north <= 90 and -180 <= east <= 180):
            swapped = -90 <= east <= 90 and -180 <= north <= 180
            hint = f" Longitude first? Write {east:g},{north:g}." if swapped else ""
            raise InputError(
                "expected `place` as latitude (-90 to 90, north) and longitude (-180 to 180, east)"
                f", but got {north:g},{east:g}.{hint}"
            )
    theirs = None if image is None else image.place
    if stated is None and theirs is None:
        return None, "No place is known: give one as latitude and longitude, and the sun is right."
    if stated is None:
        assert theirs is not None
        return theirs, f"Place: {theirs[0]:.4f}, {theirs[1]:.4f}, the middle of the image."
    if theirs is not None and max(abs(a - b) for a, b in zip(stated, theirs, strict=True)) > 0.5:
        assert image is not None
        swapped = max(abs(a - b) for a, b in zip(stated, theirs[::-1], strict=True)) < 0.5
        raise InputError(
            f"expected an image of the place, {stated[0]:g},{stated[1]:g}, but it lies at "
            f"{theirs[0]:.4f},{theirs[1]:.4f} (latitude, longitude)."
            f"{' Longitude first? Latitude is.' if swapped else ' Give that, or another image.'}",
            file=image.path,
        )
    return stated, f"Place: {stated[0]:g}, {stated[1]:g}, as stated."


# -- the image ------------------------------------------------------------------------------


def _image(path: Path, folder: Path) -> _Image:
    """Place, time, camera and pixel of an image of the plot, as its file states them; `folder` is
    that of the plot."""
    with open_image(path, "an image of the plot") as file, in_file(file.path):
        place, said = raster_place(file), list[str]()
        pixel = None
        try:
            pixel = file.pixel_m
        except InputError as error:
            said.append(f"The pixel of the image is not known: {error.message}")
        time, of_time = _time(file, place)
        sensor, of_sensor = _sensor_of(file)
        said += [of_time, of_sensor]
        altitude = None
        if sensor is not None and pixel is not None:
            own = float(sensor.pixel(sensor.altitude))
            # Of a camera that drones carry; other sensors keep the height that they fly at.
            if own < 1.0:
                altitude = float(f"{sensor.altitude * pixel / own:.3g}")
            said.append(f"Pixel: {pixel:.4g} m.")
        integers = all(np.dtype(kind).kind in "iu" for kind in file.dataset.dtypes)
        if (
            integers
            and set(file.dataset.scales) == {1.0}
            and "reflectance scale factor" not in file.header
        ):
            said.append(
                "The image holds integers and states no scale: calibrate and validate take "
                "reflectance, and say how to state it."
            )
        return _Image(
            file.path,
            shlex.quote(os.path.relpath(file.path.resolve(), folder.resolve())),
            place,
            pixel,
            None if pixel is None else pixel * min(file.dataset.width, file.dataset.height),
            "" if sensor is None else sensor.name,
            altitude,
            time,
            tuple(one for one in said if one),
        )


_TIMES = ("acquisition time", "acquisition_time", "EXIF_DateTimeOriginal", "DateTimeOriginal",
          "ACQUISITIONDATETIME", "sensing_time", "TIFFTAG_DATETIME")  # fmt: skip
"""Tags in which images have their time, the surer first."""


def _time(file: RasterFile, place: tuple[float, float] | None) -> tuple[datetime | None, str]:
    """When an image was taken, with its zone, and a sentence on where that is from."""
    tags = {key.lower(): value for key, value in file.tags.items()}
    for key in _TIMES:
        text = tags.get(key.lower(), "").strip()
        if not text:
            continue
        time = _parsed(text, tags.get("exif_offsettimeoriginal", ""))
        if time is None:
            continue
        if time.tzinfo is not None:
            return _if_sun_is_up(time, place, f"Time: {time.isoformat()}, {key} of the image.")
        if place is None:
            return None, f"The time of the image, {text}, has no zone, and no place tells it."
        zone = timezone(timedelta(hours=round(place[1] / 15.0)))
        time = time.replace(tzinfo=zone)
        note = (
            f"Time: {time.isoformat()}, {key} of the image, whose zone is not stated: taken for "
            "that of the longitude. Look at it in plot.toml, clocks are often an hour or two "
            "ahead" + (", and of a mosaic it may be that of its processing" * (key == _TIMES[-1]))
        )
        return _if_sun_is_up(time, place, f"{note}.")
    return None, "The image states no time: write it under [sun] of plot.toml."


def _parsed(text: str, offset: str) -> datetime | None:
    """A time of a tag, such as 2024:06:01 10:30:00 or 2024-06-01T10:30:00Z."""
    plain = re.sub(r"^(\d{4})[:/](\d\d)[:/](\d\d)[ T]", r"\1-\2-\3T", text)
    try:
        time = datetime.fromisoformat(
            plain + (offset if re.fullmatch(r"[+-]\d\d:\d\d", offset) else "")
        )
    except ValueError:
        return None
    return time if time.year > 1990 and (time.hour or time.minute or time.second) else None


def _if_sun_is_up(
    time: datetime, place: tuple[float, float] | None, said: str
) -> tuple[datetime | None, str]:
    try:
        up = place is None or sun_position(*place, time).zenith <= _LOWEST_SUN
    except InputError:  # it is below the horizon
        up = False
    if not up:
        return None, (
            f"At {time.isoformat()}, the time that the image states, the sun is down: not taken. "
            "Write the time of the flight under [sun] of plot.toml."
        )
    return time, said


_LESS_COMMON = ("phantom_4m",)
"""Taken after others whose bands have the same names."""


def _sensor_of(file: RasterFile) -> tuple[Sensor | None, str]:
    """The shipped sensor whose bands an image has, and a sentence on it."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        known = [load_sensor(name) for name in shipped_sensors() if not name.endswith("_paper")]
    names = [band_word(file.names[n - 1]) for n in file.bands]
    centres = file.wavelengths[np.array(file.bands) - 1]
    stated = " ".join(
        v for k, v in file.tags.items() if "model" in k.lower() or "description" in k.lower()
    )
    best: tuple[float, Sensor] | None = None
    like: list[str] = []
    for sensor in sorted(known, key=lambda one: one.name in _LESS_COMMON):
        own = [band_word(name) for name in sensor.bands.names]
        if any(names) and set(names) == set(own):
            score = 0.0
            like.append(sensor.name)
        elif np.isfinite(centres).all() and len(centres) == len(own):
            apart = np.abs(np.sort(centres) - np.sort(np.asarray(sensor.bands.centre))).max()
            if apart > _SAME_BAND_NM:
                continue
            score = 1.0 + float(apart)
        else:
            continue
        if _letters(sensor.name) in _letters(stated):
            score -= 10.0
        if best is None or score < best[0]:
            best = score, sensor
    shown = ", ".join(n for n in names if n) or f"{len(file.bands)} without names"
    if best is None:
        return None, (
            f"No shipped sensor has the bands of the image ({shown}): the camera is left at "
            "mavic_3m. Describe yours in a sensor file, or pick one of `fynjax sensors`."
        )
    others = [] if best[0] < 0.0 else [name for name in like if name != best[1].name]
    also = f" Bands of these names has {' and '.join(others)} too: was it that?" if others else ""
    return best[1], f"Camera: {best[1].name}, which has the bands of the image ({shown}).{also}"


def _letters(text: str) -> str:
    return re.sub(r"[^a-z0-9]", "", text.lower())


# -- what is written ------------------------------------------------------------------------


def _copied_leaves(source: Path, releve: Releve, folder: Path) -> str:
    """Leaf spectra copied beside the plot file; the name that it has for them."""
    if source.is_dir():
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # said when the copy is read
            spectra_by_taxon(source, [plant.cells["taxon"] for plant in releve.plants])
        shutil.copytree(source, folder / "leaf_spectra")
        return "leaf_spectra"
    source = existing_file(source, "a folder or table of leaf spectra")
    raise InputError(
        "expected a folder of leaf spectra, but this is a file. Put it into a folder, its name "
        "beginning with the taxon; or write a table of file and taxon, and name it as leaf_spectra "
        "under [plot]",
        file=source,
    )


_COLUMNS = ("taxon", "mean_diameter_cm", "cover_percent", "height_max_m", "growth_form")


def _species_csv(releve: Releve) -> str:
    """The species table, with what else the table says and what was assumed in columns of notes."""
    own = dict.fromkeys(name for p in releve.plants for name in p.cells if name not in _COLUMNS)
    notes = {name: f"note_{_slug(name)}" for name in releve.note_columns}
    text = io.StringIO()
    for line in releve.comments:
        text.write(f"{line}\n")
    for line in (
        f"From {releve.path.name}, by fynjax init. Nothing reads columns that begin with note.",
        *releve.said,
    ):
        for part in _wrapped(line):
            text.write(f"# {part}\n")
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow([*_COLUMNS, *own, "note_growth_form_by", "note_assumed", *notes.values()])
    for plant in releve.plants:
        writer.writerow(
            [
                *(plant.cells.get(name, "") for name in (*_COLUMNS, *own)),
                plant.form_from,
                " ".join(plant.assumed),
                *(plant.notes.get(name, "") for name in notes),
            ]
        )
    return text.getvalue()


def _slug(name: str) -> str:
    return re.sub(r"\W+", "_", name).strip("_") or "column"


def _wrapped(text: str, width: int = 96) -> Iterable[str]:
    line = ""
    for word in text.split():
        if line and len(line) + len(word) >= width:
            yield line
            line = word
        else:
            line = f"{line} {word}".strip()
    yield line


def _set(text: str, key: str, value: str | None, why: str | None = None) -> str:
    """The line of `key`, stated or commented out, with another value; None comments it out. `why`
    takes the place of the comment behind it."""
    line = re.search(rf"(?m)^(# )?{key} = (?P<value>\"[^\"]*\"|[^#\n]*?) *(?P<why>#.*)?$", text)
    assert line is not None, key
    stated = f"# {key} = {line['value']}" if value is None else f"{key} = {value}"
    comment = line["why"] or "" if why is None else f"# {why}" if why else ""
    return text[: line.start()] + f"{stated:<32} {comment}".rstrip() + text[line.end() :]


def _plot_toml(
    name: str,
    releve: Releve,
    place: tuple[float, float] | None,
    image: _Image | None,
    spectra: str | None,
    *,
    plants: str,
    seed: int,
) -> str:
    """The example's plot file with the comments that it has, and the values of this plot."""
    text = (example_folder() / "plot.toml").read_text(encoding="utf-8")
    target = "" if image is None else f"\n#   fynjax calibrate plot.toml --target {image.target}"
    head = (
        f"# {name}: a plot of {len(releve.plants)} taxa, written by fynjax init from "
        f"{releve.path.name}. Everything that can\n"
        "# be said of a plot stands here; of a line that is left out, [in brackets] what holds "
        "then.\n#\n"
        f"#   fynjax build plot.toml\n#   fynjax render plot.toml{target}\n\n"
    )
    text = head + text[text.index("[plot]") :]
    side, of_side = _side(releve.plants, image)
    text = _set(text, "name", json.dumps(name, ensure_ascii=False), "")
    text = _set(
        text, "size_m", f"{side:g}", f"one side, or [east-west, north-south], in m; {of_side}"
    )
    text = _set(text, "plants", f'"{plants}"')
    text = _set(text, "cover_definition", f'"{releve.cover_definition}"')
    text = _set(text, "leaf_table", None)
    if spectra is not None:
        line = f'leaf_spectra = "{spectra}"'
        why = "# measured leaves, named after their taxon"
        text = re.sub(r"(?m)^(# leaf_table = .*)$", lambda m: f"{line:<32} {why}\n{m[1]}", text)
    text = _with_sun(text, place, None if image is None else image.time)
    text = _with_ground(text, releve.ground)
    for key in ("altitude_m", "pixel_m", "calibrated_by"):
        text = _set(text, key, None)
    if image is not None:
        if image.sensor:
            text = text.replace('name = "mavic_3m"', f'name = "{image.sensor}"', 1)
        if image.altitude_m is not None:
            why = "above the ground, at which its pixel is that of the image"
            text = _set(text, "altitude_m", f"{image.altitude_m:g}", why)
        if image.pixel_m is not None:
            text = _set(text, "pixel_m", f"{image.pixel_m:.4g}", "on the ground, of the image")
    text = _set(text, "seed", str(seed))
    return _with_own_calibration(text)


def _side(plants: Iterable[PlantOfTable], image: _Image | None) -> tuple[float, str]:
    """Side of the plot [m], and where it is from."""
    widest = max(plant.record.diameter for plant in plants)
    pixel = 0.0 if image is None or image.pixel_m is None else image.pixel_m
    side = max(_SIDE_M, math.ceil(3.0 * widest), math.ceil(2.0 * pixel))
    across = None if image is None else image.across_m
    # An image of more than the plot does not say how large this is.
    if across is not None and 2.0 * pixel <= across < side:
        return math.floor(across / _STEP_M + 1e-6) * _STEP_M, "that of the image"
    return side, "ASSUMED"


def _with_sun(text: str, place: tuple[float, float] | None, time: datetime | None) -> str:
    if place is not None and time is not None:
        for key in ("zenith_deg", "azimuth_deg"):
            text = _set(text, key, None)
        text = text.replace("instead of the angles: place ...", "of the plot: place ...")
        text = _set(text, "latitude_deg", f"{place[0]:.5g}")
        text = _set(text, "longitude_deg", f"{place[1]:.6g}")
        return _set(text, "time", time.isoformat(), "... and time of the image, with its zone")
    if place is None:
        text = _set(text, "zenith_deg", "30.0", "from straight up; ASSUMED: no place is known [30]")
        return _set(text, "azimuth_deg", "0.0")
    sun = sun_position(*place, _noon(place[1]))
    why = "from straight up; ASSUMED: noon at the equinox, as no time is known [30]"
    text = _set(text, "zenith_deg", f"{sun.zenith:.1f}", why)
    text = _set(text, "azimuth_deg", f"{sun.azimuth:.1f}")
    north, east = f"latitude_deg = {place[0]:.5g}", f"longitude_deg = {place[1]:.6g}"
    text = _set(_set(text, "latitude_deg", f"{place[0]:.5g}"), "longitude_deg", f"{place[1]:.6g}")
    text = text.replace(f"\n{north} ", f"\n# {north} ").replace(f"\n{east}\n", f"\n# {east}\n")
    lines = (
        f"{north:<32} # of the plot; with a time write both, and the time,\n"
        f"{east:<32} # under [sun] in place of the angles there\n"
    )
    return text.replace("\n[sun]\n", f"{lines}\n[sun]\n", 1)


def _noon(longitude: float) -> datetime:
    """Noon of the sun at an equinox."""
    noon = datetime(2024, 3, 20, 12, tzinfo=UTC)
    return noon - timedelta(hours=longitude / 15.0)


def _with_ground(text: str, ground: dict[str, float]) -> str:
    text = _set(text, "brightness", None)
    text = _set(text, "moisture", None)
    total = sum(ground.values())
    why = "share of the ground, as the rows of the table that are no plants have it"
    for kind in ("litter", "char", "rock"):
        share = ground.get(kind, 0.0) / total if total > 0.0 else 0.0
        text = _set(
            text, f"{kind}_fraction", f"{share:.2f}" if share else None, why if share else None
        )
    return text


def _with_own_calibration(text: str) -> str:
    """The [calibration] of the example without what it says of its own species."""
    text = re.sub(
        r"(?ms)^free = \[.*?\]\n",
        '# free = ["species.*.cover", "species.*.diameter", "ground.*"]  # [what tables guess, and '
        "what\n#                                  # changes from year to year]\n",
        text,
    )
    start = text.index("# Covers seen by eye are uncertain")
    return text[:start] + (
        "# Covers seen by eye are uncertain by about a quarter; a class is as wide as it is.\n"
        '# "*.cover" = 0.25\n# "*.diameter" = 0.25\n'
    )


def _guide(releve: Releve, image: _Image | None) -> str:
    target = "image.tif" if image is None else image.target
    lines = [
        f"A plot for fynjax, written from {releve.path.name}. Run, in this folder:",
        "",
        "  fynjax build plot.toml --output built",
        "  fynjax render plot.toml --output rendered",
        f"  fynjax calibrate plot.toml --target {target} --output calibrated",
        "",
        "plot.toml     the plot, its light and sensor, and what to calibrate",
        "species.csv   taxon, crown diameter, cover, height, growth form; columns that begin with",
        "              note are yours. note_assumed names what is no measurement but usual.",
        "",
        *(part for line in releve.said for part in _wrapped(line)),
        "",
    ]
    return "\n".join(lines)
