"""Plants that were found in an image: crowns, maps and numbers, each with what is uncertain."""

import dataclasses
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float
from scipy import stats
from scipy.spatial import cKDTree

from fynjax._core.progress import advance, stage
from fynjax._core.seeds import generator
from fynjax.inversion._places import (
    PlacesSettings,
    candidates,
    crowns_of_table,
    descend,
    free_early,
    places_model,
)
from fynjax.inversion._shapes import OUTLINE
from fynjax.inversion._space import ParameterSpace
from fynjax.inversion._stands import WholeStand, whole_stands
from fynjax.scene import AimedSensor, Instances, ModelError, Scene, projected_cover

if TYPE_CHECKING:
    import pandas as pd

INTERVAL = (0.05, 0.5, 0.95)
"""Quantiles that tables and maps have."""
_SAME = 0.5
"""Crowns of two stands whose middles are nearer than this are one plant [crown radii]."""
_SELDOM = 0.2
"""Plants of fewer of the stands than this are in no table of crowns [-]."""


@dataclasses.dataclass(frozen=True)
class FoundMaps:
    """Maps over the plot, rows from the south."""

    cell: float
    """Side of a cell [m]."""
    crown: Float[np.ndarray, "y x"]
    """Probability that a crown is over the cell [-]."""
    species: Float[np.ndarray, "species y x"]
    """Probability that the tallest crown over it is of each species [-]."""
    height: Float[np.ndarray, "quantile y x"]
    """Height of the tallest plant over it, 0 over bare ground: `INTERVAL` [m]."""

    @property
    def likeliest(self) -> tuple[np.ndarray, Float[np.ndarray, "y x"]]:
        """Likeliest species of each cell, -1 for bare ground, and the probability that it is
        another [-]."""
        every = np.concatenate([self.species, 1.0 - self.crown[None]])
        best = every.argmax(axis=0)
        return np.where(best == len(self.species), -1, best), 1.0 - every.max(axis=0)


