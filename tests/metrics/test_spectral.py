"""Agreement of spectra: closed forms, NumPy, and the paper's table 5."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from fynjax._core.errors import InputError
from fynjax.metrics import (
    WATER_WINDOWS,
    misfit_decomposition,
    spectral_agreement,
    spectral_angle,
    spectral_mask,
)

GRID = np.linspace(377.2, 2500.9, 425)


def spectra(seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    real = 0.1 + 0.15 * np.exp(-(((GRID - 1000.0) / 500.0) ** 2)) + 0.005 * rng.normal(size=425)
    return real, 0.8 * real + 0.01 + 0.01 * rng.normal(size=425)


def test_measures_are_their_definitions() -> None:
    real, simulated = spectra()
    for keep in (np.ones(425, bool), spectral_mask(GRID), spectral_mask(GRID, "swir2")):
        x, y = real[keep], simulated[keep]
        got = spectral_agreement(
            np.where(keep, real, np.nan), np.where(keep, simulated, np.nan), keep
        )
        angle = np.degrees(np.arccos(x @ y / np.linalg.norm(x) / np.linalg.norm(y)))
        error = np.sqrt(np.mean((x - y) ** 2))
        assert float(got.spectral_angle) == pytest.approx(angle, rel=1e-9)
        assert float(got.rmse) == pytest.approx(error, rel=1e-12)
        assert float(got.nrmse) == pytest.approx(error / np.ptp(x), rel=1e-12)
        assert float(got.correlation) == pytest.approx(np.corrcoef(x, y)[0, 1], rel=1e-10)
        expected = y.mean() / x.mean() - 1
        assert float(got.relative_mean_difference) == pytest.approx(expected, rel=1e-9)


def test_what_each_measure_is_blind_to() -> None:
    real, _ = spectra()
    assert float(spectral_angle(real, 0.127 * real)) == pytest.approx(0.0, abs=1e-6)
    assert float(spectral_agreement(real, 3.0 * real - 0.2).correlation) == pytest.approx(1.0)
    assert float(spectral_angle(real, real - 0.05)) > 1.0
    assert float(spectral_angle(jnp.array([1.0, 0.0]), jnp.array([0.0, 2.0]))) == pytest.approx(90)
    assert float(spectral_angle(jnp.array([1.0, 2.0]), jnp.array([-1.0, -2.0]))) == 180.0


def test_the_papers_swir2_row_is_an_offset() -> None:
    """Table 5: angle 48.31 degrees, RMSE 0.0548, r 0.98 with means 0.063 and 0.008.

    A falling line of the printed range (0.034) and mean gives these numbers with a gain of 1.25
    and an offset of -0.0566, and an angle of zero with any pure factor.
    """
    grid = GRID[spectral_mask(GRID, "swir2")]
    shape = np.linspace(1.0, 0.0, grid.size) ** 1.5
    real = 0.034 * (shape - shape.mean()) + 0.063
    offset = spectral_agreement(jnp.asarray(real), jnp.asarray(1.25 * (real - 0.0566)))
    assert float(offset.spectral_angle) == pytest.approx(48.31, abs=4.0)
    assert float(offset.rmse) == pytest.approx(0.0548, abs=5e-4)
    assert float(offset.nrmse) == pytest.approx(1.6122, abs=0.02)
    factor = spectral_agreement(jnp.asarray(real), jnp.asarray(real * 0.008 / 0.063))
    assert float(factor.spectral_angle) == pytest.approx(0.0, abs=1e-6)
    assert float(factor.rmse) == pytest.approx(0.0548, abs=2e-3)


def test_slopes_and_their_edges() -> None:
    """Each measure's derivative at each wavelength, and where the two spectra are equal."""
    real, simulated = (jnp.asarray(s[::50]) for s in spectra())

    @jax.jit
    def measures(s: jax.Array, keep: jax.Array) -> jax.Array:
        return jnp.stack(jax.tree.leaves(spectral_agreement(real, s, keep)))

    keep = jnp.arange(real.size) != 2
    jacobian = jax.jit(jax.jacrev(measures))
    hole = simulated.at[2].set(jnp.nan)
    slope = jacobian(hole, keep)
    np.testing.assert_array_equal(slope[:, 2], 0.0)
    for k in range(real.size):
        step = 1e-6 * jnp.zeros(real.size).at[k].set(1.0)
        difference = (measures(hole + step, keep) - measures(hole - step, keep)) / 2e-6
        np.testing.assert_allclose(slope[:, k], difference, rtol=1e-6, atol=1e-7)
    assert np.all(np.isnan(measures(hole, jnp.ones(real.size, bool))))
    # Equal spectra: angle, RMSE and NRMSE are at their corner.
    np.testing.assert_allclose(measures(real, keep)[:3], 0.0, atol=1e-12)
    np.testing.assert_array_equal(jacobian(real, keep)[1:3], 0.0)
    assert bool(jnp.all(jnp.isfinite(jacobian(real, keep))))


