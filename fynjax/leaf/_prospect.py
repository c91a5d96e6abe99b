"""PROSPECT: reflectance and transmittance of a leaf from its structure and chemistry.

Equations after Jacquemoud & Baret 1990 (Remote Sensing of Environment 34, 75-91; JB below) with the
absorption tables of Féret et al. 2008, 2017 and 2021, rearranged so that no step cancels or
divides by zero: see `_stack`.
"""

from collections.abc import Iterator, Mapping, Sequence
from functools import lru_cache, partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.custom_batching import custom_vmap
from jax.custom_derivatives import SymbolicZero
from jaxtyping import Array, Float

from fynjax._core.errors import InputError, did_you_mean
from fynjax._core.math import real_array
from fynjax._core.precision import double_precision
from fynjax.leaf._area import LeafShape, check_leaf_shape
from fynjax.leaf._coefficients import (
    CONSTITUENTS,
    ProspectVersion,
    check_in_tables,
    check_version,
    coefficients_at,
    native_wavelength,
)
from fynjax.leaf._parameters import LEAF_PARAMETERS, LeafParameters
from fynjax.leaf._transmissivity import absorptance_slope, layer_absorptance

# Leaves that are computed together where there are many.
_BLOCK = 100


class LeafOptics(eqx.Module):
    """Leaf reflectance and transmittance, on the bands they were computed for."""

    reflectance: Float[Array, "*leaf band"]
    """Directional-hemispherical reflectance [-]."""
    transmittance: Float[Array, "*leaf band"]
    """Directional-hemispherical transmittance [-]."""
    wavelength: Float[Array, " band"]
    """Band centres [nm]."""

    def __iter__(self) -> Iterator[Array]:
        """Reflectance, then transmittance: `r, t = prospect(...)`."""
        return iter((self.reflectance, self.transmittance))

    def __str__(self) -> str:
        """The range of both, in a sentence."""
        shape = jnp.shape(self.reflectance)
        leaves = "a leaf" if len(shape) == 1 else f"{' x '.join(map(str, shape[:-1]))} leaves"
        if isinstance(self.reflectance, jax.core.Tracer):
            return f"Optics of {leaves} in {shape[-1]} bands."
        ends = [f"{float(f(v)):.3f}" for v in self for f in (jnp.min, jnp.max)]
        return (
            f"Optics of {leaves} in {shape[-1]} bands, {float(self.wavelength[..., 0].min()):g} to "
            f"{float(self.wavelength[..., -1].max()):g} nm: reflectance {ends[0]} to {ends[1]}, "
            f"transmittance {ends[2]} to {ends[3]}."
        )


def interface_transmissivity(
    incidence_half_angle: float | Float[Array, ""], refractive_index: float | Float[Any, "*band"]
) -> Float[Any, "*band"]:
    """Transmissivity of a smooth surface, averaged over a cone of unpolarised light [-].

    Closed form of Stern 1964 (Applied Optics 3, 111) as used by Allen 1973 (Applied Optics 12,
    664), with the square root written as cos(a) sqrt(n^2 - sin^2(a)), which keeps its derivative
    finite at 90 degrees.

    **Arguments:**

    - `incidence_half_angle`: largest angle of incidence [degrees], within (0, 90].
    - `refractive_index`: index of the material below the surface [-], above 1.

    **Returns:** transmissivity, the shape of `refractive_index`. Computed in NumPy if both inputs
    are plain numbers or NumPy arrays. Differentiable in both. The closed form cancels: in float32
    its error is about 1e-5, in float64 1e-13.
    """
    traced = isinstance(incidence_half_angle, jax.Array) or isinstance(refractive_index, jax.Array)
    xp: Any = jnp if traced else np
    n = refractive_index
    angle = xp.deg2rad(incidence_half_angle)
    sin2, cos = xp.sin(angle) ** 2, xp.cos(angle)
    n2 = n * n
    plus, minus = n2 + 1.0, n2 - 1.0
    # The two limits of the integral over the cone, at normal incidence (a) and at its edge (b).
    a = (n + 1.0) ** 2 / 2.0
    b = cos * xp.sqrt(n2 - sin2) + plus / 2.0 - sin2
    k = -(minus**2) / 4.0
    a_star, b_star = 2.0 * plus * a - minus**2, 2.0 * plus * b - minus**2
    # Light polarised perpendicular and parallel to the plane of incidence.
    perpendicular = (k**2 / (6.0 * b**3) + k / b - b / 2.0) - (
        k**2 / (6.0 * a**3) + k / a - a / 2.0
    )
    parallel = (
        -2.0 * n2 * (b - a) / plus**2
        - 2.0 * n2 * plus * xp.log(b / a) / minus**2
        + n2 * (1.0 / b - 1.0 / a) / 2.0
        + 16.0 * n2**2 * (n2**2 + 1.0) * xp.log(b_star / a_star) / (plus**3 * minus**2)
        + 16.0 * n2**3 * (1.0 / b_star - 1.0 / a_star) / plus**3
    )
    return (perpendicular + parallel) / (2.0 * sin2)


