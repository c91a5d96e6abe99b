"""Captures of a multispectral camera: the files of their bands, and their radiance."""

import itertools
import re
import warnings
from collections import Counter
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

import jax
import numpy as np
from jaxtyping import Bool, Float
from numpy.typing import NDArray

from fynjax._core.errors import InputError, in_file
from fynjax._core.precision import double_precision
from fynjax.app.io.captures._band import RawBand, Stated
from fynjax.app.io.captures._lens import Registration
from fynjax.app.io.captures._metadata import read_band
from fynjax.app.io.raster import Alignment, align_bands, open_raster
from fynjax.app.io.text import did_you_mean, existing_file
from fynjax.sensors import counts_to_radiance

_NAMES = tuple(
    re.compile(pattern + r"\.tiff?", re.IGNORECASE)
    for pattern in (
        r"(?P<capture>(.*[ _\-])?DJI_(?P<time>\d{14})_(?P<number>\d+))_MS_"
        r"(?P<band>G|R|RE|NIR)(_.*)?",
        r"(?P<capture>(.*[ _\-])?DJI_\d+)(?P<band>[1-5])",
        r"(?P<capture>.+)_(?P<band>\d+)",
    )
)
"""Names of a band's file: of a Mavic 3 Multispectral, a Phantom 4 Multispectral, a MicaSense; what
people put before those of a DJI, which numbers its pictures anew in each folder, may be there."""
_P4M_ORDER = ("blue", "green", "red", "rededge", "nir")
"""Bands of a Phantom 4 Multispectral, in the order of their numbers."""
_ORDER = ("G", "R", "RE", "NIR")
"""Bands of a Mavic 3 Multispectral, in the order of its `SensorIndex`."""
_APART = 2.0
"""Seconds by which the names of the files of one capture may differ."""
_LONGEST_REFLECTED = 3000.0
"""Wavelength [nm] beyond which a camera sees what the ground emits."""
_CLOSE = 0.98
"""Share of the radiance of full pixels from which an aligned pixel counts as full: alignment mixes
neighbours, and moves corners by some pixels more than the middle, by which full pixels there
differ by up to 1 %."""


@dataclass(frozen=True)
class Capture:
    """All bands of one moment."""

    name: str
    """Name of the capture's files, such as 'IMG_0001'."""
    bands: tuple[RawBand, ...]

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(band.name for band in self.bands)

    @property
    def paths(self) -> list[Path]:
        return [band.path for band in self.bands]

    @property
    def absolute(self) -> bool:
        """Whether radiance and irradiance are in W m-2 (sr-1) um-1 (`RawBand.absolute`)."""
        return all(band.absolute for band in self.bands)

    @property
    def irradiance(self) -> Float[np.ndarray, " band"]:
        """Irradiance that the downwelling light sensor measured [W m-2 um-1], or in the maker's own
        unit. `InputError` where a band has none."""
        for band in self.bands:
            if band.irradiance is None:
                raise InputError(
                    "expected irradiance of a downwelling light sensor in the metadata, but there "
                    "is none. Was it plugged in? Use a panel: --panel NAME --panel-reflectance ...",
                    file=band.path,
                )
        return np.array([band.irradiance for band in self.bands], dtype=float)

    @double_precision
    def radiance(self) -> Float[np.ndarray, "band row column"]:
        """Radiance of each band on its own pixels [W m-2 sr-1 um-1], or in the maker's own unit,
        row 0 at the top; float32."""
        return self._radiance([band.counts.astype(float) for band in self.bands])

    @double_precision
    def full_radiance(self) -> Float[np.ndarray, "band row column"]:
        """Radiance [W m-2 sr-1 um-1] from which pixels are full."""
        return self._radiance([np.full(b.counts.shape, float(b.saturation)) for b in self.bands])

    def _radiance(self, counts: Sequence[NDArray[np.float64]]) -> NDArray[np.float32]:
        read = jax.jit(counts_to_radiance)
        pictures = (read(c, b.camera) for c, b in zip(counts, self.bands, strict=True))
        return np.stack([np.asarray(picture, np.float32) for picture in pictures])


@dataclass(frozen=True)
class AlignedCapture:
    """Radiance of a capture with all bands on the pixels of the first."""

    radiance: Float[np.ndarray, "band y x"]
    """Radiance of each pixel [W m-2 sr-1 um-1]; row 0 at the bottom of the picture."""
    full: Bool[np.ndarray, "band y x"]
    """True where a pixel is saturated, or next to one that is."""
    alignment: tuple[Alignment, ...] | None
    """Movement of each band; `None` where the bands were left as they are."""
    middle: tuple[float, float]
    """Column, and row from below, of the middle of the camera's picture; the aligned one is cut."""


