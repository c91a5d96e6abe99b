"""What statistics of a plot are to be expected: means over plantings and over what is unknown of
the parameters, their slopes and their covariance."""

from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from fynjax._core.errors import InputError
from fynjax._core.programs import concrete
from fynjax.inversion._data import Data
from fynjax.inversion._factors import PlotSpace
from fynjax.inversion._fit_result import repeated_information, scatter_covariance, scatter_of_views
from fynjax.inversion._views import PlotForward
from fynjax.scene import PlotParameters, Scene, with_values

Stand = TypeVar("Stand")

_FARTHEST = 2.2
"""Largest distance of a drawn parameter from its mean [standard deviations]."""


def unit_draw(seed: int, number: int, space: PlotSpace) -> Float[np.ndarray, " coordinate"]:
    """Independent unit normal numbers of the draw of a `number`, one for each coordinate of a
    `space`. Two in a row are opposite (antithetic), so that what is linear in these leaves a mean
    as it is. Those of the parameters do not depend on how many factors there are."""
    sizes = len(space.plot.names), space.factors.coordinates
    normal = np.concatenate(
        [
            np.random.default_rng([seed, stream, number // 2]).normal(size=size)
            for stream, size in zip((83, 84), sizes, strict=True)
        ]
    ).clip(-_FARTHEST, _FARTHEST)
    return normal if number % 2 == 0 else -normal


def each(
    function: Callable[[Stand, Array], Array], stands: Sequence[Stand], places: Sequence[Array]
) -> list[Array]:
    """`function` of each of the `stands` at its place, of two at a time: programs of JAX run beside
    each other where there are cores, and memory holds those of two at most."""
    pairs = list(zip(stands, places, strict=True))
    if not concrete(places):
        return [function(*pair) for pair in pairs]
    call = of_thread(function)
    # The first call compiles; two threads at once would compile the same program twice.
    alone = [call(*pairs[0])] if is_new(function, *pairs[0]) else []
    with ThreadPoolExecutor(2) as pool:
        return [*alone, *pool.map(lambda pair: call(*pair), pairs[len(alone) :])]


def of_thread(function: Callable[..., Any]) -> Callable[..., Any]:
    """The `function` for another thread: it computes in the precision of this one, and returns when
    its result is computed. Other settings of JAX's contexts do not hold there."""
    wide = bool(jax.config.read("jax_enable_x64"))

    def call(*args: Any) -> Any:
        with jax.enable_x64(wide):
            return jax.block_until_ready(function(*args))

    return call


def is_new(function: Callable[..., Any], *args: Any) -> bool:
    """Whether the `function` meets arrays of these shapes for the first time. Then one thread alone
    compiles its program."""
    key = function.__qualname__, *(np.shape(leaf) for leaf in jax.tree.leaves(args))
    new = key not in _ASKED
    _ASKED.add(key)
    return new


_ASKED: set[Any] = set()
"""Functions that `is_new` was asked for, each with shapes."""


class Expected(eqx.Module):
    """Statistics of a plot in its coarse form, expected over draws of plants and parameters.

    A draw is one of the plantings and a place of the parameters, u plus a root of a covariance
    (`spread`) times unit normal numbers. The first draws, as many as plantings, are those that each
    step of a search is a mean over: stands in expectation, so that the mean is smooth in u.
    """

    predict: PlotForward
    """Statistics of the coarse form."""
    along: PlotForward
    """Statistics of the coarse form, with slopes along the informative subspace alone."""
    space: PlotSpace
    """Free parameters and factors, of whose whitened coordinates u the statistics are functions."""
    stands: tuple[Scene, ...]
    """Plantings, in the coarse form."""
    seed: int = eqx.field(static=True)
    """Seed of the unit normal numbers of the draws."""
    number: int = eqx.field(static=True)
    """Draws in all; those beyond the plantings fill the same sites in another order."""

    def draw(self, number: int) -> tuple[Scene, Float[np.ndarray, " coordinate"]]:
        """The planting and the unit normal numbers of a draw."""
        stand = self.stands[number % len(self.stands)]
        if number >= len(self.stands):
            stand = stand.reordered(number)  # no number of a planting
        return stand, unit_draw(self.seed, number, self.space)

    def _places(
        self, u: Array, spread: Array | np.ndarray, number: int | None = None
    ) -> tuple[list[Scene], list[Array]]:
        """The planting and the place of each of the first `number` draws about `u`. Without a
        number those that each step of a search is a mean over, in expectation."""
        pairs = [self.draw(i) for i in range(len(self.stands) if number is None else number)]
        # Only the draws of a step must be smooth in u; the others show whole plants.
        stands = [stand.expected() if number is None else stand for stand, _ in pairs]
        return stands, [u + jnp.asarray(spread @ normal) for _, normal in pairs]

    def at(self, stand: Scene, u: Array) -> Float[Array, " statistic"]:
        """Statistics of one planting at whitened coordinates."""
        return predicted(self.predict, self.space, stand, jnp.asarray(u))

    def slope_at(self, stand: Scene, u: Array) -> Float[Array, "statistic coordinate"]:
        """Derivatives of the statistics of one planting by the whitened coordinates."""
        return predicted_slopes(self.along, self.space, stand, jnp.asarray(u))

    def plain(self, u: Array, stands: Sequence[Scene]) -> Float[np.ndarray, "stand statistic"]:
        """Statistics of each of the `stands` at `u` itself."""
        return np.stack(each(self.at, stands, [jnp.asarray(u)] * len(stands)))

    def members(self, u: Array, spread: Array | np.ndarray) -> Float[Array, " statistic"]:
        """Mean over the plantings in expectation, each at its own place about `u`.

        Differentiable."""
        return jnp.stack(each(self.at, *self._places(u, spread))).mean(axis=0)

    def slopes(
        self, u: Array, spread: Array | np.ndarray
    ) -> Float[Array, "member statistic coordinate"]:
        """Derivatives of the statistics by the whitened coordinates, of each planting about `u`.

        Their mean is the slope of the linear model that is best for all of `spread`, not only at
        `u` (statistical linearisation): which plants come next at `u` is chance, and over what is
        unknown beforehand statistics bend.
        """
        return jnp.stack(each(self.slope_at, *self._places(u, spread)))

    def residues(
        self,
        u: Array,
        spread: np.ndarray,
        slopes: Float[np.ndarray, "statistic coordinate"],
        number: int | None = None,
    ) -> Float[np.ndarray, "draw statistic"]:
        """Statistics of every draw about `u`, or of the first `number`, with whole plants, less
        what the mean `slopes` explain of its place.

        Their mean is the expectation, and their covariance chance and how statistics bend. A draw
        with a statistic that is not finite is left out, unless it is one of those that each step of
        a search is a mean over.
        """
        stands, places = self._places(u, spread, self.number if number is None else number)
        drawn = np.stack(each(self.at, stands, places))
        moves = np.stack(places) - np.asarray(u)
        # What a line explains of a draw is knowledge of its place, and no chance.
        rest = drawn - moves @ slopes.T if np.isfinite(slopes).all() else drawn
        finite, own = np.isfinite(rest).all(axis=1), len(self.stands)
        if finite.sum() >= own:
            rest = rest[finite | (np.arange(len(rest)) < own)]
        return rest

    def prior_draws(self, number: int) -> Float[np.ndarray, "draw statistic"]:
        """Statistics at `number` draws of the prior of the parameters, each with other plants; of
        factors that are one."""
        pairs = [self.draw(1000 + i) for i in range(number)]
        for _, normal in pairs:
            normal[len(self.space.plot.names) :] = 0.0
        stands, places = zip(*pairs, strict=True)
        drawn = np.stack(each(self.at, stands, [jnp.asarray(place) for place in places]))
        return drawn[np.isfinite(drawn).all(axis=1)]


@eqx.filter_jit
def predicted(
    predict: PlotForward, space: PlotSpace, stand: Scene, u: Float[Array, " coordinate"]
) -> Float[Array, " statistic"]:
    """Statistics of a `stand` at whitened coordinates `u`, compiled."""
    return predict(space.physical(u), stand).astype(u.dtype)


@eqx.filter_jit
def predicted_slopes(
    predict: PlotForward, space: PlotSpace, stand: Scene, u: Float[Array, " coordinate"]
) -> Float[Array, "statistic coordinate"]:
    """Derivatives of the statistics of a `stand` by whitened coordinates, compiled."""
    return predict.jacobian(space.physical, u, stand)[1]


def chance_covariance(
    draws: Float[np.ndarray, "draw statistic"],
    lack: Float[np.ndarray, "planting statistic"],
    stands: int,
    kinds: Sequence[str] | None = None,
) -> Float[np.ndarray, "statistic statistic"]:
    """Covariance of what statistics of one plot differ by from their estimated expectation.

    Chance counts twice: as that of the plot, and as the error of the expectation, which is a mean
    over few draws and over what full and coarse renders of few plantings differ by.

    **Arguments:**

    - `draws`: statistics of coarse renders; their mean is the expectation.
    - `lack`: full less coarse render of some plantings; its mean is added to the expectation.
    - `stands`: sets of sites that the draws fill. Draws on the same sites are alike, so a set of
      sites counts as one draw.
    - `kinds`: of each statistic what it is in its view (`scatter_of_views`); None: all of one view.
    """
    chance = scatter_covariance(draws) if kinds is None else scatter_of_views(draws, kinds)
    # The error of the expectation: of a mean over sets of sites, and of few renders of the lack.
    share = 1.0 / stands
    if len(lack) > 1:
        variance = np.diagonal(chance)
        some = variance > 0
        differ = lack.var(axis=0, ddof=1)[some] / variance[some]
        share += float(differ.mean()) / len(lack) if some.any() else 0.0
    return (1.0 + share) * chance


def mean_information(
    weights: Float[np.ndarray, "direction statistic"],
    slopes: Float[np.ndarray, "member statistic coordinate"],
) -> Float[np.ndarray, "coordinate coordinate"]:
    """Fisher information of the mean of the slopes of several draws.

    **Arguments:** `weights`, which make of misfits independent ones of unit size; `slopes` of each
    draw. Two in a row are antithetic, and their slopes correlated where they change with the
    parameters: only the means of such pairs are independent.
    """
    # Means of antithetic pairs, in which what is odd in the parameters cancels.
    pairs = len(slopes) // 2
    if pairs >= 2:
        slopes = slopes[: 2 * pairs].reshape(pairs, 2, *slopes.shape[1:]).mean(axis=1)
    if len(slopes) == 1:
        return np.asarray((weights @ slopes[0]).T @ (weights @ slopes[0]))
    return np.asarray(repeated_information(jnp.asarray(weights @ slopes), confidence=0.5))


@eqx.filter_jit
def plants_wanted(
    scene: Scene, parameters: PlotParameters, space: PlotSpace, places: Array
) -> Float[Array, "place species"]:
    """Plants of each species at several places of the whitened coordinates."""

    def at(u: Array) -> Array:
        return scene.counts(with_values(parameters, scene.taxa, space.named(u)))

    return jax.lax.map(at, places)


def with_error(data: Data, covariance: Float[np.ndarray, "statistic statistic"]) -> Data:
    """The data with an error of this covariance added; as they are where it is none or unknown."""
    sound = np.isfinite(covariance).all() and covariance.any()
    return data.with_covariance(covariance) if sound else data


def other_plantings(
    scene: Scene, numbers: Iterable[int], counts: Float[np.ndarray, " species"] | None = None
) -> list[Scene]:
    """Realisations of a scene by their `numbers`; where a seed finds no room for the plants that
    there are, all of them have the same sites, in other orders.

    **Arguments:** `scene`; `numbers`, `counts`, as of `Scene.realisation`.

    **Raises:** `InputError` where there is no room for more plants, of `counts`.
    """
    numbers = list(numbers)
    try:
        return [scene.realisation(number, counts) for number in numbers]
    except InputError:
        if counts is not None:
            raise
        return [scene.reordered(number) for number in numbers]
