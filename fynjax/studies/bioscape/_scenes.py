"""Spectra of many plots as scenes, with one compilation for all of them.

Plots differ in species, numbers of plants and heights. Here they get one shape: the species stand
in slots, as many of each growth form as any plot needs, and what a plot does not fill is empty.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import groupby
from typing import Annotated, Literal

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from pydantic import Field

from fynjax._core.errors import InputError
from fynjax.app.assembly import plot_parameters
from fynjax.app.io.plot import Plot
from fynjax.canopy import VoxelGrid
from fynjax.diversity import spectral_variety
from fynjax.radiation import Accuracy, render, solve_light
from fynjax.scene import (
    AimedSensor,
    PlantingRules,
    PlotParameters,
    Scene,
    Species,
    SpeciesRow,
    build_scene,
)

ACCURACY = Accuracy(sublayers=2, coarsening=(2, 2), levels=2, refine=False, solves=25)


class PlotSpectrum(eqx.Module):
    """Simulated spectrum of a plot at nadir."""

    reflectance: Float[np.ndarray, " band"]
    """Mean reflectance factor of the plot in each band [-]."""
    ground_seen: Float[np.ndarray, ""]
    """Share of the plot where the ground shows between leaves and stems [-]."""
    variety: Float[np.ndarray, " metric"]
    """Spectral variety of the pixels, each of a voxel's edge, in the order of `VARIETY`."""
    residual: Float[np.ndarray, ""]
    """Largest share of the source of the diffuse light that its solution leaves over [-]."""


_LARGEST_EVEN = 0.125
"""Voxels up to this may be filled evenly [m]."""


@dataclass(frozen=True)
class Resolution:
    """Size and voxels of simulated plots. Raises `InputError` where voxels do not fill a plot."""

    size_m: Annotated[float, Field(ge=1.0, le=100.0)] = 5.0
    """Side of the square that stands for a plot [m]; it repeats itself."""
    voxel_m: Annotated[float, Field(ge=0.02, le=1.0)] = 0.1
    """Edge of a voxel [m]."""

    def __post_init__(self) -> None:
        if abs(round(self.size_m / self.voxel_m) * self.voxel_m - self.size_m) > 1e-6 * self.size_m:
            raise InputError(
                f"`voxel_m` must divide `size_m`, but {self.voxel_m:g} does not divide "
                f"{self.size_m:g}"
            )

    @property
    def structure(self) -> float | Literal["even"]:
        """Edge of the voxels on which sun and sight follow the plants [m]. Coarse voxels filled
        evenly hide gaps: in those of 25 cm, spectra are 7 % darker in red than in those of 10 cm,
        in which the shipped prior was learned; with this, within 1 %."""
        return "even" if self.voxel_m <= _LARGEST_EVEN else _LARGEST_EVEN


COARSE = Resolution(voxel_m=0.25)
"""Voxels in which plots are inverted, each of which is rendered many times."""


def slots_of(plots: Sequence[Plot]) -> tuple[str, ...]:
    """Growth form of each slot: as many of a form as the plot with the most species of it has."""
    most: dict[str, int] = {}
    for plot in plots:
        for form, group in groupby(sorted(s.growth_form for s in plot.species)):
            most[form] = max(most.get(form, 0), len(list(group)))
    return tuple(form for form in sorted(most) for _ in range(most[form]))


def build_scenes(
    plots: Sequence[Plot],
    resolution: Resolution,
    seeds: Sequence[int],
    *,
    room: float = 1.0,
    softness: float = 0.0,
) -> list[tuple[Scene, PlotParameters]]:
    """A scene and the parameters of each plot, all of one shape and tree.

    `seeds` draw the places of each plot's plants; `room` and `softness` as `PlantingRules` has
    them: a scene whose covers shall be differentiated needs both. Raises `InputError` for a plot
    with a spectrum of dead tissue or a hot spot.
    """
    for plot in plots:
        if plot.dead_tissue is not None or plot.hot_spot:
            raise InputError(
                "expected plots that share the shipped spectrum of dead tissue and leaves without "
                "size, but this one states dead_tissue or hot_spot: leave both out where many "
                "plots are compared",
                file=plot.file,
            )
    slots = slots_of(plots)
    built = [
        _build(plot, slots, resolution, seed, room, softness)
        for plot, seed in zip(plots, seeds, strict=True)
    ]
    layers = max(scene.grid.shape[2] for scene, _ in built)
    plants, elements, parts = map(max, zip(*(one.planting.sizes for one, _ in built)))
    side = round(resolution.size_m / resolution.voxel_m)
    grid = VoxelGrid((side, side, layers), resolution.voxel_m, resolution.voxel_m)
    return [
        (replace(scene, grid=grid).padded((plants + 1, elements, parts)), parameters)
        for scene, parameters in built
    ]


def _build(
    plot: Plot,
    slots: tuple[str, ...],
    resolution: Resolution,
    seed: int,
    room: float,
    softness: float,
) -> tuple[Scene, PlotParameters]:
    parameters = slotted_parameters(plot, slots)
    scene = build_scene(
        [Species(f"slot {i}", form) for i, form in enumerate(slots)],
        parameters,
        extent=(resolution.size_m, resolution.size_m),
        voxel=resolution.voxel_m,
        seed=seed,
        rules=PlantingRules(
            room=room,
            softness=softness,
            softness_plants=1.0 if softness else 0.0,
            structure=resolution.structure,
        ),
    )
    return scene, parameters


def slotted_parameters(plot: Plot, slots: tuple[str, ...]) -> PlotParameters:
    """The parameters of a plot with its species in slots; other slots have no plants."""
    size = {"mean_diameter_cm": 100.0, "cover_percent": 0.0, "height_max_m": 0.1}
    rows = [
        SpeciesRow.model_validate({"taxon": "nothing", "growth_form": form, **size})
        for form in slots
    ]
    free = {form: [i for i, f in enumerate(slots) if f == form] for form in set(slots)}
    for row in plot.species:
        rows[free[row.growth_form].pop(0)] = row
    return plot_parameters(plot.replace(species=tuple(rows)))


@eqx.filter_jit
def _nadir_image(
    imager: AimedSensor, scene: Scene, parameters: PlotParameters
) -> tuple[Float[Array, "band y x"], Float[Array, ""], Float[Array, ""]]:
    """Reflectance factors of a plot from straight above, by `nadir_imager`; the share of ground in
    sight; and the residual of the light."""
    voxels = scene.voxels(parameters, imager.sensor.bands)
    light = solve_light(voxels, imager.accuracy)
    image = render(light, imager.rays)
    incident = voxels.illumination.incident[:, None, None]
    return jnp.pi * image.total / incident, image.gap.mean(), jnp.max(light.residual)


def simulate_plot(
    scene: tuple[Scene, PlotParameters], imager: AimedSensor
) -> tuple[Array, Array, np.ndarray, Array]:
    """The fields of a plot's `PlotSpectrum`."""
    image, ground_seen, residual = _nadir_image(imager, *scene)
    variety = spectral_variety(np.asarray(image).reshape(len(image), -1).T)
    return image.mean(axis=(1, 2)), ground_seen, np.array(list(variety.values())), residual
