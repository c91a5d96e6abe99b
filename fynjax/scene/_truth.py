"""What stands in each pixel of a sensor's image: the truth that no image shows."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from fynjax._core.html import as_html
from fynjax.canopy import Organ
from fynjax.radiation import first_met
from fynjax.scene._lidar import leading_flags
from fynjax.scene._observe import AimedSensor, aimed_at, map_attributes, map_coordinates
from fynjax.scene._parameters import PlotParameters
from fynjax.scene._scene import Scene
from fynjax.sensors import Sensor

if TYPE_CHECKING:
    import xarray as xr


class PixelTruth(eqx.Module):
    """What the light of each pixel comes from at its last turn: the shares of the lines of sight
    from the sensor that end on live leaves, dead tissue, wood and flowers of each species, and on
    ground in the sun and in shade. They are blurred as the image is, and sum to one."""

    live: Float[Array, "species y x"]
    """Share of the pixel that is live leaf of each species [-]."""
    dead: Float[Array, "species y x"]
    """Share of the pixel that is dead tissue within the foliage of each species [-]."""
    wood: Float[Array, "species y x"]
    """Share of the pixel that is wood of each species, of deadwood all of it [-]."""
    flowers: Float[Array, "species y x"]
    """Share of the pixel that is flowers of each species [-]."""
    sunlit_ground: Float[Array, "y x"]
    """Share of the pixel that is ground in direct sun [-]."""
    shaded_ground: Float[Array, "y x"]
    """Share of the pixel that is ground in shade [-]."""
    taxa: tuple[str, ...] = eqx.field(static=True)
    """Name of each species."""
    sensor: str = eqx.field(static=True)
    """Name of the sensor."""
    pixel: float = eqx.field(static=True)
    """Edge of a pixel on the ground [m]."""
    origin: tuple[float, float] = eqx.field(static=True)
    """South-west corner of the image from that of the scene [m]; row 0 is the southernmost."""

    @property
    def species(self) -> Float[Array, "species y x"]:
        """Share of the pixel that is any part of each species [-]."""
        return self.live + self.dead + self.wood + self.flowers

    def leading(self) -> tuple[np.ndarray, np.ndarray]:
        """The species with the largest share of each pixel as its place in `taxa`, -1 where there
        is none in sight, and that share of the pixel [-]: arrays (y, x). Not differentiable."""
        shares = np.asarray(self.species)
        place, share = shares.argmax(axis=0), shares.max(axis=0)
        return np.where(share > 0.0, place, -1), share

    def to_xarray(self) -> "xr.Dataset":
        """All shares, the leading species and its share as a dataset with CF names, units and
        coordinates from the scene's south-west corner [m]."""
        import xarray as xr  # late: the command line need not wait for it

        coordinates = {
            "species": ("species", list(self.taxa), {"long_name": "taxon"}),
            **map_coordinates(self.sunlit_ground.shape, self.pixel, self.origin),
        }
        layers = {
            "live": "live leaf of a species", "dead": "dead tissue of a species",
            "wood": "wood of a species", "flowers": "flowers of a species",
            "sunlit_ground": "sunlit ground", "shaded_ground": "shaded ground",
        }  # fmt: skip
        data: dict[str, Any] = {}
        for name, what in layers.items():
            values = np.asarray(getattr(self, name))
            data[name] = (("species", "y", "x")[-values.ndim :], values, _share(what))
        place, share = self.leading()
        data["leading_species"] = (("y", "x"), place.astype(np.int16), leading_flags(self.taxa))
        data["leading_share"] = (("y", "x"), share, _share("the leading species"))
        title = f"what {self.sensor} sees of a simulated plot"
        return xr.Dataset(data, coordinates, map_attributes(title, self.pixel))

    def __str__(self) -> str:
        """What is in sight of the sensor over the whole plot, in a sentence."""
        if isinstance(self.sunlit_ground, jax.core.Tracer):
            return f"{self.sensor}: shares of {len(self.taxa)} species."
        mean = np.asarray(self.species).mean(axis=(1, 2))
        order = np.argsort(-mean)[:5]
        shown = ", ".join(f"{self.taxa[i]} {mean[i]:.1%}" for i in order)
        lit, shade = (float(np.mean(g)) for g in (self.sunlit_ground, self.shaded_ground))
        return (
            f"{self.sensor}: pixels of {self.pixel:g} m see {shown}, ground in the sun {lit:.1%} "
            f"and in shade {shade:.1%}."
        )

    _repr_html_ = as_html


