"""What the ground is made of: soil and its covers (litter, char, rock), mixed or in patches.

Where each cover lies is drawn or read once; how much there is of it is a parameter. Both meet in
relative densities per voxel column, scaled until every cover has the share it should have.
"""

import dataclasses
from typing import Any, Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy.ndimage import gaussian_filter

from fynjax._core.seeds import generator
from fynjax.canopy import VoxelGrid
from fynjax.scene._spectra import Spectrum, background_spectrum

COVERS = ("litter", "char", "rock")
"""What may lie on the soil."""

CONTRAST = 3.0
"""Standard deviation of the logarithm of a cover's density in `random_patches` [-]: the
largest share of a voxel column is then about three quarters on average. An assumption."""

_ROUNDS = 60

_SHIPPED = {"litter": "litter", "char": "char", "rock": "dry_soil"}


class Ground(eqx.Module):
    """Spectra of soil and of what lies on it, and where each lies. How much there is of each, and
    how wet and bright the soil is, are parameters."""

    soil: Spectrum | None = None
    """None: the shipped dry and wet soil, mixed by the parameter `moisture`."""
    litter: Spectrum | None = None
    """None: the shipped one."""
    char: Spectrum | None = None
    """None: the shipped one."""
    rock: Spectrum | None = None
    """None: as the shipped dry soil, an assumption for the pale sandstone that sandy soil comes
    from: no spectrum of rock is shipped."""
    patches: Float[np.ndarray, "kind y x"] | None = None
    """Relative density of soil, litter, char and rock in the voxel columns; None: mixed alike."""
    patch: float = eqx.field(static=True, default=0.0)
    """Width of patches that a scene draws by its seed [m]; 0: none but `patches`."""
    shape: tuple[float, float, float] | None = eqx.field(static=True, default=None)
    """k, theta and rho_c of `fynjax.radiation.RahmanPintyVerstraete`, alike in all bands, of level
    ground whose spectra are measured from above, lit from 45 degrees; None: it reflects alike in
    all directions."""

    def laid(self, grid: VoxelGrid, boundary: Literal["periodic", "open"], seed: int) -> "Ground":
        """The same ground with the patches that a seed draws, if any are to be drawn."""
        if self.patch == 0.0:
            return self
        shape, scale = grid.shape[1::-1], self.patch / grid.horizontal_size
        patches = random_patches(shape, scale, periodic=boundary == "periodic", seed=seed)
        return dataclasses.replace(self, patches=patches)

    def cover_spectra(self, wavelength: Float[np.ndarray, " wavelength"]) -> Any:
        """Reflectance of litter, char and rock [cover, wavelength] at whole `wavelength` [nm] [-].

        Raises `InputError` where one that was given does not cover them.
        """
        spectra = []
        for cover in COVERS:
            given = getattr(self, cover)
            if given is None:
                spectra.append(background_spectrum(_SHIPPED[cover], wavelength))
            else:
                given.check(wavelength[0], wavelength[-1])
                spectra.append(given.at(wavelength))
        return jnp.stack(spectra)


def random_patches(
    shape: tuple[int, int], scale: float, *, periodic: bool, seed: int
) -> Float[np.ndarray, "kind y x"]:
    """Relative density of soil and of each cover, in patches with soft edges [-].

    The logarithm is a Gaussian random field, independent for each kind: white noise smoothed by a
    Gaussian.

    **Arguments:**

    - `shape`: rows and columns of voxels.
    - `scale`: width of a patch [voxel columns], above 0: twice the Gaussian's standard deviation.
    - `periodic`: whether the field repeats itself beyond its sides; it is mirrored otherwise.
    - `seed`: the same seed gives the same field.

    **Returns:** soil, then `COVERS`, each above 0. Not differentiable.
    """
    noise = generator(seed, 307).standard_normal((len(COVERS) + 1, *shape))
    mode = "wrap" if periodic else "reflect"
    smooth = gaussian_filter(noise, (0.0, 0.5 * scale, 0.5 * scale), mode=mode)
    # Smoothing takes variance: back to unit spread, whatever the width of a patch.
    spread = smooth.std(axis=(1, 2), keepdims=True)
    smooth = (smooth - smooth.mean(axis=(1, 2), keepdims=True)) / np.where(spread > 0, spread, 1.0)
    return np.exp(CONTRAST * smooth)


def kind_shares(fractions: Float[Array, " cover"]) -> Float[Array, " kind"]:
    """Share of soil and of each cover in the whole ground [-], as `ground_shares` takes them."""
    # More than the whole ground is shared out alike.
    fractions = fractions / jnp.maximum(jnp.sum(fractions), 1.0)
    return jnp.concatenate([1.0 - jnp.sum(fractions, keepdims=True), fractions])


def ground_shares(
    fractions: Float[Array, " cover"], density: Float[Array, "kind y x"]
) -> Float[Array, "kind y x"]:
    """Share of soil and of each cover in every voxel column [-]; they sum to one.

    **Arguments:**

    - `fractions`: share of the whole ground under each of `COVERS` [-], 0 to 1. Where they sum to
      more than one, each is scaled down alike.
    - `density`: relative density of soil and covers, as from `random_patches`, above 0 for some
      kind in every column. A map of shares is such a density: with its own means as fractions it
      comes back as it is.

    The share of a kind is its density times a factor, over the sum of all kinds. The factors are
    those that give each kind its fraction of the ground (iterative proportional fitting, Deming
    and Stephan 1940). Differentiable in both arguments, at fractions of zero too.
    """
    wanted = kind_shares(fractions)
    flat = density.reshape(len(wanted), -1)

    def share_of(factor: Array) -> Array:
        """Share per unit of factor."""
        total = jnp.tensordot(factor, flat, axes=1)
        return flat / jnp.where(total > 0, total, 1.0)

    def fit(factor: Array, _: None) -> tuple[Array, None]:
        each = share_of(factor).mean(axis=1)
        return wanted / jnp.where(each > 0, each, 1.0), None

    # A fixed number of rounds, so that it can be differentiated; each is computed again there.
    factor, _ = jax.lax.scan(jax.checkpoint(fit), wanted, None, length=_ROUNDS)
    return (factor[:, None] * share_of(factor)).reshape(density.shape)