@dataclasses.dataclass(frozen=True)
class FoundPlants:
    """Plants found in an image, as stands that image and species table leave possible."""

    scene: Scene
    """The plot of the species table."""
    stands: list[WholeStand]
    """The stands."""
    space: ParameterSpace
    """The parameters that were free beside the plants."""
    camera: AimedSensor
    """Of the compared blocks of pixels."""
    measured: Float[np.ndarray, "band y x"]
    """Reflectance of these [-]; NaN where they are not compared."""
    expected: Float[np.ndarray, "band y x"]
    """Mean image of the stands, times the estimated gains of the bands [-]."""
    pixel_sd: Float[np.ndarray, " band"]
    """Expected error of a block, as a share of it: mostly by shapes of plants [-]."""
    together: float
    """Blocks that err as one [-]."""

    @property
    def misfit(self) -> float:
        """Squared whitened misfit of a value, median of the stands [-]; about 1 where the model
        describes the plot."""
        return float(np.median([stand.misfit for stand in self.stands]))

    def instances(self, stand: WholeStand) -> Instances:
        """The plants of one of the stands, for `projected_cover` and pictures."""
        none, (x, y) = np.zeros(len(stand.species)), stand.foot.T
        return Instances(
            self.scene.taxa, self.scene.grid.extent[:2], stand.species, x, y, none, none, none,
            stand.diameter, stand.height,
        )  # fmt: skip

    def maps(self, cell: float = 0.05) -> FoundMaps:
        """Maps of crowns, species and heights, in cells of side `cell` [m], which must divide the
        plot's sides (`InputError`)."""
        periodic = self.scene.boundary == "periodic"
        species, heights = 0.0, []
        for stand in self.stands:
            top = projected_cover(self.instances(stand), cell=cell, periodic=periodic).top
            kind = np.where(top >= 0, np.append(stand.species, -1)[top], -1)
            species = species + (kind == np.arange(len(self.scene.taxa))[:, None, None])
            heights.append(np.where(top >= 0, np.append(stand.height, 0.0)[top], 0.0))
        share = np.asarray(species, float) / len(self.stands)
        return FoundMaps(cell, share.sum(axis=0), share, np.quantile(heights, INTERVAL, axis=0))

    def crowns(self) -> "pd.DataFrame":
        """A row for each plant that is in a fifth of the stands or more, the surest first.

        Columns: x_m and y_m of its foot from the plot's south-west corner, taxon (the likeliest),
        presence and taxon_probability [-], diameter_cm and height_m with their 5 % and 95 %
        quantiles as of `table`, and p_<taxon>, the probability of each species given that it
        stands. Of a plant that a single chain has these quantiles are too near to each other.
        """
        import pandas as pd  # late: the command line need not wait for it

        owner = np.repeat(np.arange(len(self.stands)), [len(s.species) for s in self.stands])
        foot, diameter, height, kind = (
            np.concatenate([getattr(s, n) for s in self.stands])
            for n in ("foot", "diameter", "height", "species")
        )
        groups = _together(foot, diameter, owner, self._side)
        chain = np.array([stand.chain for stand in self.stands])
        taxa, rows = self.scene.taxa, []
        for group in groups:
            presence = len(group) / len(self.stands)
            if presence < _SELDOM:
                continue
            share = np.bincount(kind[group], minlength=len(taxa)) / len(group)
            middle, low, high = _interval(100.0 * diameter[group], chain[owner[group]])
            mean, least, most = _interval(height[group], chain[owner[group]])
            first = foot[group[0]]
            x, y = self._within(first + _apart(foot[group] - first, self._side).mean(axis=0))
            likeliest = int(share.argmax())
            rows.append(
                {
                    "x_m": x, "y_m": y, "taxon": taxa[likeliest], "presence": presence,
                    "taxon_probability": share[likeliest],
                    "diameter_cm": middle, "diameter_q05_cm": low, "diameter_q95_cm": high,
                    "height_m": mean, "height_q05_m": least, "height_q95_m": most,
                    **{f"p_{taxon}": p for taxon, p in zip(taxa, share)},
                }
            )  # fmt: skip
        columns = [
            "x_m", "y_m", "taxon", "presence", "taxon_probability",
            *(f"diameter{q}_cm" for q in ("", "_q05", "_q95")),
            *(f"height{q}_m" for q in ("", "_q05", "_q95")),
            *(f"p_{taxon}" for taxon in taxa),
        ]  # fmt: skip
        frame = pd.DataFrame(rows, columns=columns)
        return frame.astype({name: float for name in columns if name != "taxon"})

    def table(self) -> "pd.DataFrame":
        """Plants and cover of each species, of each growth form and of all: of the species table,
        and found, with 5 % and 95 % quantiles. Cover is the sum of the crowns' areas over the plot
        [%]; `form` is empty for all together.

        Means of the chains. Each chain comes to leaves of its own, about which its stands differ
        little, so chains are taken for the few draws that they are (Rubin 1987, Multiple Imputation
        for Nonresponse in Surveys, eq. 3.1.6: Student's t). One chain has but its own median and
        quantiles.
        """
        import pandas as pd

        scene, taxa = self.scene, self.scene.taxa
        size = scene.parameters.species
        number = crowns_of_table(scene)
        stated = 100.0 * np.pi / 4.0 * np.asarray(size.diameter, float) ** 2 / scene.ground_area
        counts, covers = (
            np.array([np.bincount(s.species, w(s), len(taxa)) for s in self.stands])
            for w in (lambda s: None, lambda s: 25.0 * np.pi * s.diameter**2 / scene.ground_area)
        )
        forms, chain = np.array(scene.forms), np.array([stand.chain for stand in self.stands])
        rows = [
            ("species", t, f, np.arange(len(taxa)) == i)
            for i, (t, f) in enumerate(zip(taxa, forms))
        ]
        rows += [("growth form", f, f, forms == f) for f in dict.fromkeys(forms)]
        rows += [("all", "all", "", forms == forms)]
        found = []
        for level, name, form, which in rows:
            row = {"level": level, "name": name, "form": form}
            row |= {"table_plants": number[which].sum()}
            row |= _named("plants", _interval(counts[:, which].sum(axis=1), chain))
            row |= {"table_cover_percent": (number * stated)[which].sum()}
            row |= _named("cover_percent", _interval(covers[:, which].sum(axis=1), chain))
            found.append(row)
        return pd.DataFrame(found)

    def _within(self, foot: Float[np.ndarray, " 2"]) -> Float[np.ndarray, " 2"]:
        """A foot on the plot: beyond an edge of one that repeats itself it comes in again."""
        extent = np.asarray(self.scene.grid.extent[:2])
        foot = foot % extent if self.scene.boundary == "periodic" else foot
        return np.clip(foot, 0.0, np.nextafter(extent, 0.0))

    @property
    def _side(self) -> Float[np.ndarray, " 2"]:
        extent = np.asarray(self.scene.grid.extent[:2])
        return extent if self.scene.boundary == "periodic" else np.full(2, np.inf)

    def __str__(self) -> str:
        """How many plants of how many species were found, in a sentence."""
        row = self.table().iloc[-1]
        return (
            f"{row['plants']:.0f} plants ({row['plants_q05']:.0f} to {row['plants_q95']:.0f}; "
            f"{row['table_plants']:.0f} by the table), crowns over {row['cover_percent']:.0f} % "
            f"({row['cover_percent_q05']:.0f} to {row['cover_percent_q95']:.0f}; "
            f"{row['table_cover_percent']:.0f} by the table)."
        )


def _named(name: str, found: tuple[float, float, float]) -> dict[str, float]:
    return dict(zip((name, f"{name}_q05", f"{name}_q95"), found, strict=True))