def _share(what: str) -> dict[str, str]:
    return {"units": "1", "long_name": f"share of the pixel that is {what}"}


def pixel_truth(
    scene: Scene,
    sensor: str | Path | Sensor,
    *,
    parameters: PlotParameters | None = None,
    **options: Any,
) -> PixelTruth:
    """What a sensor's pixels see of each species, of its dead tissue, wood and flowers, and of the
    ground.

    **Arguments:**

    - `scene`: as for `observe`.
    - `sensor`: an imaging sensor, by name, file or as an object.
    - `parameters`: instead of the scene's own; of the same species.
    - `options`: `pixel`, `altitude`, `placement`, `point_spread` and `accuracy`, as for `observe`.

    **Returns:** `PixelTruth` in the pixels and with the point spread of the image that `observe`
    gives. Shares are those of lines of sight (Beer's law along them, in the voxels that the image
    is made of), whatever the band: a dark leaf counts as a bright one. Differentiable in
    `parameters` as an image is.

    **Raises:** `InputError` as `observe`, and for a LiDAR.

    >>> import fynjax as fx
    >>> from fynjax.canopy import table1_2006
    >>> scene = fx.Scene.from_table(table1_2006()[:2], size=1.0, voxel=0.25, structure="even")
    >>> truth = fx.pixel_truth(scene, "mavic_3m", pixel=0.25)
    >>> truth.live.shape
    (2, 4, 4)
    >>> total = truth.species.sum(axis=0) + truth.sunlit_ground + truth.shaded_ground
    >>> bool(abs(total - 1).max() < 1e-5)
    True
    """
    aimed, parameters = aimed_at(scene, sensor, parameters, **options)
    return truth_of_pixels(aimed, scene, parameters)


@eqx.filter_jit
def truth_of_pixels(aimed: AimedSensor, scene: Scene, parameters: PlotParameters) -> PixelTruth:
    """What the pixels of a sensor see that `aim` has aimed already.

    **Arguments:** `aimed`, from `aim`; `scene` and its `parameters`.

    **Returns:** as `pixel_truth`.
    """
    parameters = jax.tree.map(lambda x: jnp.asarray(x, scene.dtype), parameters)
    return truth_of_layers(_layers(scene, parameters, aimed), aimed, scene, parameters)


def truth_of_layers(
    layers: Float[Array, "layer y x"], aimed: AimedSensor, scene: Scene, parameters: PlotParameters
) -> PixelTruth:
    """What pixels see, from the shares that they have of each organ.

    **Arguments:**

    - `layers`: shares of each organ of each species, species by species, of ground in the sun and
      in shade [-], such as `TiledPicture.sight` has of a large picture.
    - `aimed`, `scene`, `parameters`: as for `truth_of_pixels`.

    **Returns:** as `pixel_truth`. Differentiable in `layers` and `parameters`.
    """
    *canopy, lit, shade = layers
    leaf, wood, flowers = (jnp.stack(canopy[organ :: len(Organ)]) for organ in Organ)
    # Dead tissue lies among the live leaves at random: it is met by its share of their area.
    dead = parameters.species.dead_fraction[:, None, None]
    return PixelTruth(
        (1.0 - dead) * leaf,
        dead * leaf,
        wood,
        flowers,
        lit,
        shade,
        taxa=scene.taxa,
        sensor=aimed.sensor.name,
        pixel=aimed.pixel,
        origin=aimed.origin,
    )


def _layers(
    scene: Scene, parameters: PlotParameters, aimed: AimedSensor
) -> Float[Array, "layer y x"]:
    """Shares of each organ of each species, of sunlit and of shaded ground in the pixels."""
    voxels = scene.voxels_by_organ(parameters, aimed.sensor.bands.select([0]))
    sight = first_met(
        voxels, aimed.rays, aimed.accuracy, steepest=aimed.steepest, together=aimed.together
    )
    ground = jnp.stack([sight.sunlit_ground, sight.shaded_ground])
    return aimed.averages(jnp.concatenate([sight.canopy, ground]), voxels)[0]
