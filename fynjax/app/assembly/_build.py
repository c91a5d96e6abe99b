"""From a plot's files to a plot that can be rendered."""

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from typing import Literal

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from fynjax._core.dry_run import counted
from fynjax._core.errors import InputError
from fynjax._core.precision import drawn_in_double
from fynjax.app.assembly._ground import (
    cover_patches,
    dead_tissue,
    ground_heights,
    ground_parameters,
    one_spectrum,
    plot_ground,
)
from fynjax.app.assembly._leaf_spectra import (
    fit_or_check,
    leaf_instrument,
    mean_leaf,
    measured_leaves,
)
from fynjax.app.assembly._memory import check_memory
from fynjax.app.assembly._plants import read_plant
from fynjax.app.io.plot import Plot, plot_spreads, read_sky, read_sky_pattern, with_parameter_table
from fynjax.app.io.raster import read_probability_map
from fynjax.app.io.spectra import reflectances
from fynjax.canopy import MeshPlant
from fynjax.leaf import AbstractMeasurement
from fynjax.scene import (
    LEAF_FIELDS,
    USUAL_LEAF,
    LeafRow,
    LightParameters,
    MaterialParameters,
    PlantingRules,
    PlotParameters,
    Scene,
    Species,
    SpeciesRow,
    Spectrum,
    build_scene,
    check_projected_scene,
    drawn_leaves,
    hard_counts,
    leaf_parameters,
    leaves_of,
    plant_materials,
    room_needed,
    species_parameters,
    with_areas,
)


@drawn_in_double
def build_plot(
    plot: Plot,
    *,
    seed: int | None = None,
    rounding: Literal["up", "random"] | None = None,
    dtype: str = "float32",
) -> tuple[Scene, PlotParameters]:
    """The scene of a plot and its parameters as the files state them.

    Fits PROSPECT to the measured spectra that the leaf table names.

    **Arguments:**

    - `plot`: as `read_plot` gives it.
    - `seed`: of everything random; the plot file's if left out.
    - `rounding`: of the number of plants: "up" as eq. (10) has it, or "random", whose mean over
      plantings is the real number, as a fit to a measurement means it; left out, "up" where covers
      are the article's, and "random" where they are projected.
    - `dtype`: floating type that the scene is computed in, "float32" or "float64".

    **Raises:** `InputError` for a spectrum or map that cannot be used, and where the plants find no
    room on the plot or in memory.
    """
    seed = plot.seed if seed is None else seed
    check_memory(plot, room=PlantingRules.room if plot.known_crowns is None else 1.0)
    patches, fractions = cover_patches(plot), None
    if patches is not None:
        fractions = tuple(patches[1:].mean(axis=(1, 2)).tolist())
    described = {(row.taxon, row.material) for row in plot.leaves if row.material}
    plants = [
        None
        if row.plant is None
        else read_plant(
            row.plant,
            row.growth_form,
            {name for taxon, name in described if taxon in (row.taxon, "*")},
        )
        for row in plot.species
    ]
    (leaves, leaf_spreads), instrument = _known_leaves(plot), leaf_instrument(plot)
    materials = plant_materials(
        plot.species,
        [_fitted(row, instrument)[0] for row in plot.leaves if row.material],
        plants,
        population=plot.shrubland,
        read=one_spectrum,
        file=plot.leaf_table,
    )
    parameters = plot_parameters(plot, fractions, plants, leaves, materials.parameters)
    # Places are held ready as for the tables, so that plants stay where a calibration had them.
    tables = parameters
    if plot.parameters is not None:
        parameters = with_parameter_table(parameters, plot.taxa, plot.parameters)
    rules = PlantingRules(
        size_variation=plot.size_variation,
        spacing=plot.spacing_m,
        attempts=plot.attempts,
        probability=_probability(plot),
        rounding=rounding or ("up" if plot.cover_definition == "article" else "random"),
        cover_definition=plot.cover_definition,
        softness=plot.softness,
        softness_plants=plot.softness_plants,
        structure=plot.structure_m,
    )
    heights = ground_heights(plot)

    def room(scene: Scene) -> float | Float[np.ndarray, " species"]:
        if plot.parameters is not None:
            _check_grid(scene, tables, parameters, plot.parameters)
            check_projected_scene(scene, parameters, plot.parameters)
        needed = room_needed(scene, tables, scene.counts(parameters))
        if not needed.any():
            return rules.room
        check_memory(plot, room=np.maximum(needed, rules.room))
        return np.maximum(needed, rules.room)

    scene = build_scene(
        [Species.of(*one) for one in zip(plot.species, leaves, materials.species, strict=True)],
        tables,
        extent=plot.size_m,
        voxel=plot.voxel_m,
        seed=seed,
        boundary=plot.boundary,
        rules=rules,
        ground=plot_ground(plot, patches),
        dead_tissue=dead_tissue(plot),
        hot_spot=plot.hot_spot,
        terrain=None if heights is None else heights - heights.min(),
        sky=_sky(plot),
        sky_pattern=None if plot.sky.pattern is None else read_sky_pattern(plot.sky.pattern),
        plants=materials.plants,
        crowns=plot.known_crowns,
        room=room,
        dtype=dtype,
    )
    if plot.parameters is not None:
        counted(lambda plan: replace(plan, plants=hard_counts(scene, parameters)))
    spreads = tuple((plot_spreads(plot) | leaf_spreads).items())
    return replace(scene, parameters=parameters, spreads=spreads), parameters


