"""The ground of a plot from its files: spectra of soil and covers, and where the covers lie; the
spectrum of dead tissue."""

from pathlib import Path

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float64

from fynjax._core.errors import InputError
from fynjax._core.parameters import parameters_of
from fynjax.app.io.plot import Plot
from fynjax.app.io.raster import METRES, read_cover_map, read_over_plot
from fynjax.app.io.spectra import read_spectra_file, reflectances
from fynjax.scene import COVERS, Ground, GroundParameters, Spectrum


def plot_ground(plot: Plot, patches: Float64[np.ndarray, "kind y x"] | None) -> Ground:
    """Spectra of soil and covers, the user's where there are any, lying in `patches`, or in such as
    the scene draws."""

    def read(path: Path | None, what: str) -> Spectrum | None:
        return None if path is None else one_spectrum(path, what)

    ground = plot.ground
    covers = {cover: read(getattr(ground, cover), cover) for cover in COVERS}
    soil = ground.soil if isinstance(ground.soil, Path) else None
    return Ground(
        soil=read(soil, "soil"), patches=patches, patch=ground.patch_m, shape=ground.rpv, **covers
    )


def ground_parameters(plot: Plot, fractions: tuple[float, ...] | None = None) -> GroundParameters:
    """What a plot's file states of its ground, the parameters' defaults filled in; `fractions` of
    litter, char and rock [-] instead of the file's."""
    names = parameters_of(GroundParameters)
    values = {name: getattr(plot.ground, name) for name in names}
    if values["moisture"] is None and plot.ground.soil == "wet":
        values["moisture"] = 1.0
    # The default is learned of fynbos with the shipped bark in place of dead tissue.
    shipped = plot.dead_tissue is None and plot.shrubland == "fynbos"
    if values["wood_brightness"] is None and not shipped:
        values["wood_brightness"] = 1.0
    if fractions is not None:
        values |= {f"{cover}_fraction": f for cover, f in zip(COVERS, fractions, strict=True)}
    return GroundParameters(
        **{
            name: jnp.asarray(record.default if values[name] is None else values[name])
            for name, record in names.items()
        }
    )


def dead_tissue(plot: Plot) -> Spectrum | None:
    """The user's spectrum of dead tissue in live shoots, where there is one."""
    return None if plot.dead_tissue is None else one_spectrum(plot.dead_tissue, "dead tissue")


def cover_patches(plot: Plot) -> Float64[np.ndarray, "kind y x"] | None:
    """Relative density of soil and covers in the voxel columns by the plot's map, whose means are
    then the fractions; `None`: there is no map."""
    if plot.ground.map is None:
        return None
    columns, rows = (round(side / plot.voxel_m) for side in plot.size_m)
    return read_cover_map(
        plot.ground.map,
        plot.size_m,
        (rows, columns),
        origin_m=plot.map_origin_m,
        option="map_origin_m",
    )


def ground_heights(plot: Plot) -> Float64[np.ndarray, "y x"] | None:
    """Height of the ground in the middles of the voxel columns, y to the north, as the map of the
    plot's terrain has it [m]; `None`: level.

    **Arguments:** `plot`, whose `terrain` is the map.

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
    return height


def one_spectrum(path: Path, what: str, passed: bool = False) -> Spectrum:
    """The only spectrum of a file: reflectance, or transmittance if that is `passed`.

    **Arguments:** `path`, the file; `what` it is of, for errors.

    **Raises:** `InputError` for a file that cannot be read, that has several spectra, or none.
    """
    if passed:
        # A table does not say what its columns are: there they count as reflectance.
        pairs = [
            (s.wavelength, s.reflectance if s.transmittance is None else s.transmittance)
            for s in read_spectra_file(path)
        ]
        spectra = [(wave, values) for wave, values in pairs if values is not None]
    else:
        spectra = reflectances(path)
    if len(spectra) > 1:
        raise InputError(
            f"expected the spectrum of one {what}, but got {len(spectra)}; keep one column",
            file=path,
        )
    wave, values = spectra[0]
    # Gaps, such as the water bands of a field spectrum, are bridged by a line.
    known = np.isfinite(values)
    if not known.any():
        raise InputError(f"a {what} spectrum must have reflectance, but has none", file=path)
    return Spectrum.of(wave[known], values[known], f"a {what} spectrum", path)