def _named(path: Path) -> re.Match[str] | None:
    return next((found for name in _NAMES if (found := name.fullmatch(path.name))), None)


def capture_of(name: str) -> str:
    """Name of the capture that a file of one band is named after; of another file its stem.

    **Arguments:** `name` of the file.
    """
    found = _named(Path(name))
    return Path(name).stem if found is None else found["capture"]


def _joined(captures: dict[str, list[tuple[int, Path]]]) -> dict[str, list[tuple[int, Path]]]:
    """Captures of a Mavic 3 whose bands were written in two seconds under one number, as one."""
    kept: dict[str, list[tuple[int, Path]]] = {}
    last: dict[str, tuple[str, datetime]] = {}
    for name, group in captures.items():
        file = _named(group[0][1])
        if file and file.re is _NAMES[0]:
            time = datetime.strptime(file["time"], "%Y%m%d%H%M%S")
            before, then = last.get(file["number"], ("", time))
            near = abs((time - then).total_seconds()) <= _APART
            if near and {b for b, _ in kept.get(before, group)}.isdisjoint(b for b, _ in group):
                kept[before] += group
                continue
            last[file["number"]] = name, time
        kept[name] = group
    return kept


def _beginning(names: Sequence[str]) -> str:
    """What names have in common at their beginning."""
    alike = itertools.takewhile(lambda letters: len(set(letters)) == 1, zip(*names))
    return "".join(letters[0] for letters in alike)


def _stated_captures(files: Sequence[Path]) -> dict[Path, tuple[str, int]]:
    """Name of the capture and number of the band of pictures whose metadata state both, as those of
    a Phantom 4 Multispectral do, whatever the files are called. None of a folder whose first
    picture does not."""
    # Names of no DJI may be those of one whose pictures were called otherwise.
    files = [p for p in files if not (name := _named(p)) or name.re is _NAMES[-1]]
    found: dict[Path, tuple[str, int]] = {}
    of_capture: dict[str, list[Path]] = {}
    for path in files:
        with suppress(InputError), open_raster(path, "a picture of one band") as file:
            capture, band = (
                "".join(file.xmp.get(key, [])[:1]).strip() for key in ("CaptureUUID", "BandName")
            )
            plain = re.sub(r"[^a-z]", "", band.lower())
            if capture and plain in _P4M_ORDER:
                of_capture.setdefault(capture, []).append(path)
                found[path] = capture, _P4M_ORDER.index(plain) + 1
        if not found:
            return {}
    names = {key: _beginning([p.stem for p in own]) for key, own in of_capture.items()}
    alike = Counter(names.values())
    names = {key: own if own and alike[own] == 1 else key for key, own in names.items()}
    return {path: (names[key], number) for path, (key, number) in found.items()}


def find_captures(paths: Sequence[str | Path]) -> dict[str, list[Path]]:
    """The files of each capture, by the capture's name and in order of their bands.

    **Arguments:**

    - `paths`: folders, of which all files are taken that are called as a camera calls them
      (`NAME_1.tif`, `NAME_2.tif`, ... of a MicaSense; `DJI_TIME_NUMBER_MS_G.TIF`, `_MS_R`, ... of a
      Mavic 3 Multispectral; `DJI_NNN1.TIF` to `DJI_NNN5.TIF` of a Phantom 4 Multispectral); or
      files, of which only those given are.

    **Returns:** the files of each capture, by what is common to their names.

    **Raises:** `InputError` for a path that does not exist, a file of another pattern of name, or a
    folder without such files.
    """
    captures: dict[str, list[tuple[int, Path]]] = {}
    asked = list(map(Path, paths))
    of_singles = _stated_captures([p for p in asked if p.is_file()])
    for given in asked:
        files, stated = [given], of_singles
        if given.is_dir():
            files = [p for p in sorted(given.iterdir()) if p.suffix.lower() in (".tif", ".tiff")]
            stated = _stated_captures(files)
            files = [p for p in files if p in stated or _named(p)]
            if not files:
                raise InputError(
                    "expected pictures of a multispectral camera called NAME_1.tif, NAME_2.tif, "
                    "..., or DJI_..._MS_G.TIF, ..., but this folder has none",
                    file=given,
                )
        for path in files:
            if path in stated:
                captures.setdefault(stated[path][0], []).append((stated[path][1], path))
                continue
            name = _named(path)
            if name is None:
                raise InputError(
                    "expected a picture of one band, called NAME_1.tif, NAME_2.tif, ..., or "
                    "DJI_..._MS_G.TIF, ..., as the camera names them",
                    file=path,
                )
            existing_file(path, "a picture of one band")
            band = name["band"]
            entry = (int(band) if band.isdecimal() else _ORDER.index(band.upper()) + 1, path)
            group = captures.setdefault(name["capture"], [])
            if entry not in group:
                group.append(entry)
    captures = _joined(captures)
    for name_of, group in captures.items():
        numbers = [number for number, _ in group]
        if len(set(numbers)) != len(numbers):
            raise InputError(
                f"expected one file for each band of capture {name_of}, but band "
                f"{max(numbers, key=numbers.count)} is there more than once, in several folders",
                file=group[0][1],
            )
    return {name: [path for _, path in sorted(group)] for name, group in captures.items()}