def cylinder_transmissivity(
    refractive_index: Float[np.ndarray, " band"],
) -> Float[np.ndarray, " band"]:
    """Transmissivity of the smooth surface of a cylinder lit across its axis [-].

    Fresnel's equations for unpolarised light, averaged over the width of the cylinder, on which the
    sine of the angle of incidence is even. Of leaves (n = 1.45) 0.94, so that a needle's surface
    reflects 0.06, where light within 40 degrees of a flat leaf's normal meets 0.035.

    **Arguments:** `refractive_index`: index of the material below the surface [-], above 1.01.

    **Returns:** transmissivity, the shape of `refractive_index`, to 1e-6. NumPy.
    """
    n = np.asarray(refractive_index, float)
    nodes, weights = np.polynomial.legendre.leggauss(24)
    total = np.zeros(n.shape)
    for angle, weight in zip((nodes + 1.0) * np.pi / 4.0, weights * np.pi / 4.0):
        sin, cos = np.sin(angle), np.cos(angle)
        inside = np.sqrt(n**2 - sin**2)
        across, along = (
            (cos - inside) / (cos + inside),
            (n**2 * cos - inside) / (n**2 * cos + inside),
        )
        # The weight cos is that of the width; R is the mean of both polarisations.
        total += weight * cos * (1.0 - (across**2 + along**2) / 2.0)
    return total


def surface_transmissivity(
    shape: str, refractive_index: Float[np.ndarray, " band"], incidence_half_angle: float = 40.0
) -> Float[np.ndarray, " band"]:
    """Transmissivity of the lit surface of a leaf of a shape [-]: of a single needle a cylinder's.

    All that the surface reflects counts as R, as from a rough one: R of single pine needles at
    450 nm, where hardly any light returns from within, has the median 0.067, and this gives 0.066
    (Di Vittorio 2009, Remote Sensing of Environment 113, 1948). What meets a smooth cylinder beyond
    45 degrees, 0.036 of the 0.06, would go on forward. Where needles lie side by side it meets the
    neighbour, and R of 139 mats at 450 nm has the median 0.038 (NASA FFT): they, and culms, count
    as flat. 40 degrees are the half angle of the authors of PROSPECT for a flat leaf.
    """
    check_leaf_shape(shape)
    if shape == "needle":
        return cylinder_transmissivity(refractive_index)
    return interface_transmissivity(incidence_half_angle, refractive_index)


Pair = tuple[Array, Array]
"""Reflectance and transmittance, or the derivative of both by one input."""


def _layer_count_series(m: Array, x: Array) -> tuple[Array, Array, Array]:
    """sinh(m asinh z) / z, its derivative by z^2, and cosh(m asinh z), as polynomials in x = z^2.

    For x below 0.01.
    """
    m2 = m * m
    sinh_terms, cosh_terms, sinh_slope = jnp.ones_like(x), jnp.ones_like(x), jnp.zeros_like(x)
    for i in (4, 3, 2, 1):
        odd, even = 2 * i - 1, 2 * i - 2
        factor = (m2 - odd**2) / (2 * i * (2 * i + 1))
        sinh_slope = factor * (sinh_terms + x * sinh_slope)
        sinh_terms = 1.0 + factor * x * sinh_terms
        cosh_terms = 1.0 + x * (m2 - even**2) / (2 * i * (2 * i - 1)) * cosh_terms
    return m * sinh_terms, m * sinh_slope, cosh_terms


