"""Whole stands from plants in part: which plants stand, drawn by what pixels say.

Plants come, go, move and become of another species one by one, each by what the image near it says
(Metropolis and Hastings, with jumps between numbers of plants: Green 1995, Biometrika 82:711).
Plants that are far from each other change in one image and are judged each by itself. Candidates
come from the weights that the search by slopes left; between the jumps parameters, places and sizes
follow their slopes.
"""

import dataclasses
from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int
from scipy.sparse import csr_array
from scipy.spatial import cKDTree

from fynjax._core.progress import advance
from fynjax._core.seeds import generator
from fynjax.inversion._places import CROWDING, MOVED, Places, PlacesModel, descend, free_late

_FAR = 1.0
"""Plants that change in one image are at least so far apart [m]: beyond their shadows."""
_NEAR = 0.3
"""Sites of plants that may change at a place are at most so far from it [m]."""
_SURE = 14.0
"""Logit of a plant that stands; minus that of one that does not."""
_STRIDE = 0.3
"""Standard deviation of a move [prior standard deviations]."""
_LEAST = 0.33
"""Least sum of weights of which a whole plant is made to begin with [plants]."""
_STEPS = 8
"""Steps down the slopes between rounds of jumps."""


class WholeStand(NamedTuple):
    """One stand that pixels and table leave possible."""

    species: Int[np.ndarray, " plant"]
    """Species of each plant."""
    site: Int[np.ndarray, " plant"]
    """Its site among the candidates'."""
    foot: Float[np.ndarray, "plant 2"]
    """Where it stands, from the plot's south-west corner [m]."""
    diameter: Float[np.ndarray, " plant"]
    """Of its crown [m]."""
    height: Float[np.ndarray, " plant"]
    """Of it [m]."""
    u: Float[np.ndarray, " free"]
    """Whitened coordinates of the free parameters."""
    band: Float[np.ndarray, " coordinate"]
    """Coordinates of the factors of the bands."""
    misfit: float
    """Of a value: 1 is expected of a model that describes the plot [-]."""
    chain: int = 0
    """The chain that it is of."""


