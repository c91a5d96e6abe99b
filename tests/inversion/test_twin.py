"""Small plots from end to end: calibrated to images of plots that were planted with other seeds."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.stats import chi2

from fynjax.inversion import CalibrationSettings, ImageView, free_space, weigh_targets
from fynjax.leaf import LeafParameters
from fynjax.scene import (
    GroundParameters,
    LightParameters,
    Placement,
    PlantingRules,
    PlotParameters,
    Species,
    SpeciesParameters,
    aim,
    build_scene,
    stand_area,
    with_values,
)
from fynjax.sensors import shipped_sensor
from tests.problems import calibrate_plot

pytestmark = pytest.mark.study

TAXA = ("Erica", "Restio")
FREE = ("species.*.cover", "species.*.leaf_area_index", "*.leaf.chlorophyll", "ground.brightness")
STATISTICS = ("green.mean", "red.mean", "red_edge.mean", "nir.mean", "NDVI.std", "nir.std")
ERROR = 0.005
"""Relative error of the image's statistics."""
TRUTHS = 3


def parameters() -> PlotParameters:
    return PlotParameters(
        SpeciesParameters(
            cover=jnp.array([0.3, 0.2]),
            diameter=jnp.array([0.4, 0.3]),
            height=jnp.array([0.6, 0.5]),
            packing=jnp.full(2, 0.2),
            fill=jnp.ones(2),
            leaf_area_index=jnp.array([3.0, 2.0]),
            wood_area_index=jnp.array([0.5, 0.05]),
            shoot_clumping=jnp.array([0.4, 0.2]),
            dead_fraction=jnp.array([0.2, 0.3]),
        ),
        LeafParameters.many(
            structure=jnp.array([1.8, 2.1]),
            chlorophyll=jnp.array([55.0, 40.0]),
            carotenoids=11.0,
            anthocyanins=1.5,
            brown_pigments=0.1,
            water=0.02,
            dry_matter=jnp.array([0.018, 0.03]),
        ),
        GroundParameters(*(jnp.asarray(v) for v in (0.9, 0.4, 0.35, 0.0, 0.0, 1.0))),
        LightParameters(*(jnp.asarray(v) for v in (31.0, 17.0, 0.1))),
    )


def planted(seed):
    """The plot of 2 m with the plants of a seed."""
    species = [Species(t, f) for t, f in zip(TAXA, ("rounded_shrub", "tussock"), strict=True)]
    return build_scene(
        species,
        parameters(),
        extent=(2.0, 2.0),
        voxel=0.1,
        seed=seed,
        rules=PlantingRules(structure="even"),
    )


@pytest.fixture(scope="module")
def twins():
    """Of each truth, a draw of the prior: its coordinates, the leaf area of its stand, and the
    calibration to the image of it, with error, by the plants of other seeds."""
    centre, scene = parameters(), planted(1)
    space = free_space(scene, centre, FREE, lambda _: 0.3)
    camera = aim(scene, centre, shipped_sensor("mavic_3m"), Placement(50.0, 0.1))
    view = ImageView(STATISTICS, camera)
    predict = eqx.filter_jit(view.predict)
    settings = CalibrationSettings(
        stand_realisations=4, scatter_draws=24, full_renders=1, max_steps=8
    )
    found = []
    for number in range(TRUTHS):
        random = np.random.default_rng(number)
        normal = random.normal(size=len(space.names))
        truth, stand = with_values(centre, TAXA, space.named(normal)), planted(100 + number)
        value = np.asarray(predict(stand, truth), float)
        data = weigh_targets(
            STATISTICS, value * (1.0 + ERROR * random.normal(size=value.size)), ERROR
        )
        calibration = calibrate_plot(scene, centre, data, space, [view], settings)
        found.append((normal, leaf_area(stand, truth), calibration))
    return found


def leaf_area(scene, at):
    """Live leaf area index of the stand [m2 m-2]."""
    return float(stand_area(scene, at).leaf.sum())


def test_truths_lie_in_their_intervals(twins):
    """Distances in units of the posterior, over all truths, are a chi-square: intervals are neither
    too narrow nor too wide. And the ground's brightness is known by the image, not the prior."""
    squares = []
    for normal, _, found in twins:
        assert found.fit.converged, found.fit.explanation
        off = normal - np.asarray(found.fit.whitened)
        squares.append(off @ np.linalg.solve(np.asarray(found.fit.covariance), off))
        assert found.fit.constrained[found.fit.names.index("ground.brightness")] > 0.8
        assert found.probability > 0.001
    low, high = chi2.ppf([0.001, 0.999], TRUTHS * len(normal))
    assert low < np.sum(squares) < high


def test_the_objective_falls(twins):
    """The statistics come near the measured ones, and half the objective is gone."""
    misfit = []
    for *_, found in twins:
        assert found.fit.loss[-1] < found.fit.loss[0]
        both = found.statistics_before, found.statistics_after
        misfit.append(
            [float(np.sum(np.square(found.data.whiten(s - found.data.value)))) for s in both]
        )
    before, after = np.sum(misfit, axis=0)
    assert after < 0.5 * before


def test_the_leaf_area_of_the_stand_lies_in_its_interval(twins):
    """Not of each species: those take each other's place. The image narrows it all the same."""
    random = np.random.default_rng(0)
    (_, _, any_of_them), *_ = twins
    free = len(any_of_them.fit.names)

    def interval(found, mean, covariance):
        draws = random.multivariate_normal(mean, covariance, 60)
        at = [with_values(found.before, TAXA, found.fit.space.named(draw)) for draw in draws]
        return np.percentile([leaf_area(found.scene, one) for one in at], [1.0, 99.0])

    before = interval(any_of_them, np.zeros(free), np.eye(free))  # all have one prior
    for _, truth, found in twins:
        low, high = interval(found, found.fit.whitened, found.fit.covariance)
        assert low < truth < high
        assert high - low < 0.8 * np.ptp(before)