def _asinh_series(x: Array) -> Array:
    """asinh(z) / z as a polynomial in x = z^2, for x below 0.01."""
    terms = jnp.ones_like(x)
    for i in (4, 3, 2, 1):
        terms = 1.0 - x * ((2 * i - 1) ** 2 / (2 * i * (2 * i + 1))) * terms
    return terms


def _stack(
    absorbed: Array, structure: Array, first: Array, diffuse: Array, index: Array
) -> tuple[Pair, Pair, Pair]:
    """Reflectance and transmittance of N layers from the absorptance of a layer, 1 - theta; their
    derivatives by the absorptance, and by N.

    JB eq. 12-14 for the layers, Stokes 1862 for N - 1 of them. With D the usual square root and
    b = exp(B), sinh B = D / (2 t), the Stokes solution for m = N - 1 reads
    R = 2 r s / (C + g s), T = 1 / (C + g s), where g = 1 - r^2 - t^2, and C = cosh(m B) and
    s = sinh(m B) / D are even in D: analytic in D^2, which is proportional to the absorptance. They
    are polynomials in D^2 near zero absorption (the limit is s = m / (2 t)), and are written with
    b^-m, which does not overflow, elsewhere. 1 - r - t is formed without a difference, as
    t12 (1 - theta) / (1 - r21 theta).

    The derivatives are written out because automatic ones took four times as long: by m,
    dC = B D s and ds = B C / D; by the absorptance a (suffix _a), dC = m s (D B_a) and
    ds = (m C (D B_a) - s (D^2)_a / 2) / D^2, where cosh B = h / (2 t) with h = 1 - r^2 + t^2 gives
    D B_a = h_a - h t_a / t; C^2 - D^2 s^2 = 1 shortens what comes of them. `jit` drops them where
    they are not used.
    """
    dtype = absorbed.dtype
    theta = jnp.maximum(1.0 - absorbed, 0.0)
    back = diffuse / (index * index)  # transmissivity from inside, t21
    mirror = 1.0 - back
    trapped = mirror * theta
    inverse = 1.0 / ((1.0 - trapped) * (1.0 + trapped))
    through, through_a = theta * back * inverse, -back * (1.0 + trapped * trapped) * inverse**2
    first_t, first_t_a = first * through, first * through_a
    first_r, first_r_a = 1.0 - first + trapped * first_t, trapped * first_t_a - mirror * first_t
    t, t_a = diffuse * through, diffuse * through_a
    r, r_a = 1.0 - diffuse + trapped * t, trapped * t_a - mirror * t
    escape = (1.0 + trapped) * inverse
    lost, lost_a = diffuse * absorbed * escape, diffuse * back * escape**2
    more, more_r, more_t = 1.0 + r + t, 1.0 + r - t, 1.0 - r + t
    rest = more * more_r * more_t
    rest_a = (r_a + t_a) * more_r * more_t + (r_a - t_a) * more * (more_t - more_r)
    d2, half_d2_a = rest * lost, 0.5 * (rest * lost_a + rest_a * lost)
    h, h_a = 1.0 - r * r + t * t, 2.0 * (t * t_a - r * r_a)
    g, g_a = 1.0 - r * r - t * t, -2.0 * (t * t_a + r * r_a)

    m = structure - 1.0
    # An opaque layer has no logarithm; the square of the floor must not underflow.
    floor, limit = (1e-30, 1e-3) if dtype == jnp.float64 else (1e-15, 1e-2)
    t_floor = jnp.maximum(t, jnp.asarray(floor, dtype))
    thin = d2 < limit * 4.0 * t_floor * t_floor
    half = 0.5 / jnp.where(thin, t_floor, 1.0)  # 1 / (2 t)
    x = jnp.where(thin, d2, 0.0) * half * half
    x_a = 2.0 * (half_d2_a * half - 2.0 * x * t_a) * half
    series_s, series_s_x, series_c = _layer_count_series(m, x)
    series_s_a = (series_s_x * x_a - 2.0 * series_s * t_a * half) * half

    d2_thick = jnp.where(thin, 1.0, d2)
    d = jnp.sqrt(d2_thick)
    log_b = -jnp.log(2.0 * t_floor / (h + d))
    y = jnp.exp(-m * log_b)
    # s, C and 1, all times the same factor, which drops out with the weight.
    s = jnp.where(thin, series_s * half, (1.0 - y * y) / 2.0)
    c = jnp.where(thin, series_c, d * (1.0 + y * y) / 2.0)
    top = jnp.where(thin, 1.0, d * y)
    weight = 1.0 / (c + g * s)
    s, c, top = s * weight, c * weight, top * weight
    rt, rt_a = r * t, r_a * t + r * t_a
    reflectance, transmittance = first_r + 2.0 * rt * first_t * s, first_t * top

    # B / D; divided last, for the reason given in `pile_and_slopes` (by 1 where the series holds).
    b = jnp.where(thin, _asinh_series(x) * half, log_b)
    r_m = 2.0 * rt * transmittance * top * b / d
    t_m = -transmittance * (d2 * s + g * c) * b / d

    db_a = m * (h_a - h * t_a / t_floor)
    s_a = jnp.where(thin, series_s_a * top, (db_a * c - half_d2_a * s) / d2_thick)
    change = db_a + g_a
    by_absorbed = (
        first_r_a
        + 2.0 * s * (rt_a * first_t + rt * first_t_a)
        + 2.0 * rt * first_t * (s_a * c - change * s * s),
        top * (first_t_a - first_t * (change * s + g * s_a)),
    )
    return (reflectance, transmittance), by_absorbed, (r_m, t_m)