class Jumps:
    """Whole stands of a model, one after the other.

    **Arguments:** `model`; `v`, where the search with plants in part ended; `seed` of the chain.
    """

    def __init__(self, model: PlacesModel, v: Places, seed: int) -> None:
        known = model.candidates
        self.model, self.random = model, generator(seed, 311)
        self.site, self.species = np.asarray(known.site), np.asarray(known.species)
        self.sites = len(known.place)
        self.place = np.asarray(known.place, float)
        self.reach = MOVED * np.asarray(known.reach, float)
        self.side = known.side
        self.extent = np.asarray(known.scene.grid.extent[:2])
        self.chance = np.asarray(known.chance, float)
        occupied = np.asarray(known.occupied, float)
        self.odds = np.log(self.chance) - np.log1p(-occupied)[self.site]
        self.number, self.apart = np.asarray(known.number, float), float(known.apart)
        weight = np.asarray(model.weights(v.logit)[0], float)
        self.weight = weight + 0.1 * self.chance
        self.soft = {n: np.asarray(getattr(v, n), float) for n in ("shift", "width", "tall")}
        self.v = v
        self.stands = np.full(self.sites, -1)
        """Candidate that stands at each site; -1: none."""
        self.of = {n: value.copy() for n, value in self.soft.items()}
        ny, nx = model.camera.shape
        x = (np.arange(nx) + 0.5) * model.camera.pixel + model.camera.origin[0]
        y = (np.arange(ny) + 0.5) * model.camera.pixel + model.camera.origin[1]
        self.blocks = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
        grid = known.scene.class_grid
        if model.height is None:
            columns = np.zeros((1, 2))
        else:
            n = [np.arange(k) + 0.5 for k in grid.shape[:2]]
            columns = np.stack(np.meshgrid(*n), axis=-1).reshape(-1, 2) * grid.horizontal_size
        self.columns = columns
        of_each = np.bincount(known.owner, known.scene.planting.count, len(self.site))
        self.cheapest = np.argsort(of_each, kind="stable")
        """Candidates, those of fewest area elements first."""
        self.most = max(16, int(1.25 * self.number.sum()))
        """Candidates that are rendered."""
        self.tried, self.taken = np.zeros(len(_KINDS), int), np.zeros(len(_KINDS), int)
        self._size_of_species()

    def _size_of_species(self) -> None:
        model = self.model
        scene, names = model.candidates.scene, model.space.names
        named = dict(zip(names, np.asarray(model.space.physical(self.v.u), float), strict=True))

        def own(kind: str) -> np.ndarray:
            table = np.asarray(getattr(scene.parameters.species, kind), float)
            each = zip(scene.taxa, table, strict=True)
            return np.array([named.get(f"species.{taxon}.{kind}", value) for taxon, value in each])

        self.diameter, self.height = own("diameter"), own("height")
        self.wider = self.diameter / np.asarray(scene.parameters.species.diameter, float)
        self.variation = scene.rules.size_variation
        self.spread = np.sqrt(np.log1p(self.variation**2))

    def places(self) -> tuple[PlacesModel, Places]:
        """The stand in the coordinates of the search, and the model of its plants and of some that
        do not stand, whose number changes seldom."""
        standing = self.stands[self.stands >= 0]
        while len(standing) > self.most:
            self.most += self.most // 2
        others = np.setdiff1d(self.cheapest, standing, assume_unique=True)
        chosen = np.sort(np.append(standing, others[: self.most - len(standing)]))
        few = dataclasses.replace(self.model, candidates=self.model.candidates.only(chosen))
        single = lambda x: jnp.asarray(x, self.v.u.dtype)  # noqa: E731
        logit = single(np.where(np.isin(chosen, standing), _SURE, -_SURE))
        own = {n: single(value) for n, value in self.of.items()}
        return few, dataclasses.replace(self.v, logit=logit, **own)

    def crowns(self) -> WholeStand:
        """The stand as it is."""
        at = np.flatnonzero(self.stands >= 0)
        kind = self.species[self.stands[at]]
        now = dataclasses.replace(self.v, **jax.tree.map(jnp.asarray, self.of))
        size, stature = (np.asarray(x, float)[at] for x in self.model.sizes(now))
        foot = self._within(self._feet_now(at))
        return WholeStand(
            kind, at, foot, self.diameter[kind] * size, self.height[kind] * stature,
            np.asarray(self.v.u, float), np.asarray(self.v.band, float), self.misfit,
        )  # fmt: skip

    @property
    def misfit(self) -> float:
        return float(self.pixels.sum() / self.model.values)

    def render(self) -> None:
        """The image of the stand, and its misfits."""
        self.image, self.pixels, self.heights = (
            np.asarray(x, float) for x in _seen(*self.places())
        )

    def plant(self) -> None:
        """Whole plants where parts of plants stand together, at the middle of these: drawn one by
        one, by the square of the sum of weights of a species within half a crown."""
        left, feet = self.weight - 0.1 * self.chance, self._feet_now(np.arange(self.sites))
        size = np.asarray(self.model.sizes(self.v)[0], float)
        crown = self.diameter[self.species] * size[self.site]
        tree, sites = self._tree(feet), np.arange(self.sites)
        of_site = np.split(np.argsort(self.site, kind="stable"), self._ends())
        near, parts = [], []
        for i in range(len(left)):
            around = tree.query_ball_point(self._within(feet[self.site[i]]), 0.5 * crown[i])
            js = np.concatenate([of_site[s] for s in sites[around]])
            gap = np.hypot(*self._gap(feet[self.site[js]] - feet[self.site[i]]).T)
            part = np.clip(2.0 - 4.0 * gap / crown[i], 0.0, 1.0) * (crown[js] > 0.6 * crown[i])
            near.append(js)
            parts.append(part * (self.species[js] == self.species[i]))
        ends = np.cumsum([0, *map(len, near)])
        own = csr_array((np.concatenate(parts), np.concatenate(near), ends))
        while True:
            mass = own @ left
            mass = np.where((self.stands[self.site] >= 0) | (mass < _LEAST), 0.0, mass)
            if not mass.any():
                return
            likely = mass**2 * (left + 0.01)
            i = int(self.random.choice(len(mass), p=likely / likely.sum()))
            js, s = near[i], self.site[i]
            share = left[js] * parts[i] / mass[i]
            gap = self._gap(feet[self.site[js]] - feet[s])
            self.stands[s] = i
            self.of["shift"][s] += share @ gap / self.reach[s]
            for name in ("width", "tall"):
                self.of[name][s] = share @ self.soft[name][self.site[js]]
            # Whatever else may stand within the crown is in it.
            far = np.hypot(*gap.T) / crown[i]
            inside = np.clip(2.0 - 4.0 * far, 0.0, 1.0) * (crown[js] > 0.6 * crown[i])
            left[js] *= 1.0 - min(1.0, 1.0 / mass[i]) * inside

    def _ends(self) -> Int[np.ndarray, " site"]:
        """Where the candidates of each site but the last end, of all in the order of sites."""
        return np.cumsum(np.bincount(self.site, minlength=self.sites))[:-1]

    def _tree(self, feet: np.ndarray) -> cKDTree:
        periodic = bool(np.isfinite(self.side).all())
        return cKDTree(self._within(feet), boxsize=self.side if periodic else None)

    def _within(self, feet: np.ndarray) -> np.ndarray:
        """Feet on the plot: beyond an edge of one that repeats itself they come in at the other."""
        if np.isfinite(self.side).all():
            return feet % self.side
        return np.clip(feet, 0.0, np.nextafter(self.extent, 0.0))

    def _gap(self, gap: np.ndarray) -> np.ndarray:
        with np.errstate(invalid="ignore"):
            return np.where(np.isinf(self.side), gap, gap - self.side * np.round(gap / self.side))

    def follow(self, steps: int, rate: float) -> None:
        """Steps down the slopes of places, sizes and parameters, which plants stand being given."""
        self.v = descend(*self.places(), steps, free_late(), rate)
        self.of = {n: np.asarray(getattr(self.v, n), float).copy() for n in self.of}
        self._size_of_species()
        self.render()

    def jump(self) -> None:
        """Changes at places far from each other, each taken or not by what is seen around it."""
        random = self.random
        centres: list[np.ndarray] = []
        for _ in range(4 * int(np.prod(self.extent) / _FAR**2) + 4):
            one = random.random(2) * self.extent
            if all(np.hypot(*self._gap(one - other)) >= _FAR for other in centres):
                centres.append(one)
        changes = [change for c in centres if (change := self._propose(c)) is not None]
        if not changes:
            return
        for change in changes:
            self._set(change.after)
        old, image = (self.pixels, self.heights), self.image
        self.render()
        new = self.pixels, self.heights
        middle = np.array([c.centre for c in changes])
        excess = max(float(old[0].sum() / self.model.values), 1.0)
        gain, nearest = np.zeros(len(changes)), []
        for was, now, points, weight in zip(
            old,
            new,
            (self.blocks, self.columns),
            (1.0 / float(self.model.together), 1.0),
            strict=True,
        ):
            gaps = np.stack([np.hypot(*self._gap(points - m).T) for m in middle])
            of = np.argmin(gaps, axis=0)
            nearest.append(of.reshape(was.shape))
            gain += 0.5 * weight * np.bincount(of, (was - now).ravel(), len(changes)) / excess
        taken = np.log(random.random(len(changes))) < gain + np.array([c.ratio for c in changes])
        for change, yes in zip(changes, taken):
            self.tried[change.kind] += 1
            self.taken[change.kind] += yes
            if not yes:
                self._set(change.before)
        # What was not taken has the image that it had.
        self.pixels, self.heights = (
            np.where(taken[at], now, was) for at, now, was in zip(nearest, new, old, strict=True)
        )
        self.image = np.where(taken[nearest[0]], self.image, image)

    def _set(self, change: "dict[int, tuple[int, dict[str, np.ndarray]]]") -> None:
        for site, (candidate, of) in change.items():
            self.stands[site] = candidate
            for name, value in of.items():
                self.of[name][site] = value

    def _state(self, site: int) -> tuple[int, dict[str, np.ndarray]]:
        return int(self.stands[site]), {n: v[site].copy() for n, v in self.of.items()}

    def _prior(self, sites: "list[int]") -> float:
        """Logarithm of the prior density of what stands at sites, and of all covers."""
        stand = np.flatnonzero(self.stands >= 0)
        each = np.exp(self.spread * self.of["width"][stand]) / (1.0 + self.variation**2)
        kind = self.species[self.stands[stand]]
        crowns = np.bincount(kind, (each * self.wider[kind]) ** 2, len(self.number))
        sd = np.sqrt((self.model.settings.cover_sd * self.number) ** 2 + 0.25)
        density = -0.5 * float(np.sum(((crowns - self.number) / sd) ** 2))
        feet = self._feet_now
        for s in sites:
            if self.stands[s] < 0:
                continue
            density += self.odds[self.stands[s]] + _normal(self.of, s)
            others = stand[stand != s]
            gap = np.hypot(*self._gap(feet(others) - feet(np.array([s]))).T)
            density -= CROWDING * float(np.maximum(1.0 - gap / self.apart, 0.0).sum())
        return density

    def _feet_now(self, sites: np.ndarray) -> np.ndarray:
        return self.place[sites] + self.reach[sites, None] * self.of["shift"][sites]

    def _propose(self, centre: np.ndarray) -> "_Change | None":
        random = self.random
        # By sites, not feet: what may change here then is the same before and after.
        close = np.hypot(*self._gap(self.place - centre).T) < _NEAR
        here = np.flatnonzero(close & (self.stands >= 0))
        free = close[self.site] & (self.stands[self.site] < 0)
        kind = int(random.choice(len(_KINDS), p=_KINDS_SHARE))
        name = _KINDS[kind]
        if name == "come":
            total = self.weight[free].sum()
            if total <= 0.0:
                return None
            i = int(random.choice(len(free), p=np.where(free, self.weight, 0.0) / total))
            s = int(self.site[i])
            before = {s: self._state(s)}
            drawn, density = self._drawn(s)
            after = {s: (i, drawn)}
            # The way back: it goes, one of those that then are here.
            ratio = np.log(total / self.weight[i]) - np.log(len(here) + 1.0) - density
        elif not len(here):
            return None
        else:
            s = int(random.choice(here))
            i, of = self._state(s)
            before = {s: (i, of)}
            if name == "go":
                after = {s: (-1, of)}
                total = self.weight[free].sum() + self.weight[self.site == s].sum()
                ratio = np.log(self.weight[i] / total) + np.log(len(here)) + self._density(s, of)
            elif name == "move":
                stride = _STRIDE * np.exp(random.normal())
                moved = {n: v + stride * random.normal(size=v.shape) for n, v in of.items()}
                after, ratio = {s: (i, moved)}, 0.0
            elif name == "turn":  # into another species, of the same size
                others = np.flatnonzero((self.site == s) & (np.arange(len(self.site)) != i))
                if not len(others):
                    return None
                j = int(random.choice(others))
                wider = np.log(self.diameter[self.species[i]] / self.diameter[self.species[j]])
                after = {s: (j, of | {"width": of["width"] + wider / self.spread})}
                ratio = 0.0
            else:  # one goes and another comes nearby
                empty = free | (self.site == s)
                empty[i] = False
                total = np.where(empty, self.weight, 0.0)
                if not total.any():
                    return None
                j = int(random.choice(len(total), p=total / total.sum()))
                t = int(self.site[j])
                before |= {t: self._state(t)}
                drawn, density = self._drawn(t)
                after = {s: (-1, of)} | {t: (j, drawn)}
                back = total.sum() - self.weight[j] + self.weight[i]
                ratio = np.log(self.weight[i] / back) - np.log(self.weight[j] / total.sum())
                ratio += self._density(s, of) - density
        sites = list(before)
        was = self._prior(sites)
        self._set(after)
        ratio += self._prior(sites) - was
        self._set(before)
        return _Change(kind, centre, before, after, float(ratio))

    def _drawn(self, site: int) -> tuple[dict[str, np.ndarray], float]:
        """Place and size of a plant that comes, about those of the search by slopes, and the
        logarithm of their density."""
        drawn = {
            n: 0.7 * v[site] + 0.7 * self.random.normal(size=v[site].shape)
            for n, v in self.soft.items()
        }
        return drawn, self._density(site, drawn)

    def _density(self, site: int, of: dict[str, np.ndarray]) -> float:
        return sum(
            float(np.sum(-0.5 * ((v - 0.7 * self.soft[n][site]) / 0.7) ** 2 - np.log(0.7)))
            for n, v in of.items()
        )


