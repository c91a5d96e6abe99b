"""The spectral bands of a sensor."""

from collections.abc import Mapping, Sequence
from typing import Any, Literal

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from numpy.typing import ArrayLike

from fynjax._core.errors import InputError
from fynjax._core.programs import check_known
from fynjax._core.spectral import (
    Curve,
    box_matrix,
    check_wavelength,
    gaussian_matrix,
    tabulated_matrix,
)


def floats(values: Any) -> tuple[float, ...]:
    """A number, or several, as static numbers of a field. Raises `InputError` for traced ones."""
    check_known(wavelength=values)
    return tuple(float(v) for v in np.atleast_1d(np.asarray(values, dtype=np.float64)))


def _curves(curves: Any) -> tuple[tuple[tuple[float, ...], tuple[float, ...]], ...] | None:
    return None if curves is None else tuple((floats(u), floats(r)) for u, r in curves)


class BandSet(eqx.Module):
    """Names and spectral responses of a sensor's bands.

    All of it is static (plain numbers, hashable): a band set adds no leaves to a pytree, and
    `average` may be called inside `jax.jit`. Raises `InputError` when the fields do not match.

    >>> import jax.numpy as jnp
    >>> import numpy as np
    >>> from fynjax.sensors import BandSet
    >>> bands = BandSet(("red", "nir"), centre=(650.0, 860.0), fwhm=(32.0, 52.0))
    >>> wavelength = np.arange(500.0, 1001.0, 5.0)
    >>> bands.average(wavelength, jnp.asarray(wavelength / 1000.0)).round(3)
    Array([0.65, 0.86], dtype=float32)
    """

    names: tuple[str, ...] = eqx.field(static=True, converter=tuple)
    """Name of each band, in the order of the image's band axis."""
    centre: tuple[float, ...] = eqx.field(static=True, converter=floats)
    """Centre wavelength [nm]."""
    fwhm: tuple[float, ...] = eqx.field(static=True, converter=floats)
    """Full width at half maximum [nm]; twice the half width that some makers state."""
    response: Literal["gaussian", "box"] = eqx.field(static=True, default="gaussian")
    """Form of the response where no curves are given."""
    curves: tuple[tuple[tuple[float, ...], tuple[float, ...]], ...] | None = eqx.field(
        static=True, default=None, converter=_curves
    )
    """Tabulated response of each band, as (wavelengths [nm], relative response [-])."""

    def __check_init__(self) -> None:
        count = len(self.names)
        if count == 0 or len(set(self.names)) != count:
            raise InputError(f"band names must be given and differ, but are {self.names}.")
        for what in ("centre", "fwhm", "curves"):
            values: Sequence[object] | None = getattr(self, what)
            if values is not None and len(values) != count:
                raise InputError(f"{count} bands are named, but `{what}` has {len(values)} values.")
        if self.response not in ("gaussian", "box"):
            raise InputError(f"`response` must be 'gaussian' or 'box', but is {self.response!r}.")
        check_wavelength(np.unique(self.centre), "band centres")
        if min(self.fwhm) <= 0.0:
            raise InputError(f"`fwhm` must be positive, in nm, but is {self.fwhm}.")

    def __len__(self) -> int:
        return len(self.names)

    def select(self, places: Sequence[int]) -> "BandSet":
        """The bands at `places`, in that order."""

        def taken(values: Sequence[Any]) -> tuple[Any, ...]:
            return tuple(values[i] for i in places)

        return BandSet(
            taken(self.names),
            taken(self.centre),
            taken(self.fwhm),
            self.response,
            None if self.curves is None else taken(self.curves),
        )

    def covered(self, wavelength: ArrayLike, *, max_loss: float = 1e-3) -> tuple[int, ...]:
        """Places of the bands of which no more than `max_loss` lies outside `wavelength` [nm]."""

        def fits(place: int) -> bool:
            try:
                self.select([place]).weights(wavelength, max_loss=max_loss)
            except InputError:
                return False
            return True

        check_wavelength(wavelength)
        return tuple(place for place in range(len(self)) if fits(place))

    def weights(
        self, wavelength: ArrayLike, *, max_loss: float = 1e-3
    ) -> Float[np.ndarray, "band wavelength"]:
        """Weights of a spectrum on `wavelength` [nm] in each band [-]; rows sum to one.

        Raises `InputError` if more than the fraction `max_loss` of a response lies outside
        `wavelength`, or if that is no increasing grid in nm.
        """
        if self.curves is not None:
            return tabulated_matrix(wavelength, self.curves, names=self.names, max_loss=max_loss)
        matrix = gaussian_matrix if self.response == "gaussian" else box_matrix
        return matrix(wavelength, self.centre, self.fwhm, names=self.names, max_loss=max_loss)

    def average(
        self,
        wavelength: ArrayLike,
        spectrum: Float[Array | np.ndarray, "*batch wavelength"],
        *,
        max_loss: float = 1e-3,
    ) -> Float[Array, "*batch band"]:
        """Average spectra over the bands, in the spectra's unit.

        **Arguments:** `wavelength` grid [nm], increasing and concrete (not traced); `spectrum`
        with the wavelengths on its last axis. Linear, hence differentiable to any order, in
        `spectrum`. Raises `InputError` as `weights`, and if the lengths differ.
        """
        spectrum = jnp.asarray(spectrum)
        weights = self.weights(wavelength, max_loss=max_loss)
        if spectrum.shape[-1:] != weights.shape[1:]:
            raise InputError(
                f"the spectrum's last axis must have {weights.shape[1]} wavelengths, but its shape "
                f"is {spectrum.shape}."
            )
        dtype = jnp.result_type(spectrum.dtype, jnp.float32)
        matrix = jnp.asarray(weights.T, dtype=dtype)
        return jnp.matmul(spectrum.astype(dtype), matrix, precision="highest")


def band_set_of_curves(curves: Mapping[str, Curve]) -> BandSet:
    """Bands with tabulated responses, by name.

    **Arguments:**

    - `curves`: for each name the wavelengths [nm], increasing, and the relative response [-], not
      negative, linear between them and zero outside.

    **Returns:** a `BandSet`. The centre is the mean wavelength of the response, the width the
    distance of the outermost points at half its maximum.

    **Raises:** `InputError` for a curve that is no response on a grid in nm.
    """
    centres, widths = [], []
    for name, (wavelength, response) in curves.items():
        u, r = np.asarray(wavelength, dtype=np.float64), np.asarray(response, dtype=np.float64)
        # A spectrum that is the wavelength itself is linear, so its band average is exact.
        row = tabulated_matrix(u, [(u, r)], names=[name])[0]
        centres.append(float(row @ u))
        widths.append(_width_at_half_maximum(u, r))
    tables = _curves(curves.values())
    return BandSet(tuple(curves), tuple(centres), tuple(widths), curves=tables)


def _width_at_half_maximum(u: np.ndarray, r: np.ndarray) -> float:
    # From the first to the last point at half the maximum, linear between points.
    half = 0.5 * r.max()
    inside = np.flatnonzero(r >= half)
    first, last = int(inside[0]), int(inside[-1])
    low, high = u[first], u[last]
    if first > 0:
        low = np.interp(half, r[first - 1 : first + 1], u[first - 1 : first + 1])
    if last + 1 < u.size:
        high = np.interp(half, r[last : last + 2][::-1], u[last : last + 2][::-1])
    return float(high - low)
