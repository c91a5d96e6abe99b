"""The published numbers of the AVIRIS-NG spectrum of the 2006 plot, as targets."""

import dataclasses
from collections.abc import Callable
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from fynjax.app.compare import table5_2006
from fynjax.inversion import (
    GAIN,
    OFFSET,
    BandView,
    Data,
    FactorAt,
    Source,
    SpectrumView,
    spectrum_view,
    weigh_spectrum,
)
from fynjax.metrics import SPECTRAL_REGIONS
from fynjax.radiation import Accuracy
from fynjax.scene import PlotParameters, Scene
from fynjax.sensors import BandSet, Gains
from fynjax.studies.fynbos_2006._article import SWIR2_MEAN

_CENTRES = (420.0, 680.0, 890.0, 1000.0, 1090.0, 1290.0, 1470.0, 1650.0)
_CENTRES_SWIR2 = (2130.0, 2210.0, 2300.0, 2430.0)
"""Where spectra of shrubland have their least and largest reflectance in each region [nm]: of
spectra as `check_vegetation` knows them the ranges over these bands are 0.95 to 1 of those over
all."""
_WIDTH = 10.0  # nm
_RELATIVE_SD = 0.05
"""Error of each range for itself, as a share of it [-]: that it is over few bands, that the pixels
of AVIRIS-NG are wider than the plot, and the model's."""
_REGIONS = tuple(SPECTRAL_REGIONS)
NAMES = (*(f"spectrum.{region}_range" for region in _REGIONS), "spectrum.swir2_mean")


class RegionsView(BandView):
    """Range of a mean spectrum in each of `SPECTRAL_REGIONS`, and its mean at 2100 to 2450 nm."""

    names: tuple[str, ...] = eqx.field(static=True)
    spectrum: SpectrumView
    """In the bands that a region's range is taken over."""
    view: str = eqx.field(static=True, default="")
    """Name of the view, where there are several."""

    @property
    def bands(self) -> BandSet:
        return self.spectrum.bands

    @property
    def gains(self) -> Gains:
        return self.spectrum.gains

    def observe(
        self, scene: Scene, parameters: PlotParameters
    ) -> tuple[Float[Array, "band 1 1"], Float[Array, " statistic"]]:
        image, spectrum = self.spectrum.observe(scene, parameters)
        return image, self._numbers(spectrum)

    def statistics(
        self, image: Float[Array, "band y x"], log_factor: Float[Array, " band"] | None = None
    ) -> Float[Array, " statistic"]:
        return self._numbers(self.spectrum.statistics(image, log_factor))

    def for_search(self, scene: Scene, accuracy: Accuracy, stride: int | None) -> "RegionsView":
        spectrum = self.spectrum.for_search(scene, accuracy, stride)
        return dataclasses.replace(self, spectrum=spectrum)

    def jacobian(
        self,
        scene: Scene,
        plot_at: Callable[[Array], PlotParameters],
        u: Float[Array, " free"],
        factor_at: FactorAt | None = None,
    ) -> tuple[Float[Array, " statistic"], Float[Array, "statistic free"]]:
        value, rows = self.spectrum.jacobian(scene, plot_at, u, factor_at)
        return self._numbers(value), jax.jacrev(self._numbers)(value) @ rows

    def _numbers(self, reflectance: Float[Array, " band"]) -> Float[Array, " statistic"]:
        centre = np.asarray(self.spectrum.imager.sensor.bands.centre)
        parts = {
            region: reflectance[(centre >= low) & (centre <= high)]
            for region, (low, high) in SPECTRAL_REGIONS.items()
        }
        ranges = [jnp.max(parts[region]) - jnp.min(parts[region]) for region in _REGIONS]
        return jnp.stack([*ranges, jnp.mean(parts["swir2"])])


def regions_view(scene: Scene, parameters: PlotParameters) -> RegionsView:
    """The view of AVIRIS-NG of a plot, of which the paper prints some numbers."""
    centres = (*_CENTRES, *_CENTRES_SWIR2)
    names = tuple(f"{centre:.0f}nm" for centre in centres)
    bands = BandSet(names, centres, (_WIDTH,) * len(centres))
    gains = Gains(GAIN, 1.0)
    return RegionsView(NAMES, spectrum_view(bands, scene, parameters, gains=gains))


def aviris_target(file: Path) -> Data:
    """The published numbers of the real AVIRIS-NG spectrum: ranges of reflectance by region, from
    table 5, where an error is printed as such and over the range; and the mean at 2100 to 2450 nm.

    **Arguments:** `file` of the plot, for the record.
    """
    rows = table5_2006()
    value = np.array([*(rows[r].rmse / rows[r].nrmse for r in _REGIONS), SWIR2_MEAN["real"]])
    # A reflectance that is added to all bands does not change a range.
    noise = np.where([name.endswith("_mean") for name in NAMES], OFFSET, 0.0)
    data = weigh_spectrum(NAMES, value, _RELATIVE_SD, noise=noise, offset=0.0)
    description = (
        f"{len(NAMES)} published numbers of the real AVIRIS-NG spectrum of the plot: the range of "
        "reflectance by region (table 5), and its mean at 2100 to 2450 nm. Errors: "
        f"{100 * _RELATIVE_SD:.0f} % each for itself, a factor of 1 ± {GAIN:g} on all."
    )
    source = Source("spectrum", regions_view, description, file)
    return dataclasses.replace(data, source=source)
