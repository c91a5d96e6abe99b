"""Hot spot: leaves of finite size open the way to the sensor where they let the sun in.

Two rays from a point on a leaf are both free with the probability exp(-tau_sun - tau_view + C),
where C is the leaf area that would block both: of a disc with normal n, the lens that the two
rays cut out of it, integrated along the rays. For leaf area u per volume

    C = integral dh u(h) A F(h / H),

h the height above the point. A and H follow from the directions, the distribution of normals and
the leaf's diameter by quadrature over the normals; F is then the same for all: for leaves of
spherical distribution viewed from close to the sun's direction it is (1 - h / (3 H))^2 up to
3 H and nothing above, within 0.02 elsewhere. No parameter is fitted to a canopy. (The
overlap of discs is Kuusk's 1985; exponential kernels, as in SAIL, reach too far.)

F is written as one decaying and one damped wave (error under 0.007, value and integral exact), so
that a sum down the ray carries three numbers a pixel, whatever the height of the canopy.
"""

import math

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from fynjax.canopy import AbstractLeafAngle
from fynjax.radiation._rays import AbstractRays
from fynjax.radiation._scene import OpticalClasses

# Integral of the overlap of two equal discs over their distance, in diameters.
_OVERLAP = 4.0 / (3.0 * math.pi)
# F(x) = a exp(-b x) + Re(c exp(-d x)), fitted to (1 - x / 3)^2 on [0, 3].
_REAL, _REAL_RATE = 0.95625, 1.27611
_WAVE_RATE = 0.93891 - 1.27425j
_COSINE = 1.0 - _REAL
_SINE = ((1.0 - _REAL / _REAL_RATE) * abs(_WAVE_RATE) ** 2 - _COSINE * _WAVE_RATE.real) / (
    -_WAVE_RATE.imag
)
_WAVE = complex(_COSINE, -_SINE)
# Gauss-Legendre points in a piece of the path, as shares of it, and weights.
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(3)
POINTS = tuple(float(0.5 * (node + 1.0)) for node in _NODES)
POINT_WEIGHTS = tuple(float(0.5 * weight) for weight in _WEIGHTS)


class Overlap(eqx.Module):
    """What both rays meet of the leaves of one kind: from piece to piece down a ray."""

    amplitude: Float[Array, "row column"]
    """A: leaf area common to both rays close to the leaf [-]."""
    decay: tuple[tuple[Array, Array, Array], ...]
    """exp(-b x), real and imaginary part of exp(-d x), at each point of a piece and at its end."""
    gain: tuple[Array, ...]
    """Sum over a piece's own leaves there, per leaf area per volume [m]."""
    end_gain: tuple[Array, Array, Array]
    """Sum over a piece's own leaves at its end, for each of the three numbers [m]."""

    def start(self, shape: tuple[int, ...]) -> tuple[Array, Array, Array]:
        zero = jnp.zeros(shape, self.amplitude.dtype)
        return zero, zero, zero

    def at_points(self, state: tuple[Array, ...], area: Array) -> list[Array]:
        """C at each point of a piece with leaf area per volume `area`, and at its end."""
        local = self.amplitude * area
        real, wave, turn = state
        return [
            real * e + wave * c - turn * s + local * gain
            for (e, c, s), gain in zip(self.decay, self.gain)
        ]

    def advance(self, state: tuple[Array, ...], area: Array) -> tuple[Array, Array, Array]:
        """To the end of the piece."""
        local = self.amplitude * area
        real, wave, turn = state
        e, c, s = self.decay[-1]
        return (
            real * e + local * self.end_gain[0],
            wave * c - turn * s + local * self.end_gain[1],
            wave * s + turn * c + local * self.end_gain[2],
        )


def _mean_wave(x: Array) -> Array:
    """(1 - exp(-x)) / x for complex x."""
    small = jnp.abs(x) < 0.05
    safe = jnp.where(small, 1.0, x)
    series = 1.0 + x * (-1 / 2 + x * (1 / 6 + x * (-1 / 24 + x / 120)))
    return jnp.where(small, series, (1.0 - jnp.exp(-safe)) / safe)


