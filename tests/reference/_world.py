"""A scene as plain arrays that compiled code can walk through, in one band."""

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from fynjax._core.errors import InputError
from fynjax.canopy import AbstractLeafAngle
from fynjax.radiation._check import check_scene
from fynjax.radiation._scene import VoxelScene

_CELLS = 720  # of inclination
_ZENITHS = 513
_AZIMUTHS = 100


class Medium(NamedTuple):
    """The turbid medium. Areas are one-sided, per volume [m2 m-3]."""

    area: np.ndarray
    """[z, y, x, class]"""
    by_angle: np.ndarray
    """[z, y, x, angle]"""
    angle_of_class: np.ndarray
    projection: np.ndarray
    """G by zenith angle, even steps from 0 to 90 degrees: [angle, zenith]"""
    cumulative: np.ndarray
    """Distribution function of the inclination, even cells: [angle, cell + 1]"""
    rho: np.ndarray
    tau: np.ndarray


class Ground(NamedTuple):
    """The ground's amplitude [y, x], its angular shape, and its height [y, x]."""

    amplitude: np.ndarray
    lambertian: bool
    k: float
    theta: float
    rho_c: float
    uneven: bool
    terrain: np.ndarray
    lowest: float
    highest: float
    spacing: float
    size: tuple[float, float]


class Light(NamedTuple):
    """Sun and sky; the irradiance of both together is one."""

    sunward: tuple[float, float, float]
    sun: float
    sky: float
    even: bool
    """Whether the sky is the same from everywhere."""
    pattern: np.ndarray
    """Radiance over that of an even sky of the same irradiance: [zenith, azimuth]"""


class Discs(NamedTuple):
    """Round leaves, with copies of those that cross a periodic side, listed by cell."""

    active: bool
    centre: np.ndarray
    normal: np.ndarray
    radius: np.ndarray
    owner: np.ndarray
    first: np.ndarray
    """Where in `member` the list of each cell starts: [cell + 1]"""
    member: np.ndarray


class World(NamedTuple):
    """What rays cross: cells from `low`, and what is in them."""

    periodic: bool
    low: tuple[float, float, float]
    cell: tuple[float, float, float]
    cells: tuple[int, int, int]
    """How many along x, y, z."""
    high: tuple[float, float, float]
    medium: Medium
    ground: Ground
    light: Light
    discs: Discs


def plain(values: Any, kind: Any = np.float64) -> np.ndarray:
    """An array of one layout that may be written to: compiled code is compiled once for all."""
    return np.array(values, kind, order="C")


def build_world(scene: VoxelScene, band: int) -> World:
    """The turbid medium of `scene`; `InputError` if it is none."""
    check_scene(scene)
    if scene.structure is not None:
        raise InputError(
            "the Monte Carlo traces voxels filled evenly, but the scene has a `structure`: give "
            "it the scene on the structure's own voxels"
        )
    classes = scene.classes
    n_band = classes.reflectance.shape[-1]
    if not 0 <= band < n_band:
        raise InputError(
            f"`band` must be in [0, {n_band}), counted from zero, but is {band}; the scene has "
            f"{n_band} bands"
        )
    nz, ny, nx = scene.shape
    area = np.asarray(scene.area_density, np.float64)
    by_angle = np.zeros((len(classes.angles), nz, ny, nx))
    for owner, of_class in zip(classes.angle_of_class, area):
        by_angle[owner] += of_class
    tables = [_angle_tables(angle) for angle in classes.angles]
    medium = Medium(
        plain(np.moveaxis(area, 0, -1)),
        plain(np.moveaxis(by_angle, 0, -1)),
        plain(classes.angle_of_class, np.int64),
        np.array([projection for projection, _ in tables]),
        np.array([cumulative for _, cumulative in tables]),
        plain(np.asarray(classes.reflectance)[:, band]),
        plain(np.asarray(classes.transmittance)[:, band]),
    )
    edge = float(scene.horizontal)
    high = (nx * edge, ny * edge, nz * float(scene.vertical))
    none = np.zeros((0, 3))
    return World(
        scene.boundary == "periodic",
        (0.0, 0.0, 0.0),
        (edge, edge, float(scene.vertical)),
        (nx, ny, nz),
        high,
        medium,
        _ground(scene, band),
        _light(scene, band),
        Discs(
            False,
            none,
            none,
            np.zeros(0),
            np.zeros(0, np.int64),
            np.zeros(1, np.int64),
            np.zeros(0, np.int64),
        ),
    )


