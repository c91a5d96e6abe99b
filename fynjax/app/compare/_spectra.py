"""Spectra as a comparison needs them: from tables, libraries, ASD files, cubes and NetCDF."""

import re
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import xarray as xr
from jaxtyping import Float
from numpy.typing import NDArray

from fynjax._core.errors import LARGEST, InputError, in_file, names_file, refusing
from fynjax._core.files import existing_file, how_to_import
from fynjax._core.memory import bounded_memory
from fynjax._core.progress import stage
from fynjax._core.spectral import check_wavelength
from fynjax.app.compare._images import thinning
from fynjax.app.io.raster import check_netcdf, check_reflectance, open_raster
from fynjax.app.io.spectra import check_widths, read_header, read_usable_spectra
from fynjax.metrics import WATER_WINDOWS

_RASTERS = (".img", ".bil", ".bip", ".bsq", ".dat", ".tif", ".tiff")
_NETCDF = {".nc", ".nc4", ".h5", ".hdf5"}
_BESIDE = re.compile(r"good|flag|mask|quality|uncertain|error|(?:^|_)(?:unc|std|sd)(?:_|$)", re.I)
"""Names of variables that say how good others are."""


@dataclass(frozen=True)
class SpectraSample:
    """Spectra of one side of a comparison, all on one grid."""

    files: tuple[Path, ...]
    wavelength: Float[np.ndarray, " wavelength"]
    """Band centres [nm], increasing; bands without any value are left out."""
    values: Float[np.ndarray, "spectrum wavelength"]
    """Reflectance [-]; every value is finite."""
    fwhm: Float[np.ndarray, " wavelength"] | None
    """Full widths at half maximum [nm], where the file states them."""
    left_out: int
    """Spectra with a missing value where most others have one."""
    dead: int
    """Bands without a value in most spectra."""
    step: int = 1
    """Step of the rows and columns of a cube that were read; 1 is all."""

    def description(self) -> str:
        """What was read, in sentences."""
        grid = self.wavelength
        text = (
            f"{len(self.values)} spectra of {grid.size} bands, {grid[0]:.0f} to {grid[-1]:.0f} nm"
        )
        if self.step > 1:
            text += f"; every {self.step}th row and column of the cube read"
        if self.left_out:
            text += f"; {self.left_out} with missing values left out"
        if self.dead:
            text += f"; {self.dead} bands without values left out"
        return text + "."


def read_spectra_sample(
    paths: Sequence[str | Path], *, most_spectra: int = 20_000
) -> SpectraSample:
    """Read the spectra of one or several files, all on one grid of wavelengths.

    Tables, ASD files and spectral libraries as `fynjax.app.io.spectra.read_spectra` (but single
    spectra that cannot be used are left out, with a warning); cubes as ENVI files (with their
    header beside them) or GeoTIFF with the wavelengths in its tags, in blocks of rows; NetCDF with
    a variable over a dimension that has wavelengths.

    A band is left out in which fewer than half of the spectra have a value, or all have the same
    value of zero or less, with which products fill bands that the air hides; or that the header's
    bad-band list (`bbl`) names. Then a spectrum is left out that still misses a value.

    **Arguments:** `paths`: the files; `most_spectra`: of a cube with more pixels every k-th row and
    column is read.

    **Returns:** a `SpectraSample`: wavelengths [nm] and reflectance [spectrum, wavelength] [-].

    **Raises:** `InputError` for files that are missing or cut short, have no wavelengths, differ in
    their grids, are no fractions, or leave nothing to compare.
    """
    files = tuple(Path(path) for path in paths)
    parts = [_read(path, most_spectra) for path in files]
    grid, _, fwhm, step = parts[0]
    for path, (other, *_) in zip(files[1:], parts[1:], strict=True):
        with in_file(path):
            _check_grid(grid, other, files[0].name)
    values = np.concatenate([rows for _, rows, _, _ in parts])
    finite = np.abs(values) <= LARGEST
    if (wrong := ~finite & ~np.isnan(values)).any():
        warnings.warn(
            f"{files[0]}: {int(wrong.sum())} of {wrong.size} values are infinite or beyond "
            f"{LARGEST:g}. They are taken for missing data.",
            stacklevel=2,
        )
    some = finite.any(axis=1)
    alive = finite[some].mean(axis=0) >= 0.5 if some.any() else np.zeros(grid.size, bool)
    if some.sum() > 1:
        first = values[some][0]
        alive &= ~((first <= 0.0) & (values[some] == first).all(axis=0))
    whole = finite[:, alive].all(axis=1) & some
    if alive.sum() < 2 or not whole.any():
        words = f"expected reflectance spectra, but none of {len(values)} has values in most bands"
        raise InputError(words, file=files[0])
    values = values[whole][:, alive]
    _check_fractions(grid[alive], values, files[0])
    return SpectraSample(
        files=files,
        wavelength=grid[alive],
        values=values,
        fwhm=None if fwhm is None else fwhm[alive],
        left_out=int(some.sum() - whole.sum()),
        dead=int((~alive).sum()),
        step=step,
    )


