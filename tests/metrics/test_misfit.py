"""The parts of a squared error: closed forms, NumPy's least squares, the paper's SWIR2 case."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from fynjax.metrics import misfit_decomposition, spectral_agreement, spectral_angle
from tests.helpers import assert_gradients


def spectra(seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    real = 0.15 + 0.1 * np.sin(np.linspace(0, 5, 60))
    return real, 0.7 * real + 0.03 + 0.01 * rng.normal(size=60)


@pytest.mark.parametrize("seed", range(4))
def test_parts_are_least_squares_and_sum_to_the_error(seed: int) -> None:
    real, simulated = spectra(seed)
    keep = np.random.default_rng(seed).random(60) > 0.2
    x, y = real[keep], simulated[keep]
    got = misfit_decomposition(
        np.where(keep, real, np.nan), np.where(keep, simulated, np.nan), keep
    )
    slope, intercept = np.polyfit(x, y, 1)
    error = np.mean((y - x) ** 2)
    line = intercept + slope * x
    assert float(got.mean_squared_error) == pytest.approx(error, rel=1e-12)
    assert float(got.gain) == pytest.approx(slope, rel=1e-9)
    assert float(got.offset) == pytest.approx(intercept, rel=1e-9)
    assert float(got.level) == pytest.approx((y.mean() - x.mean()) ** 2, rel=1e-10)
    # Of the line's error, what is left once its mean is right.
    assert float(got.contrast) == pytest.approx(np.var(line - x), rel=1e-9)
    assert float(got.shape) == pytest.approx(np.mean((y - line) ** 2), rel=1e-9)
    r = np.corrcoef(x, y)[0, 1]
    assert float(got.shape) == pytest.approx((1 - r**2) * np.var(y), rel=1e-9)
    assert float(got.level + got.contrast + got.shape) == pytest.approx(error, rel=1e-12)
    assert float(jnp.sum(got.shares)) == pytest.approx(1.0, rel=1e-12)
    assert float(got.offset + got.mean_by_gain) == pytest.approx(y.mean() - x.mean())
    for columns, target, left in (
        (np.ones((x.size, 1)), y - x, got.rmse_without_offset),
        (x[:, None], y, got.rmse_without_gain),
        (np.stack([x, np.ones(x.size)], 1), y, got.rmse_without_both),
    ):
        found = np.linalg.lstsq(columns, target, rcond=None)[0]
        rest = np.sqrt(np.mean((target - columns @ found) ** 2))
        assert float(left) == pytest.approx(rest, rel=1e-9)


def test_each_pure_error_has_its_own_name() -> None:
    real, _ = spectra()
    offset = misfit_decomposition(real, real - 0.05)
    np.testing.assert_allclose(offset.shares, [1, 0, 0], atol=1e-12)
    assert float(offset.rmse_without_offset) == pytest.approx(0, abs=1e-12)
    assert float(offset.rmse_without_gain) > 0.01
    assert float(offset.mean_by_gain) == pytest.approx(0, abs=1e-12)
    gain = misfit_decomposition(real, 0.6 * real)
    assert float(gain.shape) == pytest.approx(0, abs=1e-15)
    assert float(gain.rmse_without_gain) == pytest.approx(0, abs=1e-12)
    assert float(gain.rmse_without_offset) > 0.01
    assert float(gain.offset) == pytest.approx(0, abs=1e-12)
    centred = 0.15 + 1.4 * (real - 0.15) - 0.4 * (real - 0.15).mean()
    np.testing.assert_allclose(misfit_decomposition(real, centred).shares, [0, 1, 0], atol=1e-10)
    # A pattern that is orthogonal to the spectrum and to a constant.
    basis = np.linalg.qr(np.stack([np.ones(60), real, np.arange(60.0) ** 2], 1))[0]
    shape = misfit_decomposition(real, real + 0.05 * basis[:, 2])
    np.testing.assert_allclose(shape.shares, [0, 0, 1], atol=1e-12)


def test_angle_and_correlation_cannot_tell_what_the_parts_can() -> None:
    """The paper's SWIR2: the two numbers it prints, once by an offset, once by none."""
    shape = np.linspace(1.0, 0.0, 70) ** 1.5
    real = 0.034 * (shape - shape.mean()) + 0.063
    darker = misfit_decomposition(real, 1.25 * (real - 0.0566))
    assert float(darker.offset) == pytest.approx(-0.0566 * 1.25)
    assert float(darker.mean_by_gain) == pytest.approx(0.25 * 0.063, rel=1e-3)
    assert float(darker.rmse_without_offset) < 0.3 * float(darker.rmse_without_gain)
    absorbed = misfit_decomposition(real, real * 0.008 / 0.063)
    assert float(absorbed.rmse_without_gain) < 1e-12 < float(absorbed.rmse_without_offset)
    # Both have r = 1 and the same difference of means.
    for one in (1.25 * (real - 0.0566), real * 0.008 / 0.063):
        assert float(spectral_agreement(real, one).correlation) == pytest.approx(1.0)
        assert one.mean() == pytest.approx(0.008, abs=1e-3)
    assert float(spectral_angle(real, real * 0.127)) == pytest.approx(0.0, abs=1e-5)


def test_slopes_and_edges() -> None:
    real, simulated = (jnp.asarray(s[::10]) for s in spectra())
    assert_gradients(jax.jit(lambda s: misfit_decomposition(real, s)), simulated)
    assert_gradients(jax.jit(lambda r: misfit_decomposition(r, simulated)), real)
    same = misfit_decomposition(real, real)
    np.testing.assert_array_equal(same.shares, 0.0)
    slope = jax.jacrev(lambda s: misfit_decomposition(real, s).shares)(real)
    assert bool(jnp.all(jnp.isfinite(slope)))
    roots = jax.jacrev(lambda s: misfit_decomposition(real, s).rmse_without_offset)(real)
    np.testing.assert_allclose(roots, 0.0, atol=1e-12)
    assert np.isnan(misfit_decomposition(jnp.ones(5), jnp.arange(5.0)).gain)
    single = misfit_decomposition(real.astype(jnp.float32), simulated.astype(jnp.float32))
    assert single.gain.dtype == jnp.float32
