"""Twin experiment: a plot's noisy image gives its parameters back, as far as it shows them."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from fynjax.canopy import FORMS
from fynjax.inversion import (
    WELL_CONSTRAINED,
    CalibrationSettings,
    ImageView,
    compared_statistics,
    free_space,
    weigh_targets,
)
from fynjax.leaf import LeafParameters
from fynjax.metrics import image_statistics
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
    named_values,
    with_values,
)
from fynjax.sensors import shipped_sensor
from tests.problems import calibrate_plot

NAMES = compared_statistics()
TAXA = ("Erica", "Restio", "Euclea")
GROWN = ("rounded_shrub", "tussock", "broad_leaved")
FREE = (
    "species.*.cover",
    "species.*.diameter",
    "species.*.leaf.chlorophyll",
    "species.*.leaf_area_index",
    "ground.brightness",
    "ground.litter_fraction",
)


def truth() -> PlotParameters:
    def default(name):
        return jnp.array([getattr(FORMS[form], name) for form in GROWN])

    return PlotParameters(
        SpeciesParameters(
            cover=jnp.array([0.25, 0.15, 0.20]),
            diameter=jnp.array([0.4, 0.3, 0.5]),
            height=jnp.array([0.6, 0.5, 0.9]),
            packing=jnp.full(3, 0.2),
            fill=jnp.ones(3),
            leaf_area_index=default("leaf_area_index"),
            wood_area_index=default("wood_area_index"),
            shoot_clumping=default("shoot_clumping"),
            dead_fraction=default("dead_fraction"),
        ),
        LeafParameters.many(
            structure=1.8,
            chlorophyll=jnp.array([55.0, 35.0, 60.0]),
            carotenoids=11.0,
            anthocyanins=1.5,
            brown_pigments=0.05,
            water=0.02,
            dry_matter=0.02,
        ),
        GroundParameters(*(jnp.asarray(v) for v in (0.9, 0.4, 0.35, 0.0, 0.0, 1.0))),
        LightParameters(*(jnp.asarray(v) for v in (31.0, 17.0, 0.1))),
    )


@pytest.fixture(scope="module")
def twin():
    """Truth by name, and the calibration from a start (and prior) 30 % off, either way."""
    real = truth()
    species = [Species(taxon, form) for taxon, form in zip(TAXA, GROWN, strict=True)]
    rules = PlantingRules(structure="even")
    scene = build_scene(species, real, extent=(6.0, 6.0), voxel=0.1, seed=11, rules=rules)
    camera = aim(scene, real, shipped_sensor("mavic_3m"), Placement(50.0, 0.05))
    view = ImageView(NAMES, camera)
    image = np.asarray(eqx.filter_jit(view.observe)(scene, real)[0])
    draw = np.random.default_rng(4)
    noisy = image * (1 + 0.02 * draw.normal(size=image.shape)) + 0.001 * draw.normal(
        size=image.shape
    )
    values = {k: float(v) for k, v in named_values(real, TAXA).items()}
    freed = free_space(scene, real, FREE, lambda _: 0.3).names
    off = {n: values[n] * draw.choice([0.7, 1.3]) for n in freed}
    off |= {f"species.{t}.cover": 0.7 * values[f"species.{t}.cover"] for t in TAXA}
    start = with_values(real, TAXA, {n: jnp.asarray(v) for n, v in off.items()})
    space = free_space(scene, start, FREE, lambda _: 0.3)
    measured = np.asarray(image_statistics(jnp.asarray(noisy), NAMES, pixel=0.05))
    # 3 %: what another planting of so small a plot would change.
    data = weigh_targets(NAMES, measured, 0.03)
    settings = CalibrationSettings(stride=3, max_steps=14)
    found = calibrate_plot(scene, start, data, space, [view], settings)
    return values, found


@pytest.mark.study
def test_total_cover_comes_back(twin):
    values, found = twin
    names = [f"species.{t}.cover" for t in TAXA]
    total = sum(values[n] for n in names)
    place = [found.fit.names.index(n) for n in names]
    start = sum(float(v) for v in found.before.species.cover)
    assert start < total - 0.15

    def interval(mean, covariance):
        draws = np.random.default_rng(0).multivariate_normal(mean, covariance, 2000)
        sums = jax.vmap(found.fit.space.physical)(draws)[:, place].sum(axis=1)
        return np.percentile(np.log(sums), [2.5, 97.5])

    low, high = interval(found.fit.whitened, found.fit.covariance)
    # Dead tissue, leaf area and litter can stand for some of the cover: the prior still pulls. Its
    # width is a share of the cover, as the estimate's.
    assert low < np.log(total) < high
    free = len(found.fit.names)
    assert high - low < 0.8 * np.ptp(interval(np.zeros(free), np.eye(free)))
    assert abs(found.fit.estimate[jnp.array(place)].sum() - total) < 0.3 * (total - start)


FARTHEST = 2.0
"""Standard deviations, which cover noise and what another planting would change."""


@pytest.mark.study
def test_well_constrained_parameters_are_near_the_truth(twin):
    values, calibration = twin
    fit = calibration.fit
    off = {
        name: abs(float(fit.estimate[i]) - values[name]) / float(fit.sd[i])
        for i, name in enumerate(fit.names)
    }
    constrained = set(fit.well_constrained())
    weak = set(fit.names) - constrained
    assert {name: sds for name, sds in off.items() if name in constrained and sds > FARTHEST} == {}
    assert "ground.brightness" in constrained
    # Litter and leaf area of one species share what the image tells of them.
    assert fit.constrained[fit.names.index("ground.litter_fraction")] > 0.6
    assert len(weak) >= 3  # one image cannot tell everything, and the result says so
    assert all(fit.constrained[fit.names.index(name)] < WELL_CONSTRAINED for name in weak)