def _check_grid(
    scene: Scene, tables: PlotParameters, parameters: PlotParameters, path: Path
) -> None:
    """Raise `InputError` for plants of a table of parameters of which the plot's own tables have
    none, or that are higher than its grid."""
    height = np.asarray(parameters.species.height)
    for taxon, before, after in zip(
        scene.taxa, np.asarray(tables.species.cover), np.asarray(parameters.species.cover)
    ):
        if before == 0 and after > 0:
            raise InputError(
                f"{taxon} has a cover here, but none in the species table, where it must have some",
                file=path,
            )
    if (top := float(height.max())) > scene.grid.extent[2]:
        raise InputError(
            f"plants of {top:g} m are higher than the grid that the species table makes, "
            f"{scene.grid.extent[2]:g} m: raise the height there",
            file=path,
        )


@drawn_in_double
def plot_parameters(
    plot: Plot,
    fractions: tuple[float, ...] | None = None,
    plants: Sequence[MeshPlant | None] | None = None,
    leaves: Sequence[Sequence[LeafRow]] | None = None,
    materials: MaterialParameters | None = None,
) -> PlotParameters:
    """The parameters that a plot's files state, defaults of the growth forms filled in.

    **Arguments:**

    - `plot`: as `read_plot` gives it.
    - `fractions`: of litter, char and rock [-]; those of the plot file if left out.
    - `plants`: models of the species that have one, which give the leaf and wood area that the
      tables leave out.
    - `leaves`: of each species, as `plot_leaves` gives them; from the plot if left out.
    - `materials`: traits of further materials of the plants, as `plant_materials` gives them.

    **Raises:** `InputError` for a leaf spectrum that cannot be used.
    """
    rows: Sequence[SpeciesRow] = plot.species
    if plants is not None:
        rows = [with_areas(*pair) for pair in zip(rows, plants, strict=True)]
    leaves = plot_leaves(plot) if leaves is None else leaves
    return PlotParameters(
        species_parameters(rows, leaves, plot.shrubland, plants or ()),
        leaf_parameters(leaves),
        ground_parameters(plot, fractions),
        LightParameters(
            sun_zenith=jnp.asarray(plot.sun.zenith),
            sun_azimuth=jnp.asarray(plot.sun.azimuth),
            aerosol=jnp.asarray(plot.sky.aerosol_optical_depth),
        ),
        materials,
    )


def plot_leaves(plot: Plot) -> list[tuple[LeafRow, ...]]:
    """The leaves of each species of a plot: PROSPECT fitted to those that are spectra, and as many
    drawn as the plot file asks for where one is stated, by its seed: plants that are drawn anew
    have the same leaves.

    **Arguments:** `plot`, as `read_plot` gives it.

    **Raises:** `InputError` for a leaf spectrum that cannot be used.
    """
    return _known_leaves(plot)[0]


def _known_leaves(plot: Plot) -> tuple[list[tuple[LeafRow, ...]], dict[str, float]]:
    """`plot_leaves`, and how well those that were measured are known: relative standard deviations
    by the names of parameters, as of `table_spreads`."""
    # One leaf may be that of many species.
    fitted = cache(partial(_fitted, instrument=leaf_instrument(plot)))
    measured = measured_leaves(plot)
    own_leaves = leaves_of(plot.species, [*plot.leaves, *measured.rows], plot.shrubland)
    stated, spreads = [], dict(measured.spreads)
    for row, own in zip(plot.species, own_leaves, strict=True):
        found = [fitted(leaf) for leaf in own]
        stated.append([leaf for leaf, _ in found])
        # A leaf of '*' is one of any species, which says nothing of the spread between them.
        if all(leaf.spectrum is not None and leaf.taxon == row.taxon for leaf in own):
            spreads |= _together(row.taxon, [spread for _, spread in found])
    return drawn_leaves(stated, plot.leaf_variants, plot.seed), spreads


def _together(taxon: str, rows: Sequence[Mapping[str, float]]) -> dict[str, float]:
    """Spreads of the mean of rows of a leaf table: their mean, as if what the spectra are off by
    were common to all."""
    return {
        f"species.{taxon}.leaf.{trait}": float(np.mean([row[trait] for row in rows]))
        for trait in rows[0]
        if all(trait in row for row in rows)
    }


def _fitted(leaf: LeafRow, instrument: AbstractMeasurement) -> tuple[LeafRow, dict[str, float]]:
    """The leaf itself, or with the PROSPECT parameters that its spectrum asks for, and how well
    these are known."""
    if leaf.spectrum is None:
        return leaf, {}
    spectra = reflectances(leaf.spectrum)
    grid = np.arange(400.0, 2501.0)
    many = np.stack(
        [np.interp(grid, wave, values, left=np.nan, right=np.nan) for wave, values in spectra]
    )
    if not np.isfinite(many).any():
        raise InputError(
            "a leaf spectrum must have reflectance within 400-2500 nm, but has none",
            file=leaf.spectrum,
        )
    fit = fit_or_check(grid, many, instrument=instrument)
    if fit is None:
        return leaf.replace(**{name: getattr(USUAL_LEAF, name) for name in LEAF_FIELDS}), {}
    mean = mean_leaf(fit, np.ones(len(many), bool), leaf.spectrum.name)
    if mean is None:
        raise InputError("the leaf spectrum cannot be fitted: " + fit.status[0], file=leaf.spectrum)
    for sentence in mean.said:
        warnings.warn(sentence, stacklevel=2)
    return leaf.replace(**mean.traits), mean.spread


def _sky(plot: Plot) -> Spectrum | None:
    if plot.sky.table is None:
        return None
    return Spectrum.of(*read_sky(plot.sky.table), "the sky table", plot.file)


def _probability(plot: Plot) -> np.ndarray | None:
    if plot.probability_map is None:
        return None
    return read_probability_map(
        plot.probability_map, plot.size_m, origin_m=plot.map_origin_m, option="map_origin_m"
    )
