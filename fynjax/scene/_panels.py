"""Reference panels in a sensor's picture, and the empirical line that they give."""

from collections.abc import Sequence

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from fynjax._core.errors import InputError
from fynjax.sensors import (
    EmpiricalLine,
    Panel,
    empirical_line,
    one_panel_line,
    panel_coverage,
    place_panels,
)

_WHOLE = 1.0 - 1e-9
_TINY = 1e-30  # the root has no slope at zero


class PanelsInPicture(eqx.Module):
    """Panels as a picture of a sensor shows them; `panels_in_picture` makes them."""

    coverage: Float[np.ndarray, "panel y x"]
    """Share of each pixel under each panel [-]."""
    reflectance: Float[np.ndarray, "panel 1"]
    """Reflectance factor of each panel [-]."""
    reflectance_sd: Float[np.ndarray, "panel 1"]
    """Standard deviation of the reflectance factor of each panel [-]."""

    def laid_on(self, image: Float[Array, "band y x"]) -> Float[Array, "band y x"]:
        """A picture of reflectance with the panels in it."""
        panels = jnp.asarray(self.reflectance)
        return place_panels(image, jnp.asarray(self.coverage), panels).astype(image.dtype)

    def line(
        self,
        radiance: Float[Array, "band y x"],
        transparent: Bool[Array, " band"],
        *,
        noise_sd: Float[Array, "#band #y #x"] | float = 0.0,
        haze: Float[Array, " band"] | float = 0.0,
    ) -> EmpiricalLine:
        """The empirical line from a picture of radiance, or the line through zero of one panel.

        `noise_sd` is that of single pixels, which few pixels of a panel do not show themselves.
        `haze` is the radiance over a black pixel: what one panel cannot tell, and is therefore
        unsure by. Both in the unit of the radiance.

        In bands whose air is not `transparent` the panels look alike, and the line is of no use
        (but finite). See `fynjax.sensors.empirical_line`; differentiable in `radiance`.
        """
        # Pixels that are wholly panel; as weights, since inside transformations none can be picked.
        inside = jnp.asarray(self.coverage >= _WHOLE, radiance.dtype)
        count = jnp.sum(inside, axis=(1, 2))[:, None]
        mean = jnp.einsum("pyx,byx->pb", inside, radiance) / count
        apart = radiance - mean[:, :, None, None]
        # Scatter of the pixels of a panel, or what noise alone makes, if few pixels scatter less.
        scatter = jnp.einsum("pyx,pbyx->pb", inside, apart**2) / jnp.maximum(count - 1.0, 1.0)
        noise = jnp.broadcast_to(jnp.asarray(noise_sd, radiance.dtype) ** 2, radiance.shape)
        expected = jnp.einsum("pyx,byx->pb", inside, noise) / count
        mean_sd = jnp.sqrt(jnp.maximum(scatter, expected) / count + _TINY)
        known, doubt = jnp.asarray(self.reflectance), jnp.asarray(self.reflectance_sd)
        # In opaque bands panels would look alike; numbers in their place keep slopes finite.
        signal = jnp.where(transparent, mean, known)
        sd = jnp.where(transparent, mean_sd, 0.0)
        if len(signal) == 1:
            unknown = jnp.where(transparent, known[0] / signal[0] * haze, 0.0)
            return one_panel_line(
                signal[0], known[0], signal_sd=sd[0], reflectance_sd=doubt[0], offset_sd=unknown
            )
        return empirical_line(signal, known, signal_sd=sd, reflectance_sd=doubt)


def panels_in_picture(
    panels: Sequence[Panel], shape: tuple[int, int], pixel: float, origin: tuple[float, float]
) -> PanelsInPicture:
    """Lay panels into a picture of `shape` (rows, columns) with pixels of side `pixel` [m], whose
    south-west corner is at `origin` (x, y) [m].

    Raises `InputError` for a panel beyond the picture or that covers no pixel wholly, panels that
    overlap, and panels of equal reflectance.
    """
    covered = []
    for number, panel in enumerate(panels, start=1):
        half = panel.side_m / 2
        ways = ((-half, -half), (half, -half), (half, half), (-half, half))
        corners = [(panel.x_m + dx, panel.y_m + dy) for dx, dy in ways]
        ends = [(o, o + n * pixel) for o, n in zip(origin, shape[::-1], strict=True)]
        if any(
            not low - 1e-6 <= at <= high + 1e-6
            for corner in corners
            for at, (low, high) in zip(corner, ends, strict=True)
        ):
            (west, east), (south, north) = ends
            raise InputError(
                f"panel {number} must lie in the image, {west:g} to {east:g} m east and {south:g} "
                f"to {north:g} m north of the plot's corner, but its middle is at "
                f"({panel.x_m:g}, {panel.y_m:g}) m and its side {panel.side_m:g} m"
            )
        coverage = panel_coverage(corners, shape, pixel_m=pixel, origin_m=origin)
        if not (coverage >= _WHOLE).any():
            raise InputError(
                f"panel {number} must cover some pixels wholly, but its side of {panel.side_m:g} m "
                f"holds none of {pixel:.4g} m. Make it three pixels wide or more."
            )
        covered.append(coverage)
    stacked = np.stack(covered)
    if stacked.sum(axis=0).max() > 1.0 + 1e-6:
        raise InputError("panels must not overlap, but some pixels are under more than one")
    known = np.array([[panel.reflectance] for panel in panels])
    if len(panels) > 1 and np.ptp(known) == 0.0:
        raise InputError(
            f"panels must differ in reflectance, but all have {known[0, 0]:g}. A line needs a dark "
            "and a bright one."
        )
    doubt = np.array([[panel.reflectance * panel.reflectance_sd] for panel in panels])
    return PanelsInPicture(stacked, known, doubt)
