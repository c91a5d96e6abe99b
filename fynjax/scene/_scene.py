"""A scene: plants, ground, light and terrain, and no sensor. What a sensor measures of it is
`fynjax.scene.observe`.

What is random (where plants may stand, how they are turned, which are large) is drawn once, when
the scene is built. The same plants then stand in the same places whatever the parameters are, so
that what a sensor measures is a smooth, repeatable function of the parameters.
"""

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from functools import partial
from pathlib import Path
from typing import Any, Literal, NamedTuple, SupportsIndex

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from fynjax._core.checkpoint import ByContent
from fynjax._core.dry_run import counted
from fynjax._core.errors import InputError, did_you_mean, whole_number
from fynjax._core.html import as_html
from fynjax._core.precision import drawn_in_double
from fynjax._core.programs import as_one, check_known
from fynjax._core.seeds import generator
from fynjax.canopy import (
    FORMS,
    MeshPlant,
    Organ,
    PlantModel,
    Shrubland,
    VoxelGrid,
    clark_evans,
    clumping,
    deposit,
    expected_count,
    grouped,
    instance_area,
    most_projected,
    projected_count,
    rounded_count,
    share_from_above,
    site_weight,
    soft_count,
    target_area,
)
from fynjax.radiation import Illumination, OpticalClasses, RahmanPintyVerstraete, VoxelScene
from fynjax.scene._ground import Ground, ground_shares, kind_shares
from fynjax.scene._materials import check_leafy, plant_materials, with_areas
from fynjax.scene._optics import optical_classes, seen_from_above
from fynjax.scene._parameters import (
    PARAMETERS,
    GroundParameters,
    LightParameters,
    PlotParameters,
    named_values,
    parameter_kind,
    with_values,
)
from fynjax.scene._plan import ScenePlan
from fynjax.scene._planting import (
    Crowns,
    Planting,
    PlantingRules,
    SiteRules,
    Stand,
    class_count,
    class_shares,
    draw_planting,
    known_planting,
    no_plants,
    seed_of_planting,
    shared_anew,
    sites_ready,
    whole_plants,
)
from fynjax.scene._species import (
    CoverDefinition,
    LeafStated,
    Species,
    check_projected,
    cover_definition_of,
    drawn_leaves,
    inclination,
    leaf_parameters,
    leaf_rows,
    leaves_of,
    species_parameters,
    species_rows,
    table_spreads,
)
from fynjax.scene._spectra import Spectrum, background_spectrum, band_wavelengths
from fynjax.sensors import BandSet
from fynjax.sensors.air import clear_sky_diffuse_fraction

_EVEN_LAYERS = 2
"""Layers of a scene are a multiple of this: the light is solved in pairs of them."""
_MOST_VOXELS = 2**31 - 1
_AT_ONCE = 2**22
"""Area elements that are placed on the voxels at once."""
_COMPOSITION = 0.1
"""Edge of the voxels in which the classes are kept apart, where sun and sight follow the structure
on finer ones [m]."""


@dataclass(frozen=True, eq=False)
class Recipe(ByContent):
    """How the plants of a scene are drawn. With it a scene needs but a seed for another planting
    (`Scene.realisation`). It takes no part in what is computed of the scene."""

    rules: PlantingRules
    """Rules as stated; their `room` as it came to be."""
    plants: tuple[PlantModel | None, ...]
    """Shape of the plants of each species, such as of a mesh; None: that of the growth form."""
    extent: tuple[float, float]
    """Sides of the plot, (east-west, north-south) [m]."""


class Planted(NamedTuple):
    """What the plants of a scene were drawn for, in NumPy's digits."""

    number: Float[np.ndarray, " species"]
    """Real number of plants of each species [-]."""
    diameter: Float[np.ndarray, " species"]
    """Mean crown diameter of each [m]."""
    height: Float[np.ndarray, " species"]
    """Greatest height of each [m]."""


@jax.custom_jvp
def _whole(whole: Array, share: Array) -> Array:
    """Whole plants; but where a derivative by their number is taken, the plants in part that it is
    taken of, as value too."""
    return whole


@_whole.defjvp
def _in_part(primals: tuple[Array, Array], tangents: tuple[Array, Array]) -> tuple[Array, Array]:
    # Whatever is computed of the plants then has value and slope of one smooth function. With the
    # value of whole plants a function that bends, such as the spread of an index, would be
    # differentiated at another stand than that whose slope it meets.
    return primals[1], tangents[1]


SMALLEST = 0.1
"""Size of the smallest plant that stands in part over that of the whole plant [-]."""


class Window(eqx.Module):
    """A part of a scene, with the plants that reach into it."""

    planting: Planting
    """Planting, its feet counted from the window's south-west corner."""
    crown: Float[Array, " plant"]
    """Ground area of each crown, as of `Scene.visible_crowns` [m2]."""
    first: Int[Array, " 2"]
    """First voxel column of `Scene.class_grid` in it, along y and x; may lie beyond the scene."""
    columns: tuple[int, int] = eqx.field(static=True)
    """Number of such columns in it, along y and x."""

    def grid(self, whole: VoxelGrid, times: int = 1) -> VoxelGrid:
        """Voxels of the window as those of `whole`, `times` as many along a column's edge."""
        ny, nx = self.columns
        return dataclasses.replace(whole, shape=(nx * times, ny * times, whole.shape[2]))

    def cut(self, field: Float[Array, "band y x"]) -> Float[Array, "band y x"]:
        """The window's part of a map that repeats itself."""
        for axis, start, count in zip((1, 2), self.first, self.columns, strict=True):
            field = jnp.take(field, (start + jnp.arange(count)) % field.shape[axis], axis=axis)
        return field