def same_capture(path: str | Path, captures: dict[str, list[Path]]) -> tuple[str, list[Path]]:
    """A capture by its name, or by one of its files.

    **Arguments:**

    - `path`: a key of `captures`, or a file; the other files of its capture lie beside it.
    - `captures`: files by the name of their capture, as of `find_captures`.

    **Returns:** name and files of the capture.

    **Raises:** `InputError` where there is none.
    """
    given = Path(path)
    if str(path) in captures:
        return str(path), captures[str(path)]
    if given.is_file() and _named(given) is not None:
        beside = find_captures([given.parent])
        return next((name, paths) for name, paths in beside.items() if given in paths)
    raise InputError(
        f"expected the name of a capture or one of its files, but got {str(path)!r}."
        f"{did_you_mean(str(path), list(captures))} There are: {', '.join(captures)}."
    )


def _is_left_out(path: Path) -> bool:
    """Whether a picture is of emitted light, as the sixth of an Altum, or of all light (a
    RedEdge-P's and Altum-PT's panchromatic one): of another size, and no band."""
    with open_raster(path, "a raw picture of a multispectral camera") as file:
        stated = Stated(file.xmp, {})
    name = "".join(stated.xmp.get("BandName", [])[:1]).strip().upper()
    wavelength = (stated.maybe("CentralWavelength") or [0.0])[0]
    return name == "LWIR" or name.startswith("PANCHRO") or wavelength > _LONGEST_REFLECTED


def usable_captures(
    captures: dict[str, list[Path]],
) -> tuple[dict[str, list[Path]], dict[str, InputError], dict[str, InputError]]:
    """Captures that can be read and have the bands of most of them, and why not of the others.

    **Arguments:** `captures`: files by the name of their capture, as of `find_captures`.

    **Returns:** the files of those; the errors of the others; the errors of those among the first
    that have no irradiance of a light sensor (`Capture.irradiance`).

    **Raises:** `InputError` of the first where none can be read. Warns where most captures of a DJI
    lack a band of their camera.
    """
    bands: dict[str, tuple[str, ...]] = {}
    skipped: dict[str, InputError] = {}
    dark: dict[str, InputError] = {}
    for name, paths in captures.items():
        try:
            capture = read_capture(name, paths)
            bands[name] = capture.names
        except InputError as error:
            skipped[name] = error
            continue
        try:
            _ = capture.irradiance
        except InputError as error:
            dark[name] = error
    if not bands:
        raise next(iter(skipped.values()))
    counts = Counter(bands.values())
    usual = max(counts, key=lambda names: (counts[names], len(names)))
    name = next(name for name, found in bands.items() if found == usual)
    file = _named(captures[name][0])
    whole = {_NAMES[0]: 4, _NAMES[1]: 5}.get(file.re, 0) if file else 0
    if len(usual) < whole:
        warnings.warn(
            f"{name} has {len(usual)} of its camera's {whole} bands: {', '.join(usual)}",
            stacklevel=2,
        )
    for name, found in bands.items():
        if missing := [band for band in usual if band not in found]:
            skipped[name] = InputError(
                f"expected the bands {', '.join(usual)} as of the other captures, but "
                f"{', '.join(missing)} is missing",
                file=captures[name][0],
            )
    return {n: paths for n, paths in captures.items() if n not in skipped}, skipped, dark