class _Change(NamedTuple):
    """What may change at a place, and the logarithm of what but pixels says of it."""

    kind: int
    centre: np.ndarray
    before: dict[int, tuple[int, dict[str, np.ndarray]]]
    after: dict[int, tuple[int, dict[str, np.ndarray]]]
    ratio: float


_KINDS = ("come", "go", "move", "turn", "replace")
_KINDS_SHARE = (0.2, 0.2, 0.25, 0.15, 0.2)


def _normal(of: dict[str, np.ndarray], site: int) -> float:
    return -0.5 * sum(float(np.sum(v[site] ** 2)) for v in of.values())


@eqx.filter_jit
def _seen(model: PlacesModel, v: Places) -> tuple[Array, Array, Array]:
    image, height = model.image(v, model.weights(v.logit)[0])
    return image, *model.misfits(image, height)


def whole_stands(
    model: PlacesModel, v: Places, seed: int, watch: Callable[[int, Jumps], None] | None = None
) -> tuple[list[WholeStand], Float[np.ndarray, "band y x"]]:
    """Stands that pixels and table leave possible.

    **Arguments:** `model`; `v`, where the search with plants in part ended; `seed`; `watch`, called
    after every round.

    **Returns:** the stands of the second half of the rounds, and their mean image.
    """
    settings, chain = model.settings, Jumps(model, v, seed)
    chain.plant()
    chain.render()
    chain.follow(2 * _STEPS, 1.0)
    kept, images = [], np.zeros_like(chain.image)
    for turn in range(settings.rounds):
        for _ in range(settings.jumps):
            chain.jump()
        late = turn >= settings.rounds // 2
        if not late or turn % 4 == 0:
            chain.follow(_STEPS, 0.3 if late else 0.6)
        if late:
            kept.append(chain.crowns())
            images += chain.image
        advance(misfit=chain.misfit)
        if watch is not None:
            watch(turn, chain)
    return kept, images / len(kept)