_Part = tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64] | None, int]
"""Wavelengths, spectra, widths, and the step of rows and columns."""


@names_file
def _read(path: Path, most: int) -> _Part:
    existing_file(path, "spectra")
    suffix = path.suffix.lower()
    if suffix in _NETCDF:
        return _read_netcdf(path, most)
    header = _header_of(path)
    if header is not None and "librar" not in str(read_header(header).get("file type", "")).lower():
        return _read_cube(path, most)
    if header is None and suffix in _RASTERS:
        return _read_cube(path, most)
    with stage(f"Read {path.name}"):
        spectra, refused = read_usable_spectra(path)
    if refused and not spectra:
        raise refused[0][1]
    if refused:
        name, reason = refused[0]
        warnings.warn(
            f"{path}: {len(refused)} of {len(refused) + len(spectra)} spectra cannot be used and "
            f"are left out, such as {name!r}: {reason}",
            stacklevel=3,
        )
    spectra = [s for s in spectra if s.reflectance is not None]
    if not spectra:
        raise InputError("expected reflectance, but the file has only transmittance")
    grid, first = spectra[0].wavelength, f"spectrum {spectra[0].name!r}"
    for spectrum in spectra:
        _check_grid(grid, spectrum.wavelength, first, spectrum.name)
    return grid, np.stack([np.asarray(s.reflectance) for s in spectra]), None, 1


def _header_of(path: Path) -> Path | None:
    """The ENVI header that belongs to a data file, or the file itself if it is a header."""
    if path.suffix.lower() == ".hdr":
        return path
    beside = [path.with_name(path.name + ".hdr")]
    if path.suffix.lower() in (*_RASTERS, ".sli", ".slb"):  # a.csv has nothing to do with a.hdr
        beside.append(path.with_suffix(".hdr"))
    return next((p for p in beside if p.is_file()), None)


def _check_grid(
    grid: NDArray[np.float64], other: NDArray[np.float64], first: str, name: str = ""
) -> None:
    if grid.shape != other.shape or np.abs(grid - other).max() > 0.1:
        raise InputError(
            f"expected the wavelengths of {first} ({grid.size} bands, {grid[0]:g} to "
            f"{grid[-1]:g} nm), but {name or 'this file'} has {other.size}, {other[0]:g} to "
            f"{other[-1]:g} nm. Compare spectra of one instrument at a time."
        )


def _check_fractions(grid: NDArray[np.float64], values: NDArray[np.float64], path: Path) -> None:
    """Refuse values that are no reflectance, where the air lets one see."""
    clear = (grid >= 400.0) & (grid <= 2450.0)
    for low, high in WATER_WINDOWS:
        clear &= ~((grid >= low) & (grid <= high))
    shown = np.median(values[:, clear], axis=0) if clear.any() else np.zeros(1)
    if shown.min() < -0.2:
        raise InputError(
            f"expected reflectance of at least 0, but the median of a band is {shown.min():g}. "
            "Is it a no-data value? State it in the header (data ignore value).",
            file=path,
        )
    if clear.any():
        check_reflectance(float(shown.max()), path)


# -- cubes ----------------------------------------------------------------------------------