@double_precision
def read_capture(name: str, paths: Sequence[Path]) -> Capture:
    """Read the files of one capture, each with its metadata (`read_band`).

    **Arguments:** `name`: of the capture, for errors and reports; `paths`: its files, one for each
    band.

    **Returns:** a `Capture`, bands in the order of the files, without a thermal or panchromatic
    one, whose picture is of another size.

    **Raises:** `InputError` where they are not of one capture, of one size, or of different bands.
    """
    bands = tuple(read_band(path) for path in paths if not _is_left_out(path))
    if not bands:
        raise InputError(
            "expected bands of reflected light, but all are thermal or panchromatic", file=paths[0]
        )
    first = bands[0]
    for band in bands[1:]:
        if band.capture != first.capture:
            raise InputError(
                f"expected all files of one capture, but this is of {band.capture} "
                f"({band.time}) and {first.path.name} of {first.capture} ({first.time})",
                file=band.path,
            )
        if band.counts.shape != first.counts.shape:
            raise InputError(
                f"expected {first.counts.shape[1]} x {first.counts.shape[0]} pixels as in "
                f"{first.path.name}, but this has {band.counts.shape[1]} x "
                f"{band.counts.shape[0]}",
                file=band.path,
            )
    names = [band.name for band in bands]
    if len(set(names)) != len(names):
        raise InputError(f"expected different bands, but got {', '.join(names)}", file=first.path)
    return Capture(name, bands)


@double_precision
def aligned_radiance(capture: Capture, *, align: bool = True) -> AlignedCapture:
    """Radiance of a capture, its bands laid on the first: by the maker's own calibration of the
    lenses, where the files have one, and then by the picture (`fynjax.app.io.raster.align_bands`).

    **Arguments:** `capture`: all bands of one moment; `align`: false leaves every band on its own
    pixels.

    **Returns:** an `AlignedCapture`: radiance [W m-2 sr-1 um-1], full pixels, and how bands were
    moved.

    **Raises:** `InputError` as `align_bands`; `MissingExtraError` without scikit-image.
    """
    radiance, full = capture.radiance()[:, ::-1], capture.full_radiance()[:, ::-1]
    rows, columns = radiance.shape[1:]
    middle = (0.5 * (columns - 1), 0.5 * (rows - 1))
    if not align or len(capture.bands) == 1:
        return AlignedCapture(radiance, radiance >= full * (1.0 - 1e-6), None, middle)
    with in_file(capture.bands[0].path):
        (radiance, full), (low, left) = _on_frame(capture, radiance, full)
        values, cut, alignments = align_bands(radiance)
    near = np.empty(values.shape, bool)
    for k, band in enumerate(alignments):
        # Where the first band's pixels lie in this one: the rest of the map moves it too little.
        places = (
            np.clip(np.arange(s.start, s.stop) - round(shift), 0, size - 1)
            for s, shift, size in zip(cut, band.shift[::-1], full.shape[1:], strict=True)
        )
        near[k] = values[k] >= _CLOSE * full[k][np.ix_(*places)]
    middle = (middle[0] - left - cut[1].start, middle[1] - low - cut[0].start)
    return AlignedCapture(values, _grown(near), tuple(alignments), middle)


def _on_frame(
    capture: Capture, *pictures: Float[np.ndarray, "band y x"]
) -> tuple[list[Float[np.ndarray, "band row column"]], tuple[int, int]]:
    """Pictures on the frame that the lenses share, cut to what all bands cover, and the row and
    column of that where the cut begins."""
    registrations = [band.registration for band in capture.bands]
    if all(registration is None for registration in registrations):
        return list(pictures), (0, 0)

    def moved_by(
        registration: Registration | None, band: Float[np.ndarray, "y x"]
    ) -> Float[np.ndarray, "row column"]:
        return band if registration is None else registration.on_frame(band[::-1])[::-1]

    moved = [np.stack(list(map(moved_by, registrations, picture))) for picture in pictures]
    # The side with the most pixels that some band lacks goes first, until none are left.
    covered = np.isfinite(moved[0]).all(axis=0)
    low, left = 0, 0
    high, right = covered.shape
    while not (inside := covered[low:high, left:right]).all():
        edges = (inside[0], inside[:, 0], inside[-1], inside[:, -1])
        worst = int(np.argmin([edge.mean() for edge in edges]))
        low, left = low + (worst == 0), left + (worst == 1)
        high, right = high - (worst == 2), right - (worst == 3)
    if 2 * inside.size < covered.size:
        raise InputError("by the camera's own calibration its bands show different ground")
    return [picture[:, low:high, left:right] for picture in moved], (low, left)


def _grown(mask: Bool[np.ndarray, "band y x"]) -> Bool[np.ndarray, "band y x"]:
    """Every marked pixel with its eight neighbours."""
    from scipy.ndimage import binary_dilation

    return binary_dilation(mask, np.ones((1, 3, 3), bool))