def _interval(values: np.ndarray, chain: np.ndarray) -> tuple[float, float, float]:
    """Middle and 90 % interval of what is not negative (`table`): mean of chains and Student's t
    where there are several that differ, else median and quantiles."""
    each = [values[chain == one] for one in np.unique(chain)]
    means = np.array([np.mean(one) for one in each])
    between = means.var(ddof=1) * (1.0 + 1.0 / len(each)) if len(each) > 1 else 0.0
    if between > 0.0:
        left = sum(len(one) * np.var(one) for one in each)
        within = left / max(len(values) - len(each), 1)
        degrees = (len(each) - 1) * (1.0 + within / between) ** 2
        half = stats.t.ppf(INTERVAL[-1], degrees) * np.sqrt(within + between)
        low, middle, high = means.mean() + half * np.array([-1.0, 0.0, 1.0])
    else:
        low, middle, high = np.quantile(values, INTERVAL)
    return float(middle), max(float(low), 0.0), float(high)


def _apart(gap: np.ndarray, side: np.ndarray) -> np.ndarray:
    with np.errstate(invalid="ignore"):
        return np.where(np.isinf(side), gap, gap - side * np.round(gap / side))


def _together(
    foot: np.ndarray, diameter: np.ndarray, owner: np.ndarray, side: np.ndarray
) -> list[np.ndarray]:
    """Crowns of different stands that are one plant: those that most stands have first."""
    periodic = bool(np.isfinite(side).all())
    tree = cKDTree(foot % side if periodic else foot, boxsize=side if periodic else None)
    at = foot % side if periodic else foot
    near = []
    for i, found in enumerate(tree.query_ball_point(at, 0.5 * _SAME * diameter)):
        js = np.array(found)
        alike = np.abs(np.log(diameter[js] / diameter[i])) < np.log(2.0)
        js = js[alike | (js == i)]
        gap = np.hypot(*_apart(foot[js] - foot[i], side).T)
        js = js[np.argsort(gap, kind="stable")]  # the nearest of each stand
        near.append(js[np.unique(owner[js], return_index=True)[1]])
    free, groups = np.ones(len(foot), bool), []
    while free.any():
        size = np.array([np.count_nonzero(free[js]) if free[i] else 0 for i, js in enumerate(near)])
        group = near[int(size.argmax())]
        group = group[free[group]]
        free[group] = False
        groups.append(group)
    return groups


def _with_outlines(stand: WholeStand, random: np.random.Generator) -> WholeStand:
    """A stand with the errors of `OUTLINE`."""
    wide, tall = random.normal(size=(2, len(stand.species))) * np.reshape(
        [*OUTLINE.values()], (2, 1)
    )
    return stand._replace(
        diameter=stand.diameter * np.exp(wide), height=stand.height * np.exp(tall)
    )


def find_places(
    scene: Scene,
    image: Float[np.ndarray, "band y x"],
    camera: AimedSensor,
    space: ParameterSpace,
    settings: PlacesSettings | None = None,
    *,
    height: Float[np.ndarray, "y x"] | None = None,
    error: ModelError | None = None,
) -> FoundPlants:
    """Find the plants of a plot in an image: their places, species, diameters and heights.

    In each chain a search down the slopes of plants that stand in part gives weights of what stands
    where; whole stands are then drawn by these weights and by what pixels say (`whole_stands`).

    **Arguments:** `scene`, `image`, `camera`, `space`, `height` and `error` as of `places_model`;
    `settings`, `PlacesSettings` by default.

    **Returns:** `FoundPlants`.

    **Raises:** `InputError` as `places_model`, `MissingExtraError` without optax.

    Not differentiable; the image of plants in part is (`PlacesModel.image`).
    """
    settings = PlacesSettings() if settings is None else settings
    model = places_model(scene, image, camera, space, settings, height=height, error=error)
    stands, images = [], []
    for chain in range(settings.chains):
        # Each of its own start and shapes, lest all end beside the same wrong stand.
        own = (
            model
            if chain == 0
            else dataclasses.replace(model, candidates=candidates(scene, settings, chain))
        )
        with stage("Search by slopes", settings.steps):
            soft = descend(
                own, own.start(chain), settings.steps, free_early(space),
                watch=lambda _, misfit: advance(misfit=misfit),
            )  # fmt: skip
        with stage("Whole stands", settings.rounds):
            kept, mean = whole_stands(own, soft, settings.seed + chain)
        random = generator(settings.seed + chain, 313)
        stands += [_with_outlines(stand, random)._replace(chain=chain) for stand in kept]
        images.append(mean)
    covariance = np.linalg.inv(np.asarray(model.whiten, float))
    return FoundPlants(
        scene, stands, space, camera, np.asarray(model.target, float), np.mean(images, axis=0),
        np.sqrt(np.sum(covariance**2, axis=1)), float(model.together),
    )  # fmt: skip