def overlap_scales(
    angle: AbstractLeafAngle, sun: Float[Array, " 3"], views: Float[Array, "view 3"]
) -> Float[Array, "two view"]:
    """A, and the diameter over H and over the sine of the angle between the rays [-].

    `sun` and `views` are unit vectors towards the sun and the sensor. Quadrature over the normals
    of the leaves that both rays meet from the same side.
    """
    normals, weight = angle.normals()
    normals, weight = normals.astype(sun.dtype), weight.astype(sun.dtype)
    to_sun, to_view = normals @ sun, normals @ views.T  # [normal], [normal, view]
    product = to_sun[:, None] * to_view
    both = product > 0
    product = jnp.where(both, product, 1.0)
    cosines = sun[2] * views[:, 2]
    amplitude = weight @ jnp.where(both, jnp.sqrt(product / cosines), 0.0)
    axis = jnp.cross(sun[None], views)
    square = jnp.sum(axis**2, axis=1, keepdims=True)
    apart = square > 1e-12
    # In the hot spot itself any axis across the rays serves: nothing decays there.
    across = jnp.stack([sun[2], jnp.zeros_like(sun[0]), -sun[0]])
    axis = jnp.where(apart, axis / jnp.sqrt(jnp.where(apart, square, 1.0)), across)
    axis = axis / jnp.linalg.norm(axis, axis=1, keepdims=True)
    tilt = jnp.linalg.norm(jnp.cross(normals[:, None], axis[None]), axis=-1)
    reach = weight @ jnp.where(both, product / jnp.maximum(tilt, 1e-3), 0.0)
    some = reach > 1e-9
    return jnp.stack([amplitude, jnp.where(some, amplitude / jnp.where(some, reach, 1.0), 0.0)])


def kinds(classes: OpticalClasses) -> tuple[tuple[int, int], ...]:
    """The distinct pairs (distribution of normals, leaf diameter) among the classes."""
    return tuple(sorted(set(zip(classes.angle_of_class, classes.sizes))))


def overlaps(
    classes: OpticalClasses, rays: AbstractRays, sun: Float[Array, " 3"], height: float
) -> tuple[Overlap, ...]:
    """One `Overlap` for each of `kinds(classes)`, for pieces of `height` metres."""
    if classes.leaf_diameter is None:
        return ()
    dtype = sun.dtype
    # The rays part by this sine of their angle, and the lens of both discs shrinks as they do.
    sine = rays.sine_to(sun)
    scales = rays.angular(
        lambda views: jnp.stack([overlap_scales(angle, sun, views) for angle in classes.angles])
    )
    overlap_of_kind = []
    for angle, size in kinds(classes):
        amplitude, ratio = scales[angle]
        diameter = classes.leaf_diameter[size].astype(dtype)
        # Points have no overlap: their rate is without end.
        rate = ratio * sine / (_OVERLAP * jnp.maximum(diameter, 1e-6))
        # All points at once: written out one by one, they take the compiler four times as long.
        shares = jnp.asarray((*POINTS, 1.0), dtype)[:, None, None] * height
        x = rate * shares
        turned = jnp.exp(-_WAVE_RATE * x)
        real_gain = shares * _REAL * _mean_wave(_REAL_RATE * x + 0j).real
        wave_gain = shares * _WAVE * _mean_wave(_WAVE_RATE * x)
        decay = tuple(zip(jnp.exp(-_REAL_RATE * x), turned.real, turned.imag))
        end_gain = real_gain[-1], wave_gain.real[-1], wave_gain.imag[-1]
        overlap_of_kind.append(
            Overlap(amplitude, decay, tuple(real_gain + wave_gain.real), end_gain)
        )
    return tuple(overlap_of_kind)
