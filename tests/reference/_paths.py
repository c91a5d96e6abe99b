"""Paths of light: forward from sun and sky to the sensors, backward from a sensor's pixels."""

import math

import numpy as np

from tests.reference._random import (
    Vector,
    compiled,
    compiled_with_arrays,
    dot,
    lambert,
    leaf_normal,
    uniform,
    unit,
)
from tests.reference._trace import (
    GROUND,
    LEAF,
    SIDE,
    SKY,
    Meeting,
    surface,
    trace_path,
    transmittance,
)
from tests.reference._world import Ground, Light, World

_LIFT = 1e-7  # of a column's width, so that uneven ground does not shade itself
_FAINT = 0.1  # weight below which every other path ends
FIXED = 5  # entries before the classes' in what `forward` returns


@compiled
def ground_factor(ground: Ground, normal: Vector, d: Vector, out: Vector) -> float:
    """Reflectance factor over the amplitude, for light along `d` that leaves along `out`.

    Rahman, Pinty and Verstraete (1993), eq. 1-9, with angles from the ground's normal.
    """
    if ground.lambertian:
        return 1.0
    cos_in, cos_out = max(-dot(d, normal), 1e-3), max(dot(out, normal), 1e-3)
    back = -dot(d, out)
    lobe = 1.0 + ground.theta**2 + 2.0 * ground.theta * back
    # tan^2 + tan^2 - 2 tan tan cos(azimuth), by the vectors.
    x = d[0] / cos_in + out[0] / cos_out
    y = d[1] / cos_in + out[1] / cos_out
    z = d[2] / cos_in + out[2] / cos_out
    hot = 1.0 + (1.0 - ground.rho_c) / (1.0 + math.sqrt(x * x + y * y + z * z))
    bowl = (cos_in * cos_out * (cos_in + cos_out)) ** (ground.k - 1.0)
    return bowl * (1.0 - ground.theta**2) / lobe**1.5 * hot


@compiled
def sky_radiance(light: Light, d: Vector) -> float:
    """Radiance of the sky towards `d`, over that of an even sky of the same irradiance."""
    if light.even:
        return 1.0
    zeniths, azimuths = light.pattern.shape
    u = math.acos(min(d[2], 1.0)) * (2.0 / math.pi) * (zeniths - 1)
    v = math.atan2(d[0], d[1]) * (0.5 / math.pi) * azimuths
    row = min(int(u), zeniths - 2)
    column = math.floor(v)
    u, v = u - row, v - column
    left, right = column % azimuths, (column + 1) % azimuths
    low = (1.0 - v) * light.pattern[row, left] + v * light.pattern[row, right]
    high = (1.0 - v) * light.pattern[row + 1, left] + v * light.pattern[row + 1, right]
    return (1.0 - u) * low + u * high


@compiled
def _leaf(
    world: World, met: Meeting, d: Vector, g: np.ndarray, state: np.ndarray
) -> tuple[int, Vector]:
    """The class of a leaf that was met, and its normal on the side that was met."""
    medium, discs = world.medium, world.discs
    if discs.active:
        n0, n1, n2 = discs.normal[met[4]]
        if n0 * d[0] + n1 * d[1] + n2 * d[2] > 0.0:
            n0, n1, n2 = -n0, -n1, -n2
        return discs.owner[met[4]], (n0, n1, n2)
    k, j, i = met[4], met[5], met[6]
    total = 0.0
    for c in range(medium.area.shape[3]):
        total += g[medium.angle_of_class[c]] * medium.area[k, j, i, c]
    draw = uniform(state) * total
    chosen = -1
    for c in range(medium.area.shape[3]):
        if medium.area[k, j, i, c] > 0.0:
            chosen = c
            draw -= g[medium.angle_of_class[c]] * medium.area[k, j, i, c]
            if draw < 0.0:
                break
    return chosen, leaf_normal(medium.cumulative[medium.angle_of_class[chosen]], d, state)


