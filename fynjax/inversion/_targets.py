"""What a calibration compares with measurements of each sensor, and with what errors."""

from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from fynjax._core.errors import InputError
from fynjax._core.precision import double_precision
from fynjax.inversion._data import Data
from fynjax.metrics import BANDS, VEGETATION_INDICES, index_bands
from fynjax.sensors import BandSet


def compared_statistics(bands: BandSet | Sequence[str] = BANDS) -> tuple[str, ...]:
    """Names of what is compared with a whole image: the distributions of its bands and of some
    indices, which between them hold that of the bands together, and how their spread falls from
    small to large squares, which is by the width of crowns and gaps.

    **Arguments:**

    - `bands`: of the image, of a sensor or by their names. Indices that they do not give are left
      out.
    """
    found = index_bands(bands)
    indices = (name for name in ("NDVI", "GNDVI", "GSAVI", "NormR") if name in found)
    return tuple(
        f"{layer}.{kind}"
        for layer in (*(bands.names if isinstance(bands, BandSet) else bands), *indices)
        for kind in (
            *("mean", "q05", "q25", "q50", "q75", "q95"),
            *("std", "std20cm", "std40cm", "std80cm", "std160cm"),
        )
    )


SPREAD_SD = 0.12
"""What spreads between pixels are off by, of the model, relative [-]: standard deviations of a path
tracer's image of the same plants differ by 5 to 20 % (`tests.benchmarks.table_radiation`). Noise
and leaves smaller than what is modelled change spreads and not means."""


@double_precision
def weigh_targets(
    names: Sequence[str],
    value: Float[np.ndarray, " statistic"],
    relative_sd: float,
    *,
    sd: Float[np.ndarray, " statistic"] | None = None,
) -> Data:
    """Targets with the errors that a calibration gives them.

    A stated `sd` is kept. Without one, or where it is NaN, a statistic gets the share `relative_sd`
    of its value, independent of others. Mean and quantiles of one band repeat one measurement, and
    so do its standard deviations, and indices that are functions of the same ratio of two bands: a
    group of n has this error widened by sqrt(n). So are those of three bands' shares, although they
    hold two ratios. Which these are follows from the formulas (`VegetationIndex.measures`).

    The model's error of spreads comes on top: standard deviations, and the distances of quantiles
    from the mean, are off by `SPREAD_SD`, half of the variance by a factor that all spreads of one
    band or index share. What bands are off by as a whole is no error of their statistics here: it
    is a parameter of a calibration (`ModelError`, `Gains`).

    **Arguments:**

    - `names`: such as "NDVI.mean".
    - `value`: what was measured.
    - `relative_sd`: standard deviation over the value where none is stated, positive [-].
    - `sd`: stated standard deviations, in the units of `value`, NaN for none.

    **Returns:** `Data`, with correlated errors where there are spreads.

    **Raises:** `InputError` if `relative_sd` is not positive or a value is not finite.
    """
    _check_share(relative_sd)
    keys = []
    for name in names:
        layer, kind = name.split(".")
        index = VEGETATION_INDICES.get(layer)
        group = layer if index is None else index.measures
        keys.append((group, kind.startswith("std")))
    error = np.full(len(names), np.nan) if sd is None else np.array(sd, float)
    stated = np.isfinite(error)
    for i, key in enumerate(keys):
        if not stated[i]:
            # Repeats of one measurement: n of them with sqrt(n) the error count as one.
            error[i] = max(relative_sd * abs(value[i]), 1e-4) * np.sqrt(keys.count(key))
    apart = SPREAD_SD * np.where(stated, 0.0, _spreads(names, np.asarray(value, float)))
    if not apart.any():
        return Data(tuple(names), jnp.asarray(value), jnp.asarray(error))
    layers = np.array([name.split(".")[0] for name in names])
    alike = 0.5 * (layers[:, None] == layers) + 0.5 * np.eye(len(names))
    data = Data(tuple(names), jnp.asarray(value), jnp.asarray(error))
    return data.with_covariance(alike * np.outer(apart, apart))