def test_small_angles_in_single_precision() -> None:
    """The arc cosine of a float32 cosine cannot tell 0.01 degrees from 0."""
    real = jnp.asarray(spectra()[0], jnp.float32)
    turned = jnp.stack([jnp.cos(jnp.deg2rad(0.01)), jnp.sin(jnp.deg2rad(0.01))]).astype(jnp.float32)
    plane = jnp.array([1.0, 0.0], jnp.float32)
    assert float(spectral_angle(plane, turned)) == pytest.approx(0.01, rel=1e-3)
    assert spectral_angle(real, real).dtype == jnp.float32


def test_masks() -> None:
    keep = spectral_mask(GRID)
    assert not np.any(keep[(GRID < 400) | (GRID > 2450)])
    for low, high in WATER_WINDOWS:
        assert not np.any(keep[(low <= GRID) & (high >= GRID)])
    inside = (GRID >= 400) & (GRID <= 2450)
    outside = ((GRID < 1340) | (GRID > 1460)) & ((GRID < 1790) | (GRID > 2100))
    np.testing.assert_array_equal(keep, inside & outside)
    np.testing.assert_array_equal(spectral_mask([399.0, 400.0, 2450.0, 2451.0]), [0, 1, 1, 0])
    # Table 5's note: 70 bands in SWIR2.
    assert np.count_nonzero(spectral_mask(GRID, "swir2")) == 70
    assert np.count_nonzero(spectral_mask(GRID, (1300.0, 1500.0), ())) == 40


def test_bad_input() -> None:
    for arguments, message in (
        ((GRID / 1000.0,), "µm"),
        ((GRID, "tir"), "'tir'"),
        ((GRID, (0.4, 1.0)), "nm"),
        ((GRID, (1000.0, 400.0)), "lower, upper"),
        ((GRID, (1350.0, 1450.0)), "at least two"),
    ):
        with pytest.raises(InputError, match=message):
            spectral_mask(*arguments)  # type: ignore[arg-type]
    with pytest.raises(InputError, match="one grid"):
        spectral_angle(jnp.ones(4), jnp.ones(5))
    with pytest.raises(InputError, match="one grid"):
        spectral_agreement(jnp.ones(4), jnp.ones(4), np.ones(5, bool))


@pytest.mark.parametrize("n", [6, 7])  # the mean of seven values of 0.1 is not 0.1
@pytest.mark.parametrize("compare", [spectral_agreement, misfit_decomposition])
def test_what_is_undefined_has_no_slope_and_spoils_no_other(compare, n) -> None:
    """Zero, constant and equal spectra all at once, as one Jacobian is of all measures."""
    some = [np.zeros(n), np.full(n, 0.1), np.full(n, 0.5), np.linspace(0.1, 0.4, n)]
    real, simulated = (jnp.asarray(np.array(v)) for v in zip(*[(a, b) for a in some for b in some]))
    values = lambda a, b: jnp.stack(jax.tree.leaves(compare(a, b)))  # noqa: E731
    assert np.isfinite(np.asarray(jax.vmap(jax.jacobian(values, (0, 1)))(real, simulated))).all()
    found = jax.vmap(compare)(real, simulated)
    constant, zero = np.arange(16) < 12, np.arange(16) < 4
    either = zero | (np.arange(16) % 4 == 0)
    if compare is spectral_agreement:
        np.testing.assert_array_equal(np.isnan(found.nrmse), constant)
        np.testing.assert_array_equal(np.isnan(found.relative_mean_difference), zero)
        np.testing.assert_array_equal(np.isnan(found.spectral_angle), either)
        assert np.isfinite(found.rmse).all()
    else:
        for name in ("gain", "offset", "contrast", "shape", "mean_by_gain", "rmse_without_both"):
            np.testing.assert_array_equal(np.isnan(getattr(found, name)), constant)
        np.testing.assert_array_equal(np.isnan(found.rmse_without_gain), zero)
        assert np.isfinite(found.level + found.rmse_without_offset).all()