def _read_cube(path: Path, most: int) -> _Part:
    with open_raster(path, "an image cube") as file:
        grid, fwhm, good = file.wavelengths, file.fwhm, file.good
        known = int(np.isfinite(grid).sum())
        if known != grid.size or known < 2:
            raise InputError(
                f"expected a cube with a wavelength for each of {grid.size} bands, but {known} "
                "are stated (ENVI: `wavelength` in the header; GeoTIFF: the tag `wavelength` of "
                f"each band).{how_to_import(path)}"
            )
        step = thinning(*file.shape, most)
        cube = file.read(step=step, zero_is_data=False)
    values = np.where(good, cube.values[:, ::-1].reshape(grid.size, -1).T, np.nan)
    order = np.argsort(grid, kind="stable")
    grid = check_wavelength(grid[order], f"{path}: the wavelengths")
    return grid, values[:, order], None if np.isnan(fwhm).any() else fwhm[order], step


# -- NetCDF ---------------------------------------------------------------------------------


def _read_netcdf(path: Path, most: int) -> _Part:
    check_netcdf(path)
    broken = (OSError, RuntimeError, ValueError, AttributeError, TypeError, LookupError)
    with (
        refusing(*broken, words="cannot be read as NetCDF ({error}). Is it cut short?"),
        warnings.catch_warnings(action="ignore", category=xr.SerializationWarning),
        np.errstate(all="ignore"),  # of two marks of no data, and of scales beyond floats
        bounded_memory(path),
        xr.open_datatree(path, engine="netcdf4") as tree,
    ):
        nodes = [node.to_dataset(inherit=True) for node in tree.subtree]
        waves = _wavelengths_in(nodes)
        if waves is None:
            raise InputError(
                "expected NetCDF with a variable `wavelength` in nm (or µm), but none has that "
                "name or standard name"
            )
        name, grid, widths = waves
        if widths is not None:
            check_widths(widths)
        return _spectra_in(nodes, name, grid, widths, most, path)


def _wavelengths_in(
    nodes: Sequence[xr.Dataset],
) -> tuple[str, NDArray[np.float64], NDArray[np.float64] | None] | None:
    """Dimension, wavelengths [nm] and widths [nm], wherever in the file they stand."""
    centres, width = None, None
    for node in nodes:
        for name, variable in node.variables.items():
            if variable.ndim != 1 or variable.dtype.kind not in "fiu":
                continue
            standard = str(variable.attrs.get("standard_name", ""))
            plain = str(name).lower().rstrip("s")
            is_wave = plain in ("wavelength", "band_center", "band_centre", "wavelength_center")
            if is_wave or "radiation_wavelength" in standard:
                centres = centres or (str(variable.dims[0]), _nanometres(variable))
            if plain == "fwhm":
                width = width if width is not None else _nanometres(variable, 0.5)
    if centres is None:
        return None
    fits = width is not None and width.shape == centres[1].shape and np.isfinite(width).all()
    return centres[0], centres[1], width if fits else None


def _nanometres(variable: xr.Variable, largest_micro: float = 100.0) -> NDArray[np.float64]:
    values = np.asarray(variable.values, float)
    known = values[~np.isnan(values)]
    return values * 1000.0 if known.size and known.max() < largest_micro else values


def _spectra_in(
    nodes: Sequence[xr.Dataset],
    dimension: str,
    grid: NDArray[np.float64],
    widths: NDArray[np.float64] | None,
    most: int,
    path: Path,
) -> _Part:
    candidates = [
        (str(name), variable)
        for node in nodes
        for name, variable in node.variables.items()
        if variable.dtype.kind in "fiu"
        and dimension in variable.dims
        and variable.sizes[dimension] == grid.size
        and "wavelength" not in str(name).lower()
        and str(name).lower() not in ("fwhm", dimension.lower())
    ]
    named = [c for c in candidates if "reflectance" in c[0].lower() and not _BESIDE.search(c[0])]
    named.sort(key=lambda one: one[0].lower() != "reflectance")
    choice = named[:1] or (candidates if len(candidates) == 1 else [])
    if not choice:
        listed = ", ".join(name for name, _ in candidates) or "none"
        raise InputError(
            f"expected a variable called reflectance over {dimension!r}, but those over it are: "
            f"{listed}.{how_to_import(path)}"
        )
    variable = choice[0][1].transpose(..., dimension)
    step = 1
    if variable.ndim == 3:
        step = thinning(variable.shape[0], variable.shape[1], most)
        variable = variable[::step, ::step]
    values = np.asarray(variable.values, float).reshape(-1, grid.size)
    order = np.argsort(grid, kind="stable")
    grid = check_wavelength(grid[order], f"{path}: the wavelengths")
    return grid, values[:, order], None if widths is None else widths[order], step