def pile_and_slopes(
    k: Array, structure: Array, first: Array, diffuse: Array, index: Array
) -> tuple[Pair, Pair, Pair]:
    """`pile`, its derivatives by the k of each band, and by N.

    The derivatives end with a division because XLA on processors stores a quotient, but computes a
    product again for each of the parameters that it is then multiplied by (which took twice the
    time for seven).
    """
    value, (r_a, t_a), by_structure = _stack(layer_absorptance(k), structure, first, diffuse, index)
    numerator, denominator = absorptance_slope(k)
    by_k = (r_a * numerator / denominator, t_a * numerator / denominator)
    return value, by_k, by_structure


def _pile(k: Array, structure: Array, first: Array, diffuse: Array, index: Array) -> Pair:
    return _stack(layer_absorptance(k), structure, first, diffuse, index)[0]


_pile_of_many = custom_vmap(_pile)


@_pile_of_many.def_vmap
def _pile_in_blocks(
    leaves: int, batched: Sequence[bool], *inputs: Array
) -> tuple[Pair, tuple[bool, bool]]:
    """Thousands of leaves by the hundred where a processor computes: what is made on the way then
    stays in its cache, which takes half the time and a third of the memory."""

    def at_once(*inputs: Array) -> Pair:
        return jax.vmap(_pile, [0 if own else None for own in batched])(*inputs)

    def in_blocks(*inputs: Array) -> Pair:
        def leaf(own: list[Array]) -> Pair:
            rest = iter(own)
            return _pile(*(next(rest) if b else value for b, value in zip(batched, inputs)))

        moving = [value for b, value in zip(batched, inputs) if b]
        return jax.lax.map(leaf, moving, batch_size=_BLOCK)

    if leaves <= _BLOCK:
        return at_once(*inputs), (True, True)
    return jax.lax.platform_dependent(*inputs, cpu=in_blocks, default=at_once), (True, True)


@jax.custom_jvp
def pile(k: Array, structure: Array, first: Array, diffuse: Array, index: Array) -> Pair:
    """Reflectance and transmittance [band] of N layers that absorb by k."""
    return _pile_of_many(k, structure, first, diffuse, index)


