"""From a plot's parameters to the final metrics: derivatives against central differences."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from fynjax.metrics import image_statistics
from fynjax.scene import PARAMETERS, Placement, aim, named_values, parameter_kind, with_values
from fynjax.scene._lidar import observe_lidar
from fynjax.sensors import shipped_lidar, shipped_sensor
from tests.scene.plots import TAXA, drone, small_parameters, small_plot

STATISTICS = (
    "green.mean",
    "red.mean",
    "red_edge.mean",
    "nir.mean",
    "NDVI.mean",
    "NDVI.std",
    "GNDVI.mean",
    "SR.mean",
    "GCI.std",
    "ARI2.mean",
    "OSAVI.std",
    "NormR.mean",
    "nir.q50",
)
WEIGHTS = np.random.default_rng(5).normal(size=len(STATISTICS))


@pytest.fixture(scope="module")
def metric():
    # Where plants fade, the value moves with the number of plants as its derivative says.
    scene, parameters = small_plot().expected(), small_parameters()
    camera = drone(scene)
    names = tuple(named_values(parameters, TAXA))
    start = jnp.stack(list(named_values(parameters, TAXA).values()))

    def scalar(values, scene):
        plot = with_values(parameters, TAXA, dict(zip(names, values)))
        image = camera.observe(scene, plot).reflectance
        # Differences over small steps are those of a percentile without a window.
        statistics = image_statistics(image, STATISTICS, window=0.0)
        return jnp.asarray(WEIGHTS) @ statistics

    compiled = eqx.filter_jit(scalar)
    slope = eqx.filter_jit(eqx.filter_grad(scalar))
    value = lambda values: float(compiled(values, scene))  # noqa: E731
    return value, lambda values: np.asarray(slope(values, scene)), names, start


def test_every_derivative_is_finite(metric):
    _, slope, names, start = metric
    assert dict(zip(names, np.isfinite(slope(start)))) == dict.fromkeys(names, True)


def test_zero_cover_gives_finite_derivatives(metric):
    """Bare ground, and the slope towards the first plants."""
    _, slope, names, start = metric
    covers = [i for i, name in enumerate(names) if name.endswith(".cover")]
    gradient = slope(start.at[np.array(covers)].set(0.0))
    assert dict(zip(names, np.isfinite(gradient))) == dict.fromkeys(names, True)
    assert np.all(gradient[covers] != 0)


def draws(names, start, count, seed=0):
    """Values of parameters: near the start, anywhere in the bounds, or at one of them."""
    chance = np.random.default_rng(seed)
    kinds = [PARAMETERS[parameter_kind(name)] for name in names]
    low, high = (np.array([getattr(kind, end) for kind in kinds]) for end in ("lower", "upper"))
    for number in range(count):
        share = chance.uniform(size=len(names))
        if number % 2:
            share = np.where(chance.uniform(size=len(names)) < 0.3, share.round(), share)
        within = low + share * (high - low)
        moved = chance.uniform(size=len(names)) < chance.uniform()
        yield jnp.asarray(np.where(moved, within, np.clip(start, low, high)))


def test_values_and_slopes_are_finite_wherever_the_parameters_are_in_their_bounds(metric):
    value, slope, names, start = metric
    for number, at in enumerate(draws(names, start, 12)):
        assert np.isfinite(value(at)), number
        assert dict(zip(names, np.isfinite(slope(at)))) == dict.fromkeys(names, True), number


@pytest.mark.study
@pytest.mark.parametrize("sensor", ["mavic_3m", "aviris_ng", "flash_lidar_paper"])
def test_a_thousand_measurements_and_their_slopes_are_finite(sensor):
    scene, parameters = small_plot(dtype="float32").expected(), small_parameters()
    named = named_values(parameters, TAXA)
    names, start = tuple(named), np.array(list(named.values()))
    camera = None
    if sensor == "mavic_3m":
        camera = drone(scene)
    elif sensor == "aviris_ng":
        spectrometer = shipped_sensor(sensor)
        covered = spectrometer.bands.covered(np.arange(400.0, 2501.0))  # spectra of leaves
        camera = aim(scene, parameters, spectrometer.select(covered), Placement(3000.0, 1.6))
    lidar = None if camera else shipped_lidar(sensor)

    @eqx.filter_jit
    @eqx.filter_value_and_grad
    def measured(values, scene):
        plot = with_values(parameters, TAXA, dict(zip(names, values)))
        if camera is None:
            return observe_lidar(scene, plot, lidar).waveforms.total.sum()
        return (camera.observe(scene, plot).reflectance ** 2).sum()

    wrong = {}
    for number, at in enumerate(draws(names, start, 1000, seed=1)):
        value, slope = measured(at.astype(jnp.float32), scene)
        if not (np.isfinite(value) and np.isfinite(slope).all()):
            lost = [n for n, finite in zip(names, np.isfinite(slope)) if not finite]
            wrong[number] = (float(value), lost, dict(zip(names, at.tolist())))
    assert not wrong


def test_gradient_of_final_metrics_against_central_differences(metric):
    """Cover, diameter, height, packing, fill, leaf areas, chemistry, ground, sun and sky.

    A kind at a time, its species with weights of their own. The best of a few steps is
    taken: a wide one rides over kinks of the
    cloud-in-cell weights, a narrow one over curvature.
    """
    value, slope_of, names, start = metric
    gradient = slope_of(start)
    scale = np.abs(gradient * np.asarray(start)).max()
    for i, name in enumerate(names):
        if name.startswith(("species.Deadwood.leaf", "species.Deadwood.dead_fraction")):
            assert gradient[i] == 0.0  # it has no leaves
    size = np.maximum(np.abs(np.asarray(start)), 1e-2)
    weights = np.random.default_rng(7).uniform(0.4, 1.0, len(names)) * (-1.0) ** np.arange(
        len(names)
    )
    kinds = [n.split(".", 2)[-1] if n.startswith("species") else n for n in names]
    wrong = {}
    for kind in dict.fromkeys(kinds):
        along = weights * size * np.array([k == kind for k in kinds])
        expected, errors = gradient @ along, []
        for step in (3e-6, 1e-5, 1e-4):
            ends = [value(start + sign * step * along) for sign in (1, -1)]
            slope = (ends[0] - ends[1]) / (2 * step)
            errors.append(abs(expected - slope) / (abs(slope) + 1e-7 * scale))
            if errors[-1] < 1e-4:
                break
        if min(errors) > 1e-4:
            wrong[kind] = min(errors)
    assert wrong == {}


@pytest.mark.study
def test_forward_and_reverse_mode_agree():
    scene, parameters = small_plot(), small_parameters()
    camera = drone(scene)

    def ndvi(cover, scene):
        plot = eqx.tree_at(lambda p: p.species.cover, parameters, cover)
        return image_statistics(camera.observe(scene, plot).reflectance, ("NDVI.mean",))[0]

    cover = parameters.species.cover
    tangent = jnp.array([1.0, -0.5, 0.3])
    along = eqx.filter_jit(lambda c, m: jax.jvp(lambda x: ndvi(x, m), (c,), (tangent,))[1])
    reverse = eqx.filter_jit(jax.grad(ndvi))(cover, scene)
    assert float(along(cover, scene)) == pytest.approx(float(reverse @ tangent), rel=1e-8)


@pytest.mark.study
def test_no_plants_at_all_give_finite_derivatives():
    """Zero cover of every species: bare ground, and the slope towards the first plants."""
    scene, parameters = small_plot(), small_parameters()
    camera = drone(scene)
    bare = eqx.tree_at(lambda p: p.species.cover, parameters, jnp.zeros(3))

    @eqx.filter_grad
    def slope(plot, scene):
        return image_statistics(camera.observe(scene, plot).reflectance, ("nir.mean",))[0]

    gradient = eqx.filter_jit(slope)(bare, scene)
    for leaf in jax.tree.leaves(gradient):
        assert np.all(np.isfinite(np.asarray(leaf)))
    assert np.abs(np.asarray(gradient.species.cover)).max() > 0