@compiled
def _ground(world: World, met: Meeting) -> tuple[float, Vector, Vector]:
    """Amplitude of the ground where it was met, its normal, and a point just above."""
    ground = world.ground
    x, y = met[1], met[2]
    if world.periodic:
        x -= math.floor(x / ground.size[0]) * ground.size[0]
        y -= math.floor(y / ground.size[1]) * ground.size[1]
    ny, nx = ground.amplitude.shape
    i = min(max(int(x / ground.spacing), 0), nx - 1)
    j = min(max(int(y / ground.spacing), 0), ny - 1)
    z, n = surface(ground, world.periodic, x, y)
    if not ground.uneven:
        return ground.amplitude[j, i], n, (x, y, 0.0)
    lift = _LIFT * ground.spacing
    return ground.amplitude[j, i], n, (x + n[0] * lift, y + n[1] * lift, z + n[2] * lift)


@compiled
def _start(world: World, from_sky: bool, state: np.ndarray) -> tuple[float, Vector, Vector, bool]:
    """Weight, place and direction of light that comes in, and whether through the scene's top.

    The cells of an open scene are lit through their sides too: a face is drawn in proportion to
    what it shows to the light.
    """
    light, size = world.light, world.ground.size
    d = (-light.sunward[0], -light.sunward[1], -light.sunward[2])
    weight = 1.0
    if from_sky and world.periodic:
        d = lambert((0.0, 0.0, -1.0), state)
    elif from_sky:
        # Evenly over the hemisphere, for near the horizon most light comes through the sides.
        z, turn = uniform(state), 2.0 * math.pi * uniform(state)
        s = math.sqrt(1.0 - z * z)
        d = unit(s * math.cos(turn), s * math.sin(turn), -z)
        weight = -2.0 * d[2]
    if from_sky:
        weight *= sky_radiance(light, (-d[0], -d[1], -d[2]))
    u, v = uniform(state), uniform(state)
    low, high = world.low, world.high
    if world.periodic:
        return weight, (u * size[0], v * size[1], high[2]), d, True
    wide = (high[0] - low[0], high[1] - low[1], high[2] - low[2])
    top, side, front = -wide[0] * wide[1] * d[2], wide[1] * wide[2], wide[0] * wide[2]
    side, front = side * abs(d[0]), front * abs(d[1])
    weight *= (top + side + front) / (-d[2] * size[0] * size[1])
    draw = uniform(state) * (top + side + front)
    x, y, z = low[0] + u * wide[0], low[1] + v * wide[1], high[2]
    if draw < top:
        return weight, (x, y, z), d, 0.0 <= x < size[0] and 0.0 <= y < size[1]
    if draw < top + side:
        x, z = low[0] if d[0] > 0.0 else high[0], low[2] + u * wide[2]
    else:
        y, z = low[1] if d[1] > 0.0 else high[1], low[2] + v * wide[2]
    return weight, (x, y, z), d, False


@compiled
def _towards(world: World, p: Vector, view: Vector, g: np.ndarray) -> float:
    """Transmittance to a distant sensor over its cosine; zero outside the pixels, which lie on
    the bottom of the grid."""
    if not world.periodic:
        x, y = p[0] - p[2] * view[0] / view[2], p[1] - p[2] * view[1] / view[2]
        if not (0.0 <= x < world.ground.size[0] and 0.0 <= y < world.ground.size[1]):
            return 0.0
    return transmittance(world, p, view, g) / view[2]