def _spreads(
    names: Sequence[str], value: Float[np.ndarray, " statistic"]
) -> Float[np.ndarray, " statistic"]:
    """What of each statistic is a spread: a standard deviation, or the distance of a quantile from
    the middle of its band, which is its mean, or the mean of what there is."""
    kinds = [name.split(".") for name in names]
    found = np.zeros(len(names))
    for i, (layer, kind) in enumerate(kinds):
        if kind.startswith("std"):
            found[i] = value[i]
        elif kind.startswith("q"):
            own = [j for j, (other, k) in enumerate(kinds) if other == layer and k[0] in "mq"]
            means = [j for j in own if kinds[j][1] == "mean"]
            found[i] = value[i] - value[means or own].mean()
    return found


GAIN, OFFSET = 0.03, 0.003
"""What all bands of a spectrum may be off by together: a factor, and a reflectance [-].
Assumptions, of the size of what is left of atmosphere and calibration in surface reflectance."""


@double_precision
def weigh_spectrum(
    names: Sequence[str],
    value: Float[np.ndarray, " statistic"],
    relative_sd: float,
    *,
    noise: Float[np.ndarray, " statistic"] | None = None,
    sampling: Float[np.ndarray, "statistic statistic"] | None = None,
    gain: float = 0.0,
    offset: float = OFFSET,
) -> Data:
    """A mean spectrum as targets, with errors that its bands share.

    The errors of noise and of the model are independent between bands; those of gain and offset
    are the same in all bands.

    **Arguments:**

    - `names`: of the bands' statistics, as `spectrum_names` gives them.
    - `value`: reflectance [-].
    - `relative_sd`: standard deviation of the model's error over the value, positive [-].
    - `noise`: standard deviation of each band's noise [-]; none by default.
    - `sampling`: covariance of the mean (of pixels: theirs over their number); none by default.
    - `gain`: standard deviation of a factor on all bands [-]; none by default, where it is that of
      the view (`spectrum_view`).
    - `offset`: standard deviation of a reflectance added to all bands [-].

    **Returns:** `Data` with correlated errors.

    **Raises:** `InputError` if `relative_sd` is not positive or a value is not finite.
    """
    _check_share(relative_sd)
    own = (relative_sd * value) ** 2 + (0.0 if noise is None else noise**2)
    covariance = np.diag(np.maximum(own, 1e-10))
    # A common factor moves every band by a share of its value, a common offset all alike.
    covariance += gain**2 * np.outer(value, value) + offset**2
    if sampling is not None:
        covariance = covariance + sampling
    if not np.isfinite(covariance).all():
        raise InputError("a spectrum's values and errors must be finite to be a target")
    whitener = np.linalg.inv(np.linalg.cholesky(covariance))
    sd = np.sqrt(np.diagonal(covariance))
    return Data(tuple(names), jnp.asarray(value), jnp.asarray(sd), jnp.asarray(whitener))


STRUCTURE_SD = 0.05
"""Relative error of the structure that the smooth metrics expect of a cloud: what they were found
to be off by at tens of pulses a square metre (`voxel_structure`)."""


@double_precision
def weigh_structure(
    names: Sequence[str],
    value: Float[np.ndarray, " statistic"],
    relative_sd: float,
    *,
    sd: Float[np.ndarray, " statistic"],
) -> Data:
    """Structure metrics of a cloud as targets.

    **Arguments:**

    - `names`: such as "lidar.rugosity".
    - `value`: what was measured, each in its own unit.
    - `relative_sd`: standard deviation of the model's error over the value, positive [-];
      `STRUCTURE_SD` if that is more.
    - `sd`: standard deviation of the sampling error, in the units of `value`; 0 where it is not
      known.

    **Returns:** `Data` with independent errors.

    **Raises:** `InputError` if `relative_sd` is not positive or a value is not finite.
    """
    _check_share(relative_sd)
    share = max(relative_sd, STRUCTURE_SD)
    error = np.maximum(np.hypot(sd, share * value), 1e-4)
    return Data(tuple(names), jnp.asarray(value), jnp.asarray(error))


def _check_share(relative_sd: float) -> None:
    if not relative_sd > 0:
        raise InputError(f"`relative_sd` must be positive, but is {relative_sd:g}")