def _ground(scene: VoxelScene, band: int) -> Ground:
    _, ny, nx = scene.shape
    shape = scene.ground_shape
    k, theta, rho_c = 1.0, 0.0, 1.0
    if shape is not None:
        k, theta, rho_c = (
            float(np.asarray(value)[band]) for value in (shape.k, shape.theta, shape.rho_c)
        )
    terrain = np.zeros((ny, nx))
    if scene.terrain is not None:
        terrain = plain(scene.terrain)
        if terrain.shape != (ny, nx):
            raise InputError(
                f"`terrain` must have shape (y, x) = {(ny, nx)}, but has {terrain.shape}"
            )
        if not (np.isfinite(terrain).all() and 0 <= terrain.min() <= terrain.max() < scene.height):
            raise InputError(
                f"`terrain` must be heights within the grid, in [0, {scene.height:g}) m, but "
                f"runs from {terrain.min():g} to {terrain.max():g}: is it above sea level?"
            )
    return Ground(
        plain(np.asarray(scene.ground_map)[band]),
        shape is None,
        k,
        theta,
        rho_c,
        scene.terrain is not None,
        terrain,
        float(terrain.min()),
        float(terrain.max()),
        float(scene.horizontal),
        (nx * float(scene.horizontal), ny * float(scene.horizontal)),
    )


def _light(scene: VoxelScene, band: int) -> Light:
    light = scene.illumination
    sun, sky = float(light.sun[band]), float(light.sky[band])
    if not (sun >= 0 and sky >= 0 and sun + sky > 0):
        raise InputError(
            "`illumination.sun` and `illumination.sky` must not be negative, nor both zero, but "
            f"are {sun:g} and {sky:g} in band {band}"
        )
    pattern = np.ones((2, 1))
    if light.sky_pattern is not None:
        given = np.asarray(light.sky_pattern, np.float64)
        given = given[band] if given.ndim == 3 else given
        # Irradiance of the pattern, bilinear between its points, by the midpoint rule.
        zenith = (np.arange(1800) + 0.5) / 1800
        place = zenith * (given.shape[0] - 1)
        below = np.minimum(place.astype(int), given.shape[0] - 2)
        ring = given.mean(axis=1)
        radiance = ring[below] + (place - below) * (ring[below + 1] - ring[below])
        pattern = given / (radiance * np.sin(np.pi * zenith)).mean() / (0.5 * np.pi)
    return Light(
        towards(float(light.sun_zenith), float(light.sun_azimuth)),
        sun / (sun + sky),
        sky / (sun + sky),
        light.sky_pattern is None,
        plain(pattern),
    )


def towards(zenith: float, azimuth: float) -> tuple[float, float, float]:
    """Unit vector towards angles in degrees, azimuth clockwise from north (y)."""
    z, a = np.deg2rad(zenith), np.deg2rad(azimuth)
    return float(np.sin(z) * np.sin(a)), float(np.sin(z) * np.cos(a)), float(np.cos(z))


def _angle_tables(angle: AbstractLeafAngle) -> tuple[np.ndarray, np.ndarray]:
    """G by zenith angle, and the distribution function of the inclination, both from the density
    at the middle of even cells of inclination."""
    inclination = (np.arange(_CELLS) + 0.5) * (0.5 * np.pi / _CELLS)
    share = np.asarray(angle.inclination_density(jnp.asarray(inclination)), np.float64)
    share = share / share.sum()
    turn = np.cos((np.arange(_AZIMUTHS) + 0.5) * (np.pi / _AZIMUTHS))
    upright, lying = np.sin(inclination)[:, None] * turn, np.cos(inclination)[:, None]
    zenith = np.linspace(0.0, 0.5 * np.pi, _ZENITHS)
    projection = [
        float(share @ np.abs(np.cos(z) * lying + np.sin(z) * upright).mean(axis=1)) for z in zenith
    ]
    return np.array(projection), np.concatenate([[0.0], np.cumsum(share)])