@compiled_with_arrays
def forward(world: World, views: np.ndarray, photons: int, seed: int) -> np.ndarray:
    """[albedo, transmitted, of it direct sun, absorbed by the ground, net loss through the sides,
    absorbed by each class..., reflectance factor towards each view...]"""
    state = np.empty(1, np.uint64)
    state[0] = seed
    medium, ground, light = world.medium, world.ground, world.light
    classes = medium.rho.shape[0]
    out = np.zeros(FIXED + classes + views.shape[0])
    first_view = FIXED + classes
    g, g_view = np.empty(medium.projection.shape[0]), np.empty(medium.projection.shape[0])
    for number in range(photons):
        from_sky = number + uniform(state) < light.sky * photons
        weight, p, d, through_top = _start(world, from_sky, state)
        if not through_top:
            out[4] -= weight
        scattered = False
        while weight > 0.0:
            met = trace_path(world, p, d, -math.log(1.0 - uniform(state)), g)
            p = (met[1], met[2], met[3])
            if met[0] == SKY or met[0] == SIDE:
                x, y = p[0], p[1]
                above = 0.0 <= x < ground.size[0] and 0.0 <= y < ground.size[1]
                out[0 if met[0] == SKY and (above or world.periodic) else 4] += weight
                break
            if met[0] == LEAF:
                owner, n = _leaf(world, met, d, g, state)
                rho, tau = medium.rho[owner], medium.tau[owner]
                out[FIXED + owner] += weight * (1.0 - rho - tau)
                for v in range(views.shape[0]):
                    view = (views[v, 0], views[v, 1], views[v, 2])
                    facing = dot(n, view)
                    share = rho * facing if facing > 0.0 else -tau * facing
                    if share > 0.0:
                        out[first_view + v] += weight * share * _towards(world, p, view, g_view)
                if uniform(state) * (rho + tau) >= rho:
                    n = (-n[0], -n[1], -n[2])
                weight *= rho + tau
                d = lambert(n, state)
            else:
                amplitude, n, p = _ground(world, met)
                out[1] += weight
                if not scattered and not from_sky:
                    out[2] += weight
                for v in range(views.shape[0]):
                    view = (views[v, 0], views[v, 1], views[v, 2])
                    facing = dot(n, view)
                    share = amplitude * facing
                    if share > 0.0:
                        share *= ground_factor(ground, n, d, view)
                        out[first_view + v] += weight * share * _towards(world, p, view, g_view)
                leaving = lambert(n, state)
                reflected = weight * amplitude * ground_factor(ground, n, d, leaving)
                out[3] += weight - reflected
                weight, d = reflected, leaving
            scattered = True
            if weight < _FAINT:
                if uniform(state) < 0.5:
                    break
                weight *= 2.0
    return out / photons


@compiled
def _path(
    world: World, p: Vector, d: Vector, g: np.ndarray, g_sun: np.ndarray, state: np.ndarray
) -> float:
    """pi times the radiance that comes to `p` against the direction `d`, over the irradiance."""
    medium, ground, light = world.medium, world.ground, world.light
    beam = light.sun / light.sunward[2]
    radiance, weight = 0.0, 1.0
    while weight > 0.0:
        met = trace_path(world, p, d, -math.log(1.0 - uniform(state)), g)
        p = (met[1], met[2], met[3])
        if met[0] == SKY or met[0] == SIDE:
            # Beside an open scene there is nothing, so the sky lights it from there too.
            if d[2] > 0.0:
                radiance += weight * light.sky * sky_radiance(light, d)
            break
        if met[0] == LEAF:
            owner, n = _leaf(world, met, d, g, state)
            rho, tau = medium.rho[owner], medium.tau[owner]
            facing = dot(n, light.sunward)
            share = rho * facing if facing > 0.0 else -tau * facing
            if share * beam > 0.0:
                radiance += weight * share * beam * transmittance(world, p, light.sunward, g_sun)
            if uniform(state) * (rho + tau) >= rho:
                n = (-n[0], -n[1], -n[2])
            weight *= rho + tau
            d = lambert(n, state)
        else:
            amplitude, n, p = _ground(world, met)
            back = (-d[0], -d[1], -d[2])
            share = amplitude * dot(n, light.sunward)
            if share * beam > 0.0:
                along = (-light.sunward[0], -light.sunward[1], -light.sunward[2])
                share *= ground_factor(ground, n, along, back)
                radiance += weight * share * beam * transmittance(world, p, light.sunward, g_sun)
            d = lambert(n, state)
            weight *= amplitude * ground_factor(ground, n, (-d[0], -d[1], -d[2]), back)
        if weight < _FAINT:
            if uniform(state) < 0.5:
                break
            weight *= 2.0
    return radiance