@partial(pile.defjvp, symbolic_zeros=True)
def _pile_jvp(primals: tuple, tangents: tuple) -> tuple[Pair, Pair]:
    """Each band depends on its own k and on N: their two slopes serve every parameter of a leaf."""
    value, by_k, by_structure = pile_and_slopes(*primals)
    r, t = jnp.zeros_like(value[0]), jnp.zeros_like(value[1])
    for (by_r, by_t), tangent in zip((by_k, by_structure), tangents):
        if not isinstance(tangent, SymbolicZero):
            r, t = r + by_r * tangent, t + by_t * tangent
    # Surfaces of leaves are rarely varied: automatic there, and only where they are.
    k, structure, *surface = primals
    if not all(isinstance(tangent, SymbolicZero) for tangent in tangents[2:]):
        given = [
            jnp.zeros_like(value) if isinstance(tangent, SymbolicZero) else tangent
            for value, tangent in zip(surface, tangents[2:])
        ]
        of_surface = partial(_stack, layer_absorptance(k), structure)
        _, (by_r, by_t) = jax.jvp(lambda *values: of_surface(*values)[0], surface, given)
        r, t = r + by_r, t + by_t
    return value, (r, t)


@jax.jit
def _kernel(
    structure: Array,
    contents: Float[Array, " constituent"],
    absorption: Float[Array, "constituent band"],
    first: Float[Array, " band"],
    diffuse: Float[Array, " band"],
    index: Float[Array, " band"],
) -> tuple[Float[Array, " band"], Float[Array, " band"]]:
    k = jnp.dot(contents, absorption, precision=jax.lax.Precision.HIGHEST) / structure
    return pile(k, structure, first, diffuse, index)


