"""Factors that bands are off by: gains of cameras, and the error of the model."""

from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from fynjax._core.errors import InputError
from fynjax._core.precision import in_double
from fynjax.inversion._space import ParameterSpace
from fynjax.inversion._views import AbstractView, BandView
from fynjax.scene import ModelError
from fynjax.sensors import BandSet, Gains


class Known(NamedTuple):
    """What is known of the logarithms of some factors."""

    mean: Float[np.ndarray, " band"]
    covariance: Float[np.ndarray, "band band"]

    @property
    def factor(self) -> Float[np.ndarray, " band"]:
        """The factors [-]."""
        return np.exp(self.mean)

    @property
    def sd(self) -> Float[np.ndarray, " band"]:
        """Standard deviations of their logarithms [-]."""
        return np.sqrt(np.maximum(np.diagonal(self.covariance), 0.0))


class BandFactors(eqx.Module):
    """Logarithms of the factors of all bands of some views, and what is known of them beforehand.

    The factor of a band is the gain of its camera times the model's error at its wavelength. Gains
    of different sensors are independent; the model's error is the same for all of them, wherever
    they see the same wavelength. Data tell the product; how much of it is the gain, the two priors
    say (`gains`, `errors`).
    """

    of_gains: Float[Array | np.ndarray, "factor factor"] = eqx.field(converter=in_double)
    """Covariance of the logarithms of the gains."""
    of_model: Float[Array | np.ndarray, "factor factor"] = eqx.field(converter=in_double)
    """Covariance of the logarithms of the model's error."""
    root: Float[Array | np.ndarray, "factor coordinate"] = eqx.field(converter=in_double)
    """Makes of independent unit normal coordinates logarithms of factors: a root of the sum of both
    covariances. Factors that are certain, or the same, need no coordinate of their own."""

    @classmethod
    def of(cls, views: Sequence[AbstractView], error: ModelError | None) -> "BandFactors":
        """The factors of the bands of `views`, by their gains and the `error` of the model."""
        seen = [view for view in views if isinstance(view, BandView)]
        return cls.of_bands(
            [(view.bands, view.gains) for view in seen], error, [view.instrument for view in seen]
        )

    @classmethod
    def of_bands(
        cls,
        seen: Sequence[tuple[BandSet, Gains]],
        error: ModelError | None,
        instruments: Sequence[str] | None = None,
    ) -> "BandFactors":
        """The factors of the bands of sensors with their gains, and the `error` of the model.
        Views of one of the `instruments`, by its name, that were calibrated alike share gains but
        for their drift; those of "" share none."""
        names = [""] * len(seen) if instruments is None else [*instruments]
        # Gains by another way of calibration are others.
        names = [
            name and f"{name} {gains.way} {gains.shared} {gains.sd}"
            for name, (_, gains) in zip(names, seen, strict=True)
        ]
        blocks = [
            [
                _shared_gains(one, other, i == j, bool(name) and names.count(name) > 1)
                if i == j or (name and name == names[j])
                else np.zeros((len(one[0]), len(other[0])))
                for j, other in enumerate(seen)
            ]
            for i, (name, one) in enumerate(zip(names, seen, strict=True))
        ]
        of_gains = np.block(blocks) if blocks else np.zeros((0, 0))
        centres = np.concatenate([np.empty(0), *(bands.centre for bands, _ in seen)])
        of_model = np.zeros_like(of_gains)
        if error is not None and len(centres):
            of_model = error.covariance(centres)
        return cls(of_gains, of_model, _root(of_gains + of_model))

    @property
    def coordinates(self) -> int:
        """Number of the coordinates."""
        return int(self.root.shape[1])

    def logarithms(self, w: Float[Array, " coordinate"]) -> Float[Array, " factor"]:
        """Logarithms of the factors, from their coordinates. Differentiable."""
        return jnp.asarray(self.root) @ w

    def draw_errors(self, random: np.random.Generator) -> Float[np.ndarray, " factor"]:
        """Logarithms of what the model might be off by in all bands, drawn by `random`."""
        root = _root(np.asarray(self.of_model))
        return root @ random.normal(size=root.shape[1])

    def _share(self, own: np.ndarray, known: Known) -> Known:
        # Of a sum of two normals each is known from the sum: by its share of the covariance.
        total = np.asarray(self.of_gains) + np.asarray(self.of_model)
        share = own @ np.linalg.pinv(total, rcond=1e-12, hermitian=True)
        left = own - share @ own
        return Known(share @ known.mean, left + share @ known.covariance @ share.T)

    def known(
        self,
        w: Float[np.ndarray, " coordinate"],
        covariance: Float[np.ndarray, "coordinate coordinate"],
    ) -> Known:
        """All factors, of which coordinates have the mean `w` and this `covariance`."""
        root = np.asarray(self.root)
        return Known(root @ w, root @ covariance @ root.T)

    def gains(self, known: Known) -> Known:
        """The gains in the factors that are `known`."""
        return self._share(np.asarray(self.of_gains), known)

    def errors(self, known: Known) -> Known:
        """The model's error in the factors that are `known`."""
        return self._share(np.asarray(self.of_model), known)


class PlotSpace(eqx.Module):
    """What a calibration of a plot looks for: its free parameters, then the factors of the bands,
    in whitened coordinates, in which the prior is a unit normal."""

    plot: ParameterSpace
    """The free parameters."""
    factors: BandFactors
    """The factors of the bands."""

    @property
    def size(self) -> int:
        """Number of the coordinates."""
        return len(self.plot.names) + self.factors.coordinates

    def physical(self, u: Float[Array, " coordinate"]) -> Float[Array, " value"]:
        """Values of the parameters in their own units, then logarithms of the factors."""
        free = len(self.plot.names)
        return jnp.concatenate([self.plot.physical(u[:free]), self.factors.logarithms(u[free:])])

    def named(self, u: Float[Array, " coordinate"]) -> dict[str, Float[Array, ""]]:
        """Values of the free parameters by name."""
        return self.plot.named(u[: len(self.plot.names)])

    def whole(self, u: Float[Array, " some"]) -> Float[Array, " coordinate"]:
        """Coordinates of which those of the factors may be left out: then the factors are one."""
        u = jnp.asarray(u, float)
        missing = self.size - u.size
        if missing not in (0, self.factors.coordinates):
            raise InputError(
                f"expected {len(self.plot.names)} whitened coordinates, one for each free "
                f"parameter, but got {u.size}"
            )
        return jnp.concatenate([u, jnp.zeros(missing)])


def _shared_gains(
    one: tuple[BandSet, Gains], other: tuple[BandSet, Gains], same: bool, several: bool
) -> Float[np.ndarray, "_band _other"]:
    """Covariance of the logarithms of the gains of two views of one camera, or of one with itself
    (`same`), which drifts where there are `several`."""
    (bands, gains), (others, their) = one, other
    if same:
        own = gains.covariance(len(bands))
        return own + gains.drift**2 if several and own.any() else own
    sd = np.outer(gains.of_bands(len(bands)), their.of_bands(len(others)))
    alike = np.equal.outer(np.array(bands.names), np.array(others.names))
    return sd * (gains.shared + (1.0 - gains.shared) * alike)


def _root(covariance: Float[np.ndarray, "factor factor"]) -> Float[np.ndarray, "factor coordinate"]:
    """A root of a covariance that need not have full rank, with as many columns as its rank."""
    values, vectors = np.linalg.eigh(covariance)
    kept = values > 1e-10 * max(values[-1], 0.0) if len(values) else np.zeros(0, bool)
    return np.asarray(vectors[:, kept] * np.sqrt(values[kept]))