@compiled
def _from_pixel(
    place: np.ndarray,
    place_edges: np.ndarray,
    direction: np.ndarray,
    direction_edges: np.ndarray,
    state: np.ndarray,
) -> tuple[Vector, Vector]:
    """A place and a direction drawn evenly from the parallelograms about a pixel's own."""
    u, v = uniform(state) - 0.5, uniform(state) - 0.5
    a, b = place_edges
    p = (
        place[0] + u * a[0] + v * b[0],
        place[1] + u * a[1] + v * b[1],
        place[2] + u * a[2] + v * b[2],
    )
    a, b = direction_edges
    d = unit(
        direction[0] + u * a[0] + v * b[0],
        direction[1] + u * a[1] + v * b[1],
        direction[2] + u * a[2] + v * b[2],
    )
    return p, d


@compiled_with_arrays
def count_first(
    world: World,
    place: np.ndarray,
    place_edges: np.ndarray,
    direction: np.ndarray,
    direction_edges: np.ndarray,
    samples: int,
    seeds: np.ndarray,
) -> np.ndarray:
    """Of `samples` rays of each pixel the share that first meets each class of leaves, ground that
    a ray to the sun leaves, and ground that it does not: [class + 2, pixel]."""
    medium, count = world.medium, world.medium.area.shape[3]
    out = np.zeros((count + 2, place.shape[0]))
    state, g = np.empty(1, np.uint64), np.empty(medium.projection.shape[0])
    for pixel in range(place.shape[0]):
        state[0] = seeds[pixel]
        for _ in range(samples):
            p, d = _from_pixel(
                place[pixel], place_edges[pixel], direction[pixel], direction_edges[pixel], state
            )
            met = trace_path(world, p, d, -math.log(1.0 - uniform(state)), g)
            if met[0] == LEAF:
                k, j, i = met[4], met[5], met[6]
                whole = 0.0
                for c in range(count):
                    whole += medium.area[k, j, i, c] * g[medium.angle_of_class[c]]
                left, c = whole * uniform(state), 0
                while c < count - 1:
                    left -= medium.area[k, j, i, c] * g[medium.angle_of_class[c]]
                    if left < 0.0:
                        break
                    c += 1
                out[c, pixel] += 1.0 / samples
            elif met[0] == GROUND:
                at = met[1], met[2], 0.0
                shaded = uniform(state) > transmittance(world, at, world.light.sunward, g)
                out[count + (1 if shaded else 0), pixel] += 1.0 / samples
    return out


@compiled_with_arrays
def backward(
    world: World,
    place: np.ndarray,
    place_edges: np.ndarray,
    direction: np.ndarray,
    direction_edges: np.ndarray,
    samples: int,
    seeds: np.ndarray,
) -> np.ndarray:
    """Mean over samples of each pixel's reflectance factor, and its standard error: [2, pixel].

    Places and directions are drawn evenly from the parallelogram that the two edges [2, 3]
    span about a pixel's own.
    """
    out = np.zeros((2, place.shape[0]))
    state = np.empty(1, np.uint64)
    angles = world.medium.projection.shape[0]
    g, g_sun = np.empty(angles), np.empty(angles)
    for pixel in range(place.shape[0]):
        state[0] = seeds[pixel]
        mean, square = 0.0, 0.0
        for sample in range(samples):
            p, d = _from_pixel(
                place[pixel], place_edges[pixel], direction[pixel], direction_edges[pixel], state
            )
            value = _path(world, p, d, g, g_sun, state)
            change = value - mean
            mean += change / (sample + 1)
            square += change * (value - mean)
        out[0, pixel] = mean
        out[1, pixel] = math.sqrt(square / max(samples - 1, 1) / samples)
    return out
