"""The ground of a plot from its files: spectra of soil and covers, and where the covers lie."""

from pathlib import Path

import numpy as np
from jaxtyping import Float64

from fynjax._core.errors import InputError
from fynjax.io.plot import Plot
from fynjax.io.raster import METRES, read_cover_map, read_over_plot
from fynjax.io.spectra import reflectances
from fynjax.scene import COVERS, random_patches, shipped_covers


def soil_spectra(plot: Plot, wavelength: np.ndarray) -> Float64[np.ndarray, "2 wavelength"] | None:
    """The user's soil, as dry and as wet soil; `None` takes the shipped ones."""
    if plot.ground.spectrum is None:
        return None
    soil = _one_spectrum(plot.ground.spectrum, "soil", wavelength)
    return np.stack([soil, soil])


def cover_spectra(plot: Plot, wavelength: np.ndarray) -> Float64[np.ndarray, "cover wavelength"]:
    """Reflectance of litter, char and rock: the user's, where there is one."""
    spectra = shipped_covers(wavelength)
    for k, (cover, path) in enumerate(zip(COVERS, plot.ground.spectra, strict=True)):
        if path is not None:
            spectra[k] = _one_spectrum(path, cover, wavelength)
    return spectra


def cover_patches(plot: Plot, seed: int) -> Float64[np.ndarray, "kind y x"] | None:
    """Relative density of soil and covers in the voxel columns; `None`: mixed alike everywhere.

    From the plot's map, whose means are then the fractions, or drawn in patches of its width.
    """
    ground = plot.ground
    columns, rows = (round(side / plot.voxel_m) for side in plot.size_m)
    if ground.map is not None:
        return read_cover_map(
            ground.map,
            plot.size_m,
            (rows, columns),
            origin_m=plot.map_origin_m,
            option="map_origin_m",
        )
    if ground.patch_m == 0.0:
        return None
    scale = ground.patch_m / plot.voxel_m
    return random_patches((rows, columns), scale, periodic=plot.boundary == "periodic", seed=seed)


def ground_heights(plot: Plot) -> Float64[np.ndarray, "y x"] | None:
    """Height of the ground in the middles of the voxel columns above its lowest, y to the north
    [m]; `None`: level.

    **Raises:** `InputError` for a raster that cannot be read or placed, has several bands, states
    another unit than metres, or differs by more than twice the plot's side.
    """
    if plot.terrain is None:
        return None

    part = read_over_plot(
        plot.terrain,
        "a raster of heights",
        plot.size_m,
        origin_m=plot.map_origin_m,
        option="map_origin_m",
    )
    part.check_single(
        "a raster of one band, the height of the ground",
        f"Make one with `fynjax terrain {plot.terrain.name}`.",
    )
    if part.units[0].lower() not in METRES:
        raise InputError(
            f"expected heights in metres, but the band says {part.units[0]!r}. `fynjax terrain "
            f"{plot.terrain.name} --height-unit ...` makes a raster in metres.",
            file=plot.terrain,
        )
    columns, rows = (round(side / plot.voxel_m) for side in plot.size_m)
    height = part.at_centres((rows, columns))[0]
    relief = float(np.ptp(height))
    if relief > 2.0 * max(plot.size_m):
        raise InputError(
            f"expected heights of the ground in metres, but over the plot they differ by "
            f"{relief:g} m. Another unit, or a no-data value that the file does not declare?",
            file=plot.terrain,
        )
    return height - height.min()


def _one_spectrum(path: Path, what: str, wavelength: np.ndarray) -> np.ndarray:
    """The only spectrum of a file, on `wavelength` [nm], which it must cover."""
    spectra = reflectances(path)
    if len(spectra) > 1:
        raise InputError(
            f"expected the spectrum of one {what}, but got {len(spectra)}; keep one column",
            file=path,
        )
    wave, values = spectra[0]
    known = np.isfinite(values)
    wave, values = wave[known], values[known]
    if wave.size == 0:
        raise InputError(f"a {what} spectrum must have reflectance, but has none", file=path)
    if wave[0] > wavelength[0] or wave[-1] < wavelength[-1]:
        raise InputError(
            f"a {what} spectrum must cover {wavelength[0]:g}-{wavelength[-1]:g} nm for this "
            f"sensor, but covers {wave[0]:g}-{wave[-1]:g} nm",
            file=path,
        )
    return np.interp(wavelength, wave, values)