@lru_cache(maxsize=64)
@double_precision
def _constants(
    version: str, grid: bytes | None, shape: str, angle: float, dtype: str
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    wavelength = native_wavelength() if grid is None else np.frombuffer(grid, np.float64)
    index, absorption = coefficients_at(version, wavelength)
    first = surface_transmissivity(shape, index, angle)
    diffuse = interface_transmissivity(90.0, index)
    return (
        absorption.astype(dtype),
        np.asarray(first, dtype),
        np.asarray(diffuse, dtype),
        index.astype(dtype),
    )


def prospect(
    parameters: LeafParameters | None = None,
    wavelength: Any = None,
    version: ProspectVersion = "D",
    incidence_half_angle: float | Float[Array, ""] = 40.0,
    leaf_shape: LeafShape = "broad",
    **traits: Any,
) -> LeafOptics:
    """Reflectance and transmittance of a leaf, by PROSPECT-5, -D or -PRO.

    **Arguments:**

    - `parameters`: the leaf, or many (`LeafParameters.many`). On a processor thousands are computed
      by the hundred, in memory of 1.5 times the output. That holds for one `vmap` of the forward
      model; flatten two, and take gradients of thousands by `jax.lax.map(..., batch_size=100)`.
    - `wavelength`: band centres [nm], any grid inside 400-2500 nm, known outside `jit`; by default
      400 to 2500 in steps of 1 nm. The tables are interpolated linearly; bands below 400 nm, as a
      field spectrometer gives them from 350 nm on, are outside the model and refused, never
      extrapolated (the fit of this package masks them).
    - `version`: "5", "D" or "PRO".
    - `incidence_half_angle`: half angle of the cone of light on the leaf's rough surface [degrees],
      within (0, 90]; 40 is the authors' value, 59 that of the fluorescence models. A plain number
      is turned into constants in float64; a traced array is differentiable, but in float32 costs
      an error of about 1e-5.
    - `leaf_shape`: "broad", or "needle", whose surface is that of a cylinder lit across its axis
      (`cylinder_transmissivity`) at whatever `incidence_half_angle`. One of a "mat" or of culms,
      whose grazing light meets the next, counts as flat; light between them is added by
      `recollided`.
    - `traits`: instead of `parameters`, its fields by name, such as `chlorophyll=40.0`; numbers or
      arrays, which are broadcast against each other. The others have their defaults.

    **Returns:** `LeafOptics` of the dtype of `parameters`, [band] of a leaf and [*leaf, band] of
    many. It unpacks: `r, t = prospect(chlorophyll=40.0)`.

    **Raises:** `InputError` for an unknown version or shape, wavelengths outside 400-2500 nm, or an
    angle outside (0, 90].

    Differentiable in `parameters` to any order with finite derivatives, also at zero absorption
    (where the derivatives equal their limits; the second derivative diverges logarithmically in
    theory and is cut off, see `layer_absorptance`), at N = 1 and for an opaque leaf. Agrees with
    the authors' R package to 1e-13 in float64.

    >>> import fynjax as fx
    >>> leaf = fx.LeafParameters(chlorophyll=45.0, water=0.012)
    >>> optics = fx.prospect(leaf, [550.0, 680.0, 860.0])
    >>> [round(float(value), 2) for value in optics.reflectance]
    [0.14, 0.04, 0.44]
    >>> r, t = fx.prospect(chlorophyll=[20.0, 40.0, 80.0], water=[[0.01], [0.03]])
    >>> r.shape
    (2, 3, 2101)
    """
    if traits:
        if parameters is not None:
            raise InputError(
                f"expected `parameters` or traits, but got both ({next(iter(traits))})"
            )
        parameters = _leaves(traits)
    parameters = LeafParameters() if parameters is None else parameters
    if not isinstance(parameters, LeafParameters):
        raise InputError(
            "expected `LeafParameters`, or traits by name such as prospect(chlorophyll=45), but "
            f"got {type(parameters).__name__}"
        )
    shape = jnp.shape(parameters.structure)
    if shape:
        flat = jax.tree.map(lambda field: jnp.reshape(field, -1), parameters)
        one = partial(
            prospect, wavelength=wavelength, version=version,
            incidence_half_angle=incidence_half_angle, leaf_shape=leaf_shape,
        )  # fmt: skip
        r, t = jax.vmap(lambda leaf: tuple(one(leaf)))(flat)
        grid = native_wavelength() if wavelength is None else np.asarray(wavelength, np.float64)
        return LeafOptics(r.reshape(*shape, -1), t.reshape(*shape, -1), jnp.asarray(grid, r.dtype))
    check_version(version)
    grid = native_wavelength() if wavelength is None else np.asarray(wavelength, np.float64)
    check_in_tables(grid)
    # Everything that does not depend on the leaf is a constant, made once for a grid and version.
    fields = [getattr(parameters, name) for name in CONSTITUENTS[version]]
    dtype = jnp.result_type(parameters.structure, *fields)
    key = None if wavelength is None else grid.tobytes()
    check_leaf_shape(leaf_shape)
    if isinstance(incidence_half_angle, jax.Array) and leaf_shape != "needle":
        absorption, _, diffuse, index = _constants(version, key, leaf_shape, 40.0, dtype.name)
        first = interface_transmissivity(incidence_half_angle, jnp.asarray(index)).astype(dtype)
    else:
        angle = 40.0 if leaf_shape == "needle" else float(incidence_half_angle)
        if not 0.0 < angle <= 90.0:
            raise InputError(f"`incidence_half_angle` must be in (0, 90] degrees, but is {angle:g}")
        absorption, first, diffuse, index = _constants(version, key, leaf_shape, angle, dtype.name)
    contents = jnp.stack([jnp.asarray(field, dtype) for field in fields])
    structure = jnp.asarray(parameters.structure, dtype)
    reflectance, transmittance = _kernel(structure, contents, absorption, first, diffuse, index)
    return LeafOptics(reflectance, transmittance, jnp.asarray(grid, dtype))


def _leaves(traits: Mapping[str, Any]) -> LeafParameters:
    """A leaf of the traits, or many, of the shape that they have together."""
    known = tuple(LEAF_PARAMETERS)
    for name in traits:
        if name not in known:
            raise InputError(
                f"unknown trait {name!r}.{did_you_mean(name, known)} Known are {', '.join(known)}"
            )
    traits = {name: real_array(value, name) for name, value in traits.items()}
    try:
        shape = np.broadcast_shapes(*(np.shape(value) for value in traits.values()))
    except ValueError as error:
        shapes = ", ".join(f"{name} {np.shape(value)}" for name, value in traits.items())
        raise InputError(f"expected traits of shapes that broadcast, but got {shapes}") from error
    if not shape:
        return LeafParameters(**traits)
    if 0 in shape:
        raise InputError(f"expected traits of one leaf or more, but got the shape {shape}")
    every = {n: jnp.broadcast_to(v, shape).reshape(-1) for n, v in traits.items()}
    flat = LeafParameters.many(**every)
    return jax.tree.map(lambda field: jnp.reshape(field, shape), flat)