class Scene(eqx.Module):
    """Plants, ground, light and terrain of a plot, without a sensor.

    Its `parameters` are those that it was planted for. `build_scene` and `Scene.from_table` make
    one; `observe` gives what a sensor measures of it, with these parameters or others.
    """

    planting: Planting
    grid: VoxelGrid
    parameters: PlotParameters
    """Parameters as stated; what observes the scene may be given others."""
    species: tuple[Species, ...]
    recipe: Recipe = eqx.field(static=True)
    """How its plants were drawn, and those of another `realisation` are."""
    planted: Planted | None
    """What its plants were drawn for; None: it has others than were drawn."""
    boundary: Literal["periodic", "open"] = eqx.field(static=True)
    rounding: Float[Array, " species"]
    """Number of each species, drawn evenly from 0 to 1 [-]: where numbers of plants are rounded at
    random the real one is lessened by it before it is rounded up, so that the mean is the real one;
    and by it the last plants stand in part (`expected_count`)."""
    tuft: float = eqx.field(static=True)
    """`PlantingRules.tuft` as it goes with the voxels [m]."""
    finer: int = eqx.field(static=True)
    """Finest voxels along an edge of one of the grid's: sun and sight follow the plants on them.
    0: leaves fill the grid's evenly."""
    ground: Ground
    """Spectra of soil and covers, and where they lie."""
    terrain: Float[np.ndarray, "y x"] | None
    """Height of the ground in the voxel columns above the bottom of the grid [m]; None: level."""
    sky: Spectrum | None
    """Diffuse over global irradiance [-], instead of the clear-sky model."""
    sky_pattern: Float[np.ndarray, "zenith azimuth"] | None
    """Relative radiance of the sky, as in `fynjax.radiation.Illumination`; None: even."""
    dead_tissue: Spectrum | None
    """Reflectance of dead tissue in live shoots; None: that of bark."""
    hot_spot: bool = eqx.field(static=True)
    """Whether leaves have the size of their form: what the sun lights is then seen the better, the
    nearer sun and sight are. False: points, which have no hot spot."""
    dtype: str = eqx.field(static=True)
    known_plants: bool = eqx.field(static=True, default=False)
    """Whether the plants of `planting` are known and all stand, whatever covers are."""
    number: Float[Array, " species"] | None = None
    """Real number of plants of each species instead of that of the parameters [-]; None: theirs."""
    in_part: Bool[Array, ""] = eqx.field(converter=jnp.asarray, default=False)
    """Whether the last plants of each species stand in part instead of whole (`Scene.expected`)."""
    held: Bool[Array, ""] = eqx.field(converter=jnp.asarray, default=False)
    """Whether plants stand whole in a derivative too: in one by what moves no number of plants, by
    the program of a derivative by all parameters."""
    seed: Int[np.ndarray | Array, ""] = eqx.field(default_factory=lambda: np.zeros((), int))
    """Seed of what was drawn; no part of what is observed."""
    spacing: Float[Array, ""] = eqx.field(converter=jnp.asarray, default=0.0)
    """Least distance of the sites for which projected covers count plants [m]."""
    whole: Float[Array, " species"] | None = None
    """Plants of each species for which these sites are; more stand between them [-]."""
    spreads: tuple[tuple[str, float], ...] = eqx.field(static=True, default=())
    """Names of parameters of which the species table (`table_spreads`) or measured leaves
    (`fynjax.leaf.species_prior`) say how uncertain they are, with their relative standard
    deviations [-]: the priors of `fynjax.free`."""
    clumping: Float[Array, "species part"] | None = None
    """Relative density of plants over equal parts of the ground, where a map clumps them or an edge
    ends them, and covers are projected [-] (`fynjax.canopy.clumping`)."""
    shares: Float[Array, " plant"] | None = None
    """Share in which each plant stands, 0 to 1 [-], whatever covers are (`standing_in_part`); None:
    as parameters ask for."""

    @classmethod
    @drawn_in_double
    def from_table(
        cls,
        table: Any,
        *,
        size: float | tuple[float, float],
        voxel: float = 0.1,
        structure: float | Literal["even"] | None = None,
        seed: SupportsIndex = 0,
        boundary: Literal["periodic", "open"] = "periodic",
        rounding: Literal["random", "up"] = "random",
        size_variation: float = PlantingRules.size_variation,
        spacing_m: float | None = None,
        attempts: int = PlantingRules.attempts,
        cover_definition: CoverDefinition | None = None,
        leaves: Mapping[str | tuple[str, str], LeafStated | Sequence[LeafStated]] | None = None,
        meshes: Mapping[str, MeshPlant] | None = None,
        leaf_variants: int = 1,
        plants: Shrubland = "fynbos",
        ground: GroundParameters | None = None,
        light: LightParameters | None = None,
        dead_tissue: Spectrum | None = None,
        hot_spot: bool = False,
        dtype: str = "float32",
    ) -> "Scene":
        """A scene with its parameters from a species table, without any file.

        **Arguments:**

        - `table`: a pandas frame or records with `taxon`, `growth_form`, `mean_diameter_cm`,
          `cover_percent` and `height_max_m`, as of `fynjax.canopy.table1_2006`; and any of the
          other columns of a plot's species table but `plant`. A `growth_form` may be left out as
          there.
        - `size`: side of the plot, or (east-west, north-south) [m].
        - `voxel`: edge of a voxel [m]; must divide the sides.
        - `structure`: edge of the voxels on which sun and sight follow the plants [m], or "even";
          left out, a quarter of a voxel, see `PlantingRules`.
        - `seed`: of everything random.
        - `boundary`: "periodic" repeats the plot for ever, "open" does not.
        - `rounding`: of the numbers of plants, see `PlantingRules`.
        - `size_variation`: of the crown diameters of a species [-], see `PlantingRules`.
        - `spacing_m`, `attempts`: least distance of the plants [m], left out by their number, and
          candidates for each site [-]: r and k of Bridson, see `PlantingRules`.
        - `cover_definition`: "projected", the share of the ground below the crowns of a species, or
          "article", eq. (10), see `PlantingRules`; left out, "projected", but for a table with
          packing, fill, branches or a least area, which only eq. (10) has.
        - `leaves`: PROSPECT-D parameters by taxon, in PROSPECT's units; "*" is any other. What is
          left out is that of the usual leaf, anthocyanins and brown pigments 0; a structure that is
          left out follows from dry matter.
          Of several leaves of a taxon each plant has one. By taxon and material, as
          `("Erica", "young")`, what else the plants are made of: PROSPECT-D parameters, or
          `{"reflectance": Spectrum, "transmittance": Spectrum}`, opaque without the latter, or the
          name of a shipped reflectance, "bark", "litter" or "char". Materials "flower" and "wood"
          are all flowers and wood that have no other.
        - `meshes`: plants by taxon, as `fynjax.canopy.plant_model_from_mesh` makes them; their
          materials are those of `leaves` by the optics that they state, or by their own names.
          Others have the shape of their growth form.
        - `leaf_variants`: different leaves of a taxon of which one leaf is stated, drawn about it
          with the spread within species that Californian shrubs have; 1: all plants have that one.
        - `plants`: whose values growth forms and leaves have that are left out: "fynbos", learned
          from 18 plots, or "generic", of published shrublands at large.
        - `ground`, `light`: left out, their defaults; with `dead_tissue`, or generic plants, a wood
          brightness of 1.
        - `dead_tissue`: reflectance of the dead tissue in live shoots, `Spectrum.of(wavelength,
          values, what)`; left out, that of bark.
        - `hot_spot`: whether leaves have the size of their form, see `Scene`.
        - `dtype`: floating type that the scene is computed in, "float32" or "float64".

        What is left out is as in a plot file.

        **Raises:** `InputError` with row, taxon and column for a cell that cannot be used, for an
        unknown column and unknown leaves, and as `build_scene`.

        **Example:**

        >>> from fynjax.canopy import table1_2006
        >>> from fynjax.scene import Scene
        >>> scene = Scene.from_table(table1_2006(), size=2.0, voxel=0.5)
        >>> len(scene.taxa), scene.grid.shape[:2]
        (13, (4, 4))
        >>> thin = scene.with_values({"species.*.cover": 0.02})
        >>> thin.parameters.species.cover[:2].tolist()
        [0.02, 0.02]
        >>> red = {("*", "flower"): {"anthocyanins": 8.0}}  # flowers of all taxa
        >>> blooming = Scene.from_table(table1_2006(), size=2.0, voxel=0.5, leaves=red)
        >>> blooming.parameters.materials.names
        ('material.flower',)
        """
        check_known(size=size, voxel=voxel, structure=structure)
        rows = species_rows(table, cover_definition)
        taxa, meshes = [row.taxon for row in rows], {} if meshes is None else meshes
        for taxon in meshes.keys() - set(taxa):
            raise InputError(f"unknown taxon of a mesh: {taxon!r}.{did_you_mean(taxon, taxa)}")
        stated = leaf_rows({} if leaves is None else leaves, taxa)
        if any(row.plant is not None for row in rows):
            raise InputError(
                "expected growth forms, but got the file of a plant, which only a plot file can "
                "name: give its mesh in `meshes`",
                column="plant",
            )
        if ground is None:
            ground = GroundParameters()
            if dead_tissue is not None or plants == "generic":
                ground = dataclasses.replace(ground, wood_brightness=jnp.asarray(1.0))
        if leaf_variants < 1:
            raise InputError(f"expected 1 leaf variant or more, but got {leaf_variants}")
        own = drawn_leaves(leaves_of(rows, stated, plants), leaf_variants, seed)
        shapes = [meshes.get(taxon) for taxon in taxa]
        for row, shape in zip(rows, shapes, strict=True):
            if shape is not None:
                check_leafy(shape, row.growth_form)
        materials = plant_materials(rows, stated, shapes, population=plants)
        rows = tuple(with_areas(*pair) for pair in zip(rows, shapes, strict=True))
        parameters = PlotParameters(
            species_parameters(rows, own, plants, shapes),
            leaf_parameters(own),
            ground,
            LightParameters() if light is None else light,
            materials.parameters,
        )
        extent = size if isinstance(size, tuple) else (size, size)
        scene = build_scene(
            [Species.of(*one) for one in zip(rows, own, materials.species, strict=True)],
            parameters,
            extent=extent,
            voxel=voxel,
            seed=seed,
            boundary=boundary,
            rules=PlantingRules(
                structure=structure,
                rounding=rounding,
                size_variation=size_variation,
                spacing=spacing_m,
                attempts=attempts,
                cover_definition=cover_definition_of(rows, cover_definition),
            ),
            dead_tissue=dead_tissue,
            hot_spot=hot_spot,
            plants=materials.plants,
            dtype=dtype,
        )
        spreads = table_spreads(rows, plants, stated)
        return dataclasses.replace(scene, spreads=tuple(spreads.items()))

    def with_values(self, values: Mapping[str, float | Array]) -> "Scene":
        """The same plants with other parameters.

        **Arguments:** `values` by name, or by a pattern such as "species.*.cover" for all that it
        fits, each in the parameter's own unit (`named_values`; `parameter_reference`).

        A cover beyond 2.5 times that of the table finds no more sites (`PlantingRules.room`).
        Differentiable in the values. By a cover or a diameter what is seen moves in whole plants,
        while its slope is that of the expected stand: a search of your own compares values and
        takes `scene.expected()`. Inside `jax.jit` bounds are not checked.

        **Raises:** `InputError` for a name that the scene does not have, and for a number out of
        its parameter's bounds.
        """
        known, changed = named_values(self.parameters, self.taxa), {}
        # Later patterns win over earlier ones.
        for pattern, value in values.items():
            for name in _fitting(pattern, known):
                if not isinstance(value, jax.core.Tracer):
                    PARAMETERS[parameter_kind(name)].check(float(value), name)
                changed[name] = jnp.asarray(value, known[name].dtype)
        return dataclasses.replace(
            self, parameters=with_values(self.parameters, self.taxa, changed)
        )

    def scaled(self, factors: Mapping[str, float | Array]) -> "Scene":
        """The same plants with parameters that are so many times what they were.

        **Arguments:** `factors` by name or by a pattern such as "species.*.cover" [-], else as
        `with_values`. Differentiable in the factors.

        **Raises:** `InputError` as `with_values`.
        """
        known = named_values(self.parameters, self.taxa)
        return self.with_values(
            {
                name: factor * known[name]
                for pattern, factor in factors.items()
                for name in _fitting(pattern, known)
            }
        )

    def __hash__(self) -> int:
        """Of what equal scenes share, their structure; arrays have no hash."""
        return hash(jax.tree.structure(self))

    def __str__(self) -> str:
        """What stands in it, in a few lines."""
        species, (x, y, _) = self.parameters.species, self.grid.extent
        lines = [
            f"A plot of {x:g} m x {y:g} m in voxels of {self.grid.horizontal_size:g} m, "
            f"{self.boundary}, with {len(self.taxa)} species:"
        ]
        try:
            sizes = np.stack(
                [np.asarray(v, float) for v in (species.cover, species.diameter, species.height)]
            )
            feet, owner = self._feet_standing()
        except jax.errors.TracerArrayConversionError:
            return lines[0]
        even = partial(clark_evans, extent=self.recipe.extent, periodic=self.boundary == "periodic")
        for i, (one, (cover, diameter, height)) in enumerate(zip(self.species, sizes.T)):
            index = even(feet[owner == i])
            lines.append(
                f"  {one.taxon} ({one.form}): cover {100 * cover:.3g} %, crowns of "
                f"{100 * diameter:.3g} cm, up to {height:.3g} m"
                + ("" if np.isnan(index) else f"; Clark-Evans index {index:.2f}")
            )
        if len(feet) > 1:
            lines.append(f"{len(feet)} plants, Clark-Evans index {even(feet):.2f}")
        return "\n".join(lines)

    def _feet_standing(self) -> tuple[Float[np.ndarray, "plant 2"], Int[np.ndarray, " plant"]]:
        """Feet of the plants that stand, and their species."""
        planting = self.planting
        species, place = np.asarray(planting.species), np.asarray(planting.place)
        stands = place < np.asarray(self.whole_counts(self.parameters))[species]
        return np.asarray(planting.foot)[stands], species[stands]

    _repr_html_ = as_html

    @property
    def rules(self) -> PlantingRules:
        """How plants are drawn, and how one more of them appears."""
        return self.recipe.rules

    @property
    def taxa(self) -> tuple[str, ...]:
        """Names of the species."""
        return tuple(one.taxon for one in self.species)

    @property
    def forms(self) -> tuple[str, ...]:
        """Growth forms of the species, keys of `fynjax.canopy.FORMS`."""
        return tuple(one.form for one in self.species)

    @property
    def branches(self) -> tuple[float, ...]:
        """Copies of the plant model that make one plant of each species [-]."""
        return tuple(one.branches for one in self.species)

    @drawn_in_double
    def realisation(
        self, number: int, counts: Float[np.ndarray, " species"] | None = None
    ) -> "Scene":
        """The same plot with other plants in other places, and patches of its ground where these
        are drawn: another planting by the same `recipe`. Known plants stay where they are.

        **Arguments:**

        - `number`: of the planting; 0 for the scene as it was built, to the bit.
        - `counts`: plants of each species that are to find sites, besides those that do.

        **Raises:** `InputError` where there is no room or memory for them, and for a form of a
        scene that has other plants than were drawn: a coarser or padded one, or `hard_scene`.
        """
        if self.known_plants:
            return self
        if self.planted is None:
            raise InputError(
                "expected a scene as it was built, but this is a coarser or padded form of one, or "
                "one of the plants that stand: take a realisation of the scene itself"
            )
        check_known(planted=self.planted)
        recipe, room = self.recipe, self.rules.room
        if counts is not None:
            needed = self._room(self.planted.number, counts)
            if (needed > room).any():
                rules = dataclasses.replace(self.rules, room=np.maximum(needed, room))
                recipe = dataclasses.replace(recipe, rules=rules)
        seed = seed_of_planting(int(self.seed), number)
        return dataclasses.replace(self, recipe=recipe)._drawn(seed)

    @drawn_in_double
    def with_plants(self, crowns: Crowns, seed: int | None = None) -> "Scene":
        """The same plot with these plants, whatever covers are, and no others.

        **Arguments:**

        - `crowns`: where they stand; their diameters and heights are those that the scene's own
          parameters give, and others scale them.
        - `seed`: of the plants' shapes and turns; by default the scene's.

        **Raises:** `InputError` as `realisation`, for a scene of other plants than were drawn.

        Not differentiable; `standing_in_part` of the result is.
        """
        if self.planted is None:
            raise InputError("expected a scene as it was built, but this is another form of one")
        check_known(planted=self.planted)
        planting = known_planting(self._stand(int(self.seed) if seed is None else seed), crowns)
        size, owner = self.parameters.species, np.asarray(planting.species)
        each = np.concatenate(
            [
                np.repeat(np.flatnonzero(crowns.species == i), round(one.branches))
                for i, one in enumerate(self.species)
            ]
        )
        planting = dataclasses.replace(
            planting,
            size=jnp.asarray(crowns.diameter[each] / np.asarray(size.diameter)[owner], self.dtype),
            stature=jnp.asarray(crowns.height[each] / np.asarray(size.height)[owner], self.dtype),
        )
        rules = dataclasses.replace(self.rules, softness=0.0, softness_plants=0.0)
        recipe = dataclasses.replace(self.recipe, rules=rules)
        return dataclasses.replace(self, planting=planting, recipe=recipe, known_plants=True)

    def standing_in_part(
        self,
        shares: Float[Array, " plant"],
        foot: Float[Array, "plant 2"],
        size: Float[Array, " plant"],
        stature: Float[Array, " plant"],
    ) -> "Scene":
        """The same plants, each standing in a share, moved and of another size: what a search for
        plants takes slopes by. A plant that stands in part is as large as the whole one, and has a
        part of its leaves and wood, so that its outline is in the image; shares of 0 and 1 alone
        are a stand of whole plants.

        **Arguments:** `shares`, 0 to 1 [-]; `foot`, x and y [m]; `size`, crown diameter over the
        species' [-]; `stature`, height over the species' greatest [-]. Differentiable in all.
        """
        planting = dataclasses.replace(self.planting, foot=foot, size=size, stature=stature)
        return dataclasses.replace(self, planting=planting, shares=shares)

    def _drawn(self, seed: int) -> "Scene":
        """The scene with all that is drawn by a seed."""
        rules, planted = self.rules, self.planted
        assert planted is not None
        stand, scene = self._stand(seed), self._without_plants(seed)
        if counted(lambda _: _plan(scene, stand, rules.room, None)):
            return scene
        planting = draw_planting(stand, planted.number, self._site_rules(seed))
        return dataclasses.replace(scene, planting=planting)

    def spacing_of(self, plants: float) -> float:
        """Least distance at which so many drawn plants would stand [m]."""
        return self._site_rules(0).spacing_for(plants)

    def _site_rules(self, seed: int) -> SiteRules:
        return SiteRules(self.recipe.extent, self.boundary == "periodic", self.rules, seed)

    def _without_plants(self, seed: int) -> "Scene":
        """The scene with what a seed decides besides where plants stand."""
        rounding = _rounding(len(self.species), [seed], self.dtype)
        ground = self.ground.laid(self.grid, self.boundary, seed)
        return dataclasses.replace(self, seed=np.asarray(seed), rounding=rounding, ground=ground)

    def _stand(self, seed: int) -> Stand:
        rules, planted = self.rules, self.planted
        assert planted is not None
        return Stand(
            self.species,
            planted.diameter,
            planted.height,
            self.recipe.plants,
            rules.resolved(self.grid.horizontal_size),
            self.finer > 0,
            seed,
            self.dtype,
        )

    def _room(
        self, stated: Float[np.ndarray, " species"], counts: Float[np.ndarray, "*draw species"]
    ) -> Float[np.ndarray, " species"]:
        """`room_needed` by a scene drawn for `stated` plants of each species."""
        most = np.max(np.reshape(np.asarray(counts, float), (-1, len(stated))), axis=0)
        # In expectation half a plant more, and one more spread over sites beyond their number.
        whole, rules = np.ceil(most), self.rules
        if rules.softness > 0.0 or rules.softness_plants > 0.0:
            some = most + (1.0 if rules.rounding == "up" else 0.5)
            ramp = rules.softness * some + max(rules.softness_plants - 1.0, 0.0)
            most = some + 0.5 * ramp
        most = np.maximum(whole, most)
        planted = np.asarray(self.planting.species)
        ready = sites_ready(stated, PlantingRules.room)
        if planted.size:
            ready = np.bincount(planted, minlength=len(stated))
        short = (most > ready) & (stated > 0)
        return np.where(short, most / np.where(short, stated, 1.0), 0.0)

    def reordered(self, seed: int, counts: Float[np.ndarray, " species"] | None = None) -> "Scene":
        """The same plot with other plants standing on the same sites: unlike those of a
        `realisation` they have the sites and sizes that this scene holds ready. The sites of the
        whole plants are shared out anew among the species, and spare ones among their spare plants,
        which costs little. Numbers of plants that are rounded at random are rounded anew, known
        plants stand where they do.

        **Arguments:**

        - `seed`: of the order.
        - `counts`: real number of plants of each species, for which sites are drawn anew; they must
          be no more than are held ready. Others than the first so many then have no places of use.
        """
        planting, rules = self.planting, self._site_rules(seed)
        changed = shared_anew(planting, self.species, rules, counts)
        fields = lambda s: (s.planting.place, s.planting.lot, s.planting.foot, s.rounding)  # noqa: E731
        old = planting.place, planting.lot, planting.foot
        new = [jnp.asarray(v, before.dtype) for v, before in zip(changed, old, strict=True)]
        rounding = _rounding(len(self.taxa), [seed, 211], self.dtype)
        return eqx.tree_at(fields, self, (*new, rounding))

    def expected(self, expected: bool = True) -> "Scene":
        """The same plot with the stand in expectation, of which everything is a smooth function of
        the parameters: what an optimiser takes.

        One more plant of a species does not come at once but grows, from nothing to what it is
        whole, and others about the number of plants with it (`Scene.standing`). A plant that is
        smaller in all directions, and as dense to look through, has effects in proportion to its
        area, so that the mean over plantings is that of whole plants within 0.7 % of a band's mean
        and of the gap, 0.4 % of mean NDVI and 1.3 % of its spread (`docs/model.md`, Plants).

        **Arguments:** `expected`, False for whole plants again.

        What is observed of a scene of whole plants has the slopes of this stand where the number of
        plants moves, and its value beside them. Take this one where values without a slope are
        compared with such, as in a line search.

        >>> import fynjax as fx
        >>> from fynjax.canopy import table1_2006
        >>> scene = fx.Scene.from_table(table1_2006()[:2], size=1.0, voxel=0.25, structure="even")
        >>> more = scene.scaled({"species.*.cover": 1.001})
        >>> [bool((s.gap_fraction(more.parameters) < s.gap_fraction(scene.parameters)))
        ...  for s in (scene, scene.expected())]
        [False, True]
        """
        return eqx.tree_at(lambda s: s.in_part, self, jnp.full_like(self.in_part, expected))

    def padded(self, sizes: tuple[int, int, int] | None = None) -> "Scene":
        """A scene that looks as this one, with more plants in its arrays that never stand: scenes
        of the same growth forms and grid and about as many plants then share compiled programs. For
        images and what a pixel sees; a table of its plants would have rows too many.

        **Arguments:** `sizes`, numbers of plants, of their elements and of those of shapes
        (`Planting.sizes`) up to which room is made, with a plant more than there are at least; left
        out, few sizes, of elements up to a quarter larger. An image of 2 m then takes 6 % longer.
        """
        return dataclasses.replace(self, planting=self.planting.padded(sizes), planted=None)

    def unnamed(self) -> "Scene":
        """All of the scene that an image with given parameters follows from: scenes of other names,
        seeds and rules of planting then share compiled programs."""
        if self.parameters is None:  # it is already
            return self
        kept = "rounding", "softness", "softness_plants", "cover_definition", "flowering"
        rules = PlantingRules(**{name: getattr(self.rules, name) for name in kept})
        species = (dataclasses.replace(one, taxon="", groups=0.0) for one in self.species)
        scene = dataclasses.replace(
            self,
            species=tuple(species),
            recipe=Recipe(rules, (), (0.0, 0.0)),
            planted=None,
            spreads=(),
        )
        return eqx.tree_at(lambda s: s.parameters, scene, None)

    @property
    def ground_level(self) -> float:
        """Mean height of the ground above the bottom of the grid [m]."""
        return 0.0 if self.terrain is None else float(np.mean(self.terrain))

    @as_one
    def counts(self, parameters: PlotParameters) -> Float[Array, " species"]:
        """Real number of plants of each species that its cover asks for, by `cover_definition` [-];
        of known plants their number."""
        if self.number is not None:
            return self.number
        if self.known_plants:
            return jnp.bincount(self.planting.species, length=len(self.taxa)).astype(float)
        species = jax.tree.map(jnp.asarray, parameters.species)
        if self.rules.cover_definition == "projected":
            ground, parts = self.ground_area, 1.0 if self.clumping is None else self.clumping
            crown = self._within(species.diameter / 2.0)
            return projected_count(
                species.cover,
                crown,
                ground,
                spacing=self.spacing,
                whole=jnp.inf if self.whole is None else self.whole,
                clumping=parts,
            )
        each = instance_area(
            species.diameter,
            species.height,
            jnp.asarray([one.rotation_spread for one in self.species]),
            species.packing,
            species.fill,
            jnp.asarray([one.minimum_area for one in self.species]),
        )
        target = target_area(self.ground_area, species.cover)
        return soft_count(target, each, np.asarray(self.branches))

    def counts_move(self, changes: PlotParameters) -> bool:
        """Whether `counts` move with the parameters that change: those that are not None."""
        if self.number is not None or self.known_plants or self.shares is not None:
            return False
        names = ["cover", "diameter"]
        if self.rules.cover_definition == "article":
            names += ["height", "packing", "fill"]
        return any(getattr(changes.species, name) is not None for name in names)

    def _within(self, radius: Array) -> Array:
        """Area of a crown within the plot, on average over the places where it may stand [m2]."""
        disc = jnp.pi * radius**2
        if self.boundary == "periodic":
            return disc
        x, y = self.grid.extent[:2]
        # Mean area of a disc in a rectangle about a point drawn evenly in it.
        return disc - 4.0 / 3.0 * radius**3 * (1.0 / x + 1.0 / y) + radius**4 / (2.0 * x * y)

    def _counting(self) -> "Scene":
        """Scene that counts projected covers by the least distance of its sites [m] and by the
        clumping of its map [-]; with the article's covers or known plants the scene as it is."""
        if self.rules.cover_definition == "article" or self.known_plants:
            return self
        scene, extent, chance = self, self.grid.extent[:2], self.rules.probability
        periodic, sites = self.boundary == "periodic", self._site_rules(0)
        diameter = np.asarray(self.parameters.species.diameter)
        groups = np.array([one.groups for one in self.species])
        count = np.zeros(len(groups))
        # A spacing depends on the number of plants, and that on the spacing: a fixed point.
        for turn in range(6):  # denser sites, a few more plants on them
            if (turn == 0 or groups.any()) and (chance is not None or not periodic or groups.any()):
                share = count / max(count.sum(), 1.0)
                parts = [
                    clumping(
                        grouped(chance, extent, radius, part) if radius and turn else chance,
                        extent,
                        wide,
                        periodic=periodic,
                    )
                    for radius, part, wide in zip(groups, share, diameter, strict=True)
                ]
                clumps = jnp.asarray(np.stack(parts), self.dtype)
                scene = dataclasses.replace(scene, clumping=clumps)
            count = np.asarray(scene.counts(self.parameters), float)
            spacing = sites.spacing_for(float(whole_plants(count).sum()))
            scene = dataclasses.replace(scene, spacing=jnp.asarray(spacing, self.dtype))
        whole = jnp.asarray(whole_plants(np.asarray(scene.counts(self.parameters))), self.dtype)
        return dataclasses.replace(scene, whole=whole)

    @property
    def ground_area(self) -> float:
        """Area of the plot [m2]."""
        return float(np.prod(self.grid.extent[:2]))

    def whole_counts(self, parameters: PlotParameters) -> Float[Array, " species"]:
        """Whole number of plants of each species that stand, by `rounding` [-]. Its slope is 0."""
        # A whole number has no slope; `standing` has that of the expected stand.
        count = jax.lax.stop_gradient(self.counts(parameters)).astype(self.dtype)
        return rounded_count(count, self._lessened)

    @property
    def _lessened(self) -> Float[Array, " species"]:
        """What the real number of plants of each species is lessened by before it is rounded up."""
        return self.rounding if self.rules.rounding == "random" else jnp.zeros_like(self.rounding)

    @as_one
    def standing(self, parameters: PlotParameters) -> Float[Array, " plant"]:
        """Share in which every plant stands: 1 or 0, the first `whole_counts` of each species [-].

        Of a stand in expectation (`expected`), and wherever it is differentiated by the number of
        plants, one more plant of a species is spread over those about `expected_count`, each in
        part (`site_weight`).
        """
        if self.shares is not None:
            return self.shares
        planting, count = self.planting, self.counts(parameters).astype(self.dtype)
        number = rounded_count(jax.lax.stop_gradient(count), self._lessened)
        if self.rules.rounding == "up":  # which adds half a plant on average
            count = count + jnp.minimum(count, 0.5)
        some = expected_count(count, self.rounding)
        # Number in expectation and whole number of each plant's species, read at once.
        some, number = jnp.stack([some, number])[:, planting.species]
        whole = (number > planting.place).astype(some.dtype)
        if self.rules.softness == 0.0 and self.rules.softness_plants == 0.0:
            return whole
        share = site_weight(
            some, planting.place, width=self.rules.softness_plants, softness=self.rules.softness
        )
        slope = jnp.where(self.held, whole, share)
        return jnp.where(self.in_part, share, _whole(whole, slope))

    def crown_areas(self, parameters: PlotParameters) -> Float[Array, " plant"]:
        """Ground area of the crown of every plant that stands, else 0 [m2]. Differentiable, see
        `standing`."""
        return self.standing(parameters) * self._whole_crowns(parameters)

    def _whole_crowns(self, parameters: PlotParameters) -> Float[Array, " plant"]:
        """Ground area of the crown of every plant, if it stands [m2]."""
        diameter = jnp.asarray(parameters.species.diameter, self.dtype)
        whole = jnp.pi / 4.0 * diameter**2 / jnp.asarray(self.branches, self.dtype)
        return whole[self.planting.species] * self.planting.size**2

    def crown_share(self, parameters: PlotParameters) -> Float[Array, ""]:
        """Share of the crowns that is seen from above, where all stand at random [-]: what the
        areas of leaves and wood over crowns, as stated, count. Differentiable; see
        `fynjax.canopy.share_from_above`."""
        return share_from_above(self.crown_areas(parameters) / self.ground_area)

    @as_one
    def visible_crowns(self, parameters: PlotParameters) -> Float[Array, " plant"]:
        """Ground area of the crown of every plant that carries leaves and wood as stated [m2]:
        area is stated of crowns as seen from above, and what overlaps does not carry it twice."""
        crowns = self.crown_areas(parameters)
        return crowns * share_from_above(crowns / self.ground_area)

    def organ_index(self, parameters: PlotParameters) -> Float[Array, "species organ"]:
        """One-sided area of leaves, wood and flowers over the ground area of a crown [m2 m-2], as
        seen from outside the shoots: leaves of a shoot shade each other. Differentiable."""
        species = jax.tree.map(lambda x: jnp.asarray(x, self.dtype), parameters.species)
        full = np.array([FORMS[form].flower_fraction for form in self.forms])
        flower = species.leaf_area_index * jnp.asarray(self.rules.flowering * full, self.dtype)
        leaf = species.leaf_area_index * (1.0 - species.shoot_clumping)
        return jnp.stack([leaf, species.wood_area_index, flower], axis=-1)

    def area_density(self, parameters: PlotParameters) -> Float[Array, "class z y x"]:
        """Area per volume of each optical class: the species' leaves, then wood, flowers, and
        materials of their own (`leaf_classes`, `material_classes`)."""
        return self._deposit(parameters, [(self.grid, "class")])[0]

    @as_one
    def gap_fraction(self, parameters: PlotParameters) -> Float[Array, ""]:
        """Share of the ground that is seen from straight above, between leaves and stems [-].

        **Arguments:** `parameters`, of the plot. Differentiable, see `standing`.
        """
        down = seen_from_above(self.species, parameters.species.leaf_angle).astype(self.dtype)
        finest = self._finest()
        # One layer as high as the grid: straight down nothing else than its area counts.
        columns = VoxelGrid((*finest.shape[:2], 1), finest.horizontal_size, finest.extent[2])
        (density,) = self._deposit(parameters, [(columns, "all")], share=down)
        return jnp.mean(jnp.exp(-density * columns.vertical_size))

    def _finest(self) -> VoxelGrid:
        grid, times = self.grid, max(self.finer, 1)
        nx, ny, nz = (n * times for n in grid.shape)
        return VoxelGrid((nx, ny, nz), grid.horizontal_size / times, grid.vertical_size / times)

    @as_one
    def _deposit(
        self,
        parameters: PlotParameters,
        wanted: Sequence[tuple[VoxelGrid, Literal["class", "organ", "all"]]],
        *,
        share: Float[Array, " class"] | None = None,
        window: Window | None = None,
    ) -> list[Float[Array, "_class _z _y _x"]]:
        """Area per volume [m2 m-3] on each of the `wanted` grids: of each optical class, of each
        organ of each species (`Organ`, species by species) or of all; of `share` of each class's
        area, if that is given. Many elements are placed part by part, for the sake of memory."""
        if window is None:
            planting, boundary = self.planting, self.boundary
            standing, crown = self.standing(parameters), self._whole_crowns(parameters)
            # Area is stated of crowns as seen from above: where crowns overlap it counts once.
            crown = crown * share_from_above(standing * crown / self.ground_area)
        else:
            # A window has the plants that stand, with crowns as the whole scene has them.
            planting, boundary, crown = window.planting, "open", window.crown
            standing = jnp.ones_like(crown)
        if not planting.listed:
            raise InputError(
                f"the area elements of {len(planting.first)} plants are too many to be in memory "
                "at once: render the plot in tiles (`TiledPicture`, `fynjax render`), or take "
                "a smaller plot or larger voxels"
            )
        kinds = {
            "class": class_count(self.species),
            "organ": len(self.species) * len(Organ),
            "all": 1,
        }

        def densities(planting: Planting, weight: Array | float = 1.0) -> list[Array]:
            positions, area = self._elements(parameters, planting, crown, standing)
            if share is not None:
                weight = weight * share[planting.optical_class]
            kind = {
                "class": planting.optical_class,
                "organ": planting.species[planting.plant] * len(Organ) + planting.organ,
                "all": jnp.zeros_like(planting.plant),
            }
            return [
                deposit(
                    positions, area * weight, kind[by], grid, kinds[by],
                    width=self.tuft if self.finer and _holds(grid, self.tuft) else None,
                    boundary=boundary,
                )
                for grid, by in wanted
            ]  # fmt: skip

        return _summed(densities, planting)

    def _elements(
        self,
        parameters: PlotParameters,
        planting: Planting,
        crown: Float[Array, " plant"],
        standing: Float[Array, " plant"],
    ) -> tuple[Float[Array, "element 3"], Float[Array, " element"]]:
        """Places [m] and areas [m2] of the area elements of plants with crowns of `crown` [m2] that
        are there in the shares `standing`."""
        species = jax.tree.map(lambda x: jnp.asarray(x, self.dtype), parameters.species)
        # All of a species is read at once, and all of a plant: each reading is a loop of its own in
        # the derivative.
        of_species = jnp.stack([species.diameter, species.height, *self.organ_index(parameters).T])
        diameter, height, *index = of_species[:, planting.species]
        # A plant that stands in part is as much smaller, along all three axes; or, where shares are
        # given, as much thinner.
        small = jnp.sqrt(jnp.maximum(standing, SMALLEST**2)) if self.shares is None else 1.0
        # Foot, ground, size and areas: all that its elements need of a plant.
        of_plant = (
            *planting.foot.T,
            ground_at(self, planting.foot),
            diameter * planting.size * small,
            height * planting.stature * small,
            standing,
            *(crown * area for area in index),
        )
        *foot, diameter, height, share, leaf, wood, flower = jnp.stack(of_plant)[:, planting.plant]
        across, along = planting.unit_shapes()
        positions = jnp.stack(foot, axis=-1) + diameter[:, None] * across + height[:, None] * along
        area = jnp.select(
            [planting.organ == Organ.LEAF, planting.organ == Organ.WOOD], [leaf, wood], flower
        )
        return positions, area * planting.fraction * share

    def optics(
        self, parameters: PlotParameters, bands: BandSet
    ) -> tuple[OpticalClasses, Float[Array, " band"]]:
        """Optics of the classes (the species' leaves, wood, flowers, further materials) and the
        share of the light that comes from the sky [-], averaged over `bands`.

        **Arguments:** `parameters`, of the plot; `bands`, between 400 and 2500 nm.

        **Raises:** `InputError` where a spectrum of sky, dead tissue or a material does not cover
        the bands.

        Differentiable in `parameters`.
        """
        parameters = jax.tree.map(lambda x: jnp.asarray(x, self.dtype), parameters)
        wavelength = band_wavelengths(bands)
        average = jnp.asarray(bands.weights(wavelength), self.dtype)
        if self.dead_tissue is None:
            dead = background_spectrum("bark", wavelength)
        else:
            self.dead_tissue.check(min(bands.centre), max(bands.centre))
            dead = self.dead_tissue.at(wavelength)
        for material in (one for species in self.species for one in species.materials):
            for spectrum in (material.reflectance, material.transmittance):
                if spectrum is not None:
                    spectrum.check(min(bands.centre), max(bands.centre))
        classes = optical_classes(
            self.species, parameters, average, wavelength, dead, self.hot_spot
        )
        if self.sky is None:
            share = clear_sky_diffuse_fraction(
                jnp.asarray(wavelength, self.dtype),
                parameters.light.sun_zenith,
                parameters.light.aerosol,
            )
        else:
            self.sky.check(min(bands.centre), max(bands.centre))
            share = jnp.asarray(self.sky.at(wavelength), self.dtype)
        return classes, average @ share

    def voxels(
        self, parameters: PlotParameters, bands: BandSet, window: Window | None = None
    ) -> VoxelScene:
        """What the radiation layer renders: area, optics, ground and light of `parameters`,
        averaged over `bands`; of a part of level ground, with open sides, where `window` is given.
        Differentiable in `parameters`.

        Raises `InputError` where a spectrum of ground, sky, dead tissue or a material does not
        cover the bands.
        """
        parameters = jax.tree.map(lambda x: jnp.asarray(x, self.dtype), parameters)
        classes, sky = self.optics(parameters, bands)
        light = parameters.light
        grid, columns = self.class_grid, self._columns
        terrain = None if self.terrain is None else jnp.asarray(self.terrain, self.dtype)
        pattern = None if self.sky_pattern is None else jnp.asarray(self.sky_pattern, self.dtype)
        ground, shape = columns(self.ground_map(parameters, bands)), None
        if self.ground.shape is not None:
            # The same shape of the reflectance in all bands.
            alike = (jnp.full(len(sky), value, self.dtype) for value in self.ground.shape)
            shape = RahmanPintyVerstraete(*alike)
            # Spectra of ground are measured from above, lit from 45 degrees: there they stay.
            measured = jnp.array([[[0.5**0.5, 0.0, -(0.5**0.5)]], [[0.0, 0.0, 1.0]]], self.dtype)
            ground = ground / shape.shape(*measured).reshape(-1, *(1,) * (ground.ndim - 1))
        finest, boundary = self._finest(), self.boundary
        if window is not None:
            # Voxels of the window, coarse and fine, of the kinds that the whole scene has.
            times = finest.shape[0] // grid.shape[0]
            grid, finest, boundary = window.grid(grid), window.grid(finest, times), "open"
            ground = window.cut(ground) if ground.ndim == 3 else ground
        # Optics by class on coarse voxels; on the finest all that blocks sun and sight.
        wanted: list[tuple[VoxelGrid, Literal["class", "organ", "all"]]] = [(grid, "class")]
        if self.finer:
            wanted.append((finest, "all"))
        density, *structure = self._deposit(parameters, wanted, window=window)
        return VoxelScene(
            density,
            classes,
            ground,
            Illumination(light.sun_zenith, light.sun_azimuth, 1.0 - sky, sky, pattern),
            grid.horizontal_size,
            grid.vertical_size,
            boundary,
            ground_shape=shape,
            terrain=None if terrain is None else columns(terrain),
            structure=structure[0][0] if structure else None,
        )

    def voxels_by_organ(
        self, parameters: PlotParameters, bands: BandSet, window: Window | None = None
    ) -> VoxelScene:
        """`voxels` whose classes are leaves, wood and flowers of each species, species by species
        (`Organ`); sun and sight meet the same area. Where plants of a species have different leaves
        all have the mean of their optics, as facets of different materials have by their areas.
        Differentiable in `parameters`."""
        voxels = self.voxels(parameters, bands, window)
        optics = voxels.classes
        shares = class_shares(self.species).reshape(-1, len(optics.reflectance))
        of_organ = [np.flatnonzero(row) for row in shares]

        def mean(optics: Array) -> Array:
            means = [
                optics[own].mean(axis=0) if np.ptp(row[own]) == 0.0 else row[own] @ optics[own]
                for row, own in zip(shares.astype(optics.dtype), of_organ, strict=True)
            ]
            return jnp.stack(means)

        classes = dataclasses.replace(
            optics,
            reflectance=mean(optics.reflectance),
            transmittance=mean(optics.transmittance),
            angle_of_class=tuple(optics.angle_of_class[own[0]] for own in of_organ),
            size_of_class=tuple(optics.sizes[own[0]] for own in of_organ),
        )
        parameters = jax.tree.map(lambda x: jnp.asarray(x, self.dtype), parameters)
        grid = self.class_grid if window is None else window.grid(self.class_grid)
        (density,) = self._deposit(parameters, [(grid, "organ")], window=window)
        return dataclasses.replace(voxels, area_density=density, classes=classes)

    @property
    def class_grid(self) -> VoxelGrid:
        """The grid on which `voxels` keeps the classes apart: where sun and sight follow the plants
        on finer voxels, whole voxels of the plot's together, up to 10 cm."""
        grid, times = self.grid, self._together()
        nx, ny, nz = (n // times for n in grid.shape)
        return VoxelGrid((nx, ny, nz), grid.horizontal_size * times, grid.vertical_size * times)

    def _together(self) -> int:
        size = max(self.grid.horizontal_size, self.grid.vertical_size)
        most = int(_COMPOSITION / size + 1e-6) if self.finer else 1
        return max(n for n in range(1, max(most, 1) + 1) if not any(m % n for m in self.grid.shape))

    def _columns(self, field: Array) -> Array:
        """Mean of a map over the plot's voxel columns in those of `class_grid`."""
        times = self._together()
        if field.ndim < 2:
            return field
        *bands, ny, nx = field.shape
        cut = field.reshape(*bands, ny // times, times, nx // times, times)
        return cut.mean(axis=(-3, -1))

    def ground_map(self, parameters: PlotParameters, bands: BandSet) -> Float[Array, " band *yx"]:
        """Reflectance of the ground in `bands` [-]: of all of it, or of each voxel column where its
        covers lie in patches. Raises `InputError` as `voxels`."""
        wavelength = band_wavelengths(bands)
        average = jnp.asarray(bands.weights(wavelength), self.dtype)
        ground, patches = parameters.ground, self.ground.patches
        # In the order of `COVERS`; soil is what they leave.
        fractions = jnp.stack([ground.litter_fraction, ground.char_fraction, ground.rock_fraction])
        fractions = fractions.astype(self.dtype)
        spectra = average @ self.ground_spectra(parameters, wavelength).T
        if patches is None:
            shares = kind_shares(fractions)
        else:
            shares = ground_shares(fractions, jnp.asarray(patches, self.dtype))
        return jnp.clip(jnp.tensordot(spectra, shares, axes=1), 0.0, 1.0)

    def ground_spectra(
        self, parameters: PlotParameters, wavelength: Float[np.ndarray, " wavelength"]
    ) -> Float[Array, "kind wavelength"]:
        """Reflectance of soil, litter, char and rock at `wavelength` [nm], whole numbers [-]."""
        if self.ground.soil is None:
            names = ("dry_soil", "wet_soil")
            soil = [background_spectrum(name, wavelength) for name in names]
        else:
            self.ground.soil.check(wavelength[0], wavelength[-1])
            soil = [self.ground.soil.at(wavelength)] * 2
        dry, wet = (jnp.asarray(spectrum, self.dtype) for spectrum in soil)
        covers = jnp.asarray(self.ground.cover_spectra(wavelength), self.dtype)
        ground = parameters.ground
        # Soil is a mixture of dry and wet, made brighter or darker as a whole.
        mixed = ground.brightness * ((1 - ground.moisture) * dry + ground.moisture * wet)
        return jnp.concatenate([mixed[None], covers])


def _summed(
    function: Callable[[Planting, Array | float], list[Array]], planting: Planting
) -> list[Array]:
    """A function of area elements and their weights, summed over parts of those of `planting`."""
    count = planting.plant.shape[0]
    if count <= _AT_ONCE:
        return function(planting, 1.0)
    parts = -(-count // _AT_ONCE)
    size = -(-count // parts)

    def add(total: list[Array], number: Array) -> tuple[list[Array], None]:
        # The last part begins within the one before, whose elements then count no more.
        start = jnp.minimum(number * size, count - size)
        elements = dataclasses.replace(
            planting,
            plant=jax.lax.dynamic_slice_in_dim(planting.plant, start, size),
            part=jax.lax.dynamic_slice_in_dim(planting.part, start, size),
        )
        new = start + jnp.arange(size) >= number * size
        more = function(elements, new.astype(planting.foot.dtype))
        return jax.tree.map(jnp.add, total, more), None

    like = jax.eval_shape(lambda: function(planting, 1.0))
    start = [jnp.zeros(one.shape, one.dtype) for one in like]
    # Each part is computed again for its derivative, lest memory hold the elements of all.
    return jax.lax.scan(jax.checkpoint(add), start, jnp.arange(parts))[0]


def _fitting(pattern: str, known: Mapping[str, Any]) -> list[str]:
    """Names that a pattern fits. Raises `InputError` where there are none."""
    names = [name for name in known if fnmatchcase(name, pattern)]
    if not names:
        raise InputError(
            f"{pattern!r} fits none of the scene's parameters.{did_you_mean(pattern, known)}"
        )
    return names


def ground_at(scene: Scene, foot: Float[Array | np.ndarray, "plant 2"]) -> Float[Array, " plant"]:
    """Height of the ground of `scene` under plants at `foot` [m], above its lowest."""
    if scene.terrain is None:
        return jnp.zeros(foot.shape[0], foot.dtype)
    ny, nx = scene.terrain.shape
    at = jnp.floor(foot / scene.grid.horizontal_size).astype(jnp.int32)
    heights = jnp.asarray(scene.terrain, foot.dtype)
    return heights[jnp.clip(at[:, 1], 0, ny - 1), jnp.clip(at[:, 0], 0, nx - 1)]


@drawn_in_double
def build_scene(
    species: Sequence[Species],
    parameters: PlotParameters,
    *,
    extent: tuple[float, float],
    voxel: float,
    seed: SupportsIndex,
    boundary: Literal["periodic", "open"] = "periodic",
    rules: PlantingRules | None = None,
    ground: Ground | None = None,
    terrain: Float[np.ndarray, "y x"] | None = None,
    sky: Spectrum | None = None,
    sky_pattern: Float[np.ndarray, "zenith azimuth"] | None = None,
    dead_tissue: Spectrum | None = None,
    hot_spot: bool = False,
    plants: Sequence[PlantModel | None] | None = None,
    crowns: Crowns | None = None,
    room: Callable[[Scene], float | Float[np.ndarray, " species"]] | None = None,
    dtype: str = "float32",
) -> Scene:
    """Draw what is random about a scene, once.

    **Arguments:**

    - `species`: what is fixed about each.
    - `parameters`: the plot as described; gives the number of sites to hold ready.
    - `extent`: (east-west, north-south) sides of the plot [m].
    - `voxel`: edge of a voxel [m]; must divide the sides.
    - `seed`: of everything random; the same seed gives the same plants.
    - `boundary`: "periodic" repeats the plot for ever, "open" does not.
    - `rules`, `ground`, `terrain`, `sky`, `sky_pattern`, `dead_tissue`: see `PlantingRules` and
      `Scene`; left out, even planting on level, shipped ground under a clear, even sky, dead tissue
      as bark.
    - `hot_spot`: whether leaves have the size of their form, see `Scene`.
    - `plants`: shape of the plants of each species, for instance of a mesh, whose leaves then are
      inclined as the shape's; None: that of the growth form.
    - `crowns`: plants that are known, in place of those that are drawn; `rules` on how many plants
      there are, where, and of which size then do not count.
    - `room`: takes the scene before its plants are drawn and gives the `PlantingRules.room`, which
      `rules` have where it is left out.
    - `dtype`: floating type that the scene is computed in.

    In a dry run (`fynjax.app.jobs.dry_run`) nothing is drawn: the plants are counted (`ScenePlan`),
    and the scene has none.

    **Raises:** `InputError` where the plants do not fit, crowns are outside the plot, or voxels do
    not divide the sides.

    Not differentiable: the parameters come in again where the scene is observed.
    """
    check_known(parameters=parameters, extent=extent, voxel=voxel)
    rules = PlantingRules() if rules is None else rules
    seed = whole_number("seed", seed)
    top = 1.1 * float(np.max(np.asarray(parameters.species.height)))
    if terrain is not None:
        top += float(np.max(terrain))
    grid = VoxelGrid.cover(extent, top, voxel)
    finer = rules.finer(voxel)
    # Where the structure is followed, its cells need whole numbers of layers.
    even = _EVEN_LAYERS * max(1, int(_COMPOSITION / voxel + 1e-6)) if finer else _EVEN_LAYERS
    layers = -(-grid.shape[2] // even) * even
    if crowns is not None:  # who are as they are: nothing is spread
        rules = dataclasses.replace(rules, softness=0.0, softness_plants=0.0)
    shapes = [None] * len(species) if plants is None else plants
    species = [
        one if shape is None else dataclasses.replace(one, leaf_angle=inclination(shape))
        for one, shape in zip(species, shapes, strict=True)
    ]
    models = jax.tree.map(np.asarray, tuple(shapes))  # whose digits no precision changes
    scene = Scene(
        planting=no_plants(dtype),
        grid=VoxelGrid((*grid.shape[:2], layers), voxel, voxel),
        parameters=parameters,
        species=tuple(species),
        recipe=Recipe(rules, models, extent),
        planted=None,
        boundary=boundary,
        rounding=jnp.zeros(len(species), dtype),
        tuft=rules.tuft,
        finer=finer,
        ground=Ground() if ground is None else ground,
        terrain=terrain,
        sky=sky,
        sky_pattern=sky_pattern,
        dead_tissue=dead_tissue,
        hot_spot=hot_spot,
        dtype=dtype,
        known_plants=crowns is not None,
    )._counting()
    check_projected_scene(scene, parameters)
    if finer:
        _check_structure(scene)
        scene = dataclasses.replace(scene, tuft=_fitting_tuft(scene))
    size = parameters.species
    counts, diameter, height = map(
        np.asarray, (scene.counts(parameters), size.diameter, size.height)
    )
    ready = rules.room if room is None else room(scene)
    scene = dataclasses.replace(
        scene,
        recipe=Recipe(dataclasses.replace(rules, room=ready), models, extent),
        planted=Planted(counts, diameter, height),
    )
    if crowns is not None:
        within = (crowns.foot >= 0.0) & (crowns.foot < np.asarray(extent))
        outside = np.asarray(~within.all(axis=1))
        if outside.any():
            x, y = crowns.foot[np.argmax(outside)]
            raise InputError(
                f"{int(outside.sum())} of {outside.size} crowns are outside the plot of "
                f"{extent[0]:g} m x {extent[1]:g} m, the first at ({x:g}, {y:g})"
            )
    if crowns is None:
        return scene._drawn(seed)
    known, bare = jnp.asarray(crowns.counts(scene.branches), dtype), scene._without_plants(seed)
    if counted(lambda _: _plan(bare, scene._stand(seed), ready, known)):
        return dataclasses.replace(bare, number=known)
    planting = known_planting(scene._stand(seed), crowns)
    return dataclasses.replace(bare, planting=planting)


def _plan(
    scene: Scene, stand: Stand, room: float | Float[np.ndarray, " species"], known: Array | None
) -> ScenePlan:
    """What `build_scene` would plant; `known` are numbers of plants that all stand."""
    if known is None:
        plants = np.asarray(scene.whole_counts(scene.parameters))
        sites = sites_ready(np.asarray(scene.counts(scene.parameters)), room)
    else:
        plants = sites = np.asarray(known)
    return ScenePlan.of(stand, plants, sites, voxels=scene.grid.shape, finer=scene.finer)


def check_projected_scene(
    scene: Scene, parameters: PlotParameters, file: Path | None = None
) -> None:
    """Raise `InputError` for covers that plants at random cannot have (`check_projected`).

    **Arguments:**

    - `scene`: whose covers may have either definition.
    - `parameters`: of the plot.
    - `file`: that states them, for the error.
    """
    if scene.rules.cover_definition == "article" or scene.known_plants:
        return
    most = most_projected(1.0 if scene.clumping is None else scene.clumping)
    for i, one in enumerate(scene.species):
        terms = {n: float(getattr(parameters.species, n)[i]) for n in ("packing", "fill")}
        terms |= {n: getattr(one, n) for n in ("branches", "minimum_area")}
        largest = float(np.broadcast_to(most, len(scene.species))[i])
        cover = float(parameters.species.cover[i])
        check_projected(one.taxon, cover, terms, largest, file=file)


def _fitting_tuft(scene: Scene) -> float:
    """Edge of tufts that go with the voxels of a scene: no wider than one, or as wide as a whole
    number of them. Of the finest, and of those of its classes; the nearest to what is asked for."""
    tuft, edge = scene.tuft, scene.grid.horizontal_size / scene.finer
    if tuft <= edge:
        return tuft
    widest = scene.class_grid.horizontal_size
    unit = edge if tuft <= widest else widest
    return unit * round(tuft / unit)


def _holds(grid: VoxelGrid, tuft: float) -> bool:
    """Whether a tuft is no wider than a voxel, or as wide as a whole number of them."""
    times = tuft / np.array([grid.horizontal_size, grid.vertical_size])
    return bool(np.all((times <= 1 + 1e-6) | (np.abs(times - np.round(times)) < 1e-6 * times)))


def _check_structure(scene: Scene) -> None:
    """Raise `InputError` for a structure of too many voxels."""
    count = int(np.prod([float(n) for n in scene.grid.shape])) * scene.finer**3
    if count > _MOST_VOXELS:
        raise InputError(
            f"`structure` asks for {count:.3g} of the finest voxels, but at most "
            f"{_MOST_VOXELS:.3g} can be indexed: take a larger `structure`, a smaller plot, or "
            'leaves that fill the voxels evenly ("even")'
        )


def room_needed(
    scene: Scene, parameters: PlotParameters, counts: Float[np.ndarray | Array, "*draw species"]
) -> Float[np.ndarray, " species"]:
    """Sites for each plant of each species (`PlantingRules.room`) that counts of plants ask for.

    **Arguments:**

    - `scene`: with the sites held ready; where its plants are not drawn yet, those that
      `PlantingRules.room` will hold ready.
    - `parameters`: by which these are drawn.
    - `counts`: plants of each species, as `Scene.counts` has them [-].

    **Returns:** 0 for a species that has the sites.
    """
    return scene._room(np.asarray(scene.counts(parameters), float), np.asarray(counts))


def _rounding(species: int, seed: Sequence[int], dtype: str) -> Float[Array, " species"]:
    """`Scene.rounding` of so many species."""
    return jnp.asarray(generator(*seed, 107).random(species), dtype)
