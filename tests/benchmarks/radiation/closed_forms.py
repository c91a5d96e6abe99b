"""Formulas and conservation laws: what the worst of many cases is off by."""

from collections.abc import Iterator
from functools import partial

import jax.numpy as jnp
import numpy as np

from fynjax.radiation import Accuracy, area_scattering
from tests.benchmarks.radiation.report import Figures, Row, Setting, compare, worst
from tests.radiation.scenes import (
    FINE,
    closure,
    fluxes_of,
    patchy,
    reflectance_of,
    slab,
    solver,
    spherical_gamma,
    towards,
    with_shape,
)
from tests.radiation.test_area_scattering import sphere
from tests.radiation.test_closed_forms import ANGLES, VIEW_AZIMUTH, VIEW_ZENITH, depth, look
from tests.radiation.test_conservation import MANY, white

SUN_ZENITH = (0.0, 37.0, 60.0, 75.0, 83.0)
BALL = Accuracy(lattice=2, sublayers=2)


def slab_formulas(accuracy: Accuracy) -> Figures:
    """Relative errors [-]."""
    figures: Figures = dict.fromkeys(("direct light", "gap", "soil seen once", "seen once"), 0.0)
    views = np.concatenate([VIEW_ZENITH, [80.0]]), np.concatenate([VIEW_AZIMUTH, [33.0]])

    def note(name: str, got: object, want: object) -> None:
        figures[name] = max(figures.get(name, 0.0), worst(got, want) / 100)

    for angle in ANGLES.values():
        for zenith in SUN_ZENITH:
            optics = [(0.4, 0.3, 0.2), (0.0, 0.0, 0.3)]
            light = solver(accuracy)(slab(2.4, optics, zenith, angle=angle))
            gap = np.exp(-depth(angle, zenith, 2.4))
            note("direct light", fluxes_of(light).transmitted_direct, gap)
            up = np.exp(-depth(angle, views[0], 2.4))
            note("gap", look(light, *views).gap[:, 0, 0], up)
            note("soil seen once", reflectance_of(light, *views)[:, 1], 0.3 * gap * up)
    for lai in (0.3, 3.0, 8.0):
        for zenith in SUN_ZENITH[1:]:
            optics = [(0.5, 0.4, 0.2), (0.06, 0.015, 0.0)]
            light = solver(accuracy)(slab(lai, optics, zenith))
            first = np.pi * np.asarray(look(light, *views).sunlit_leaves)[:, :, 0, 0]
            mu0, mu = np.cos(np.deg2rad(zenith)), np.cos(np.deg2rad(views[0]))
            k = 0.5 / mu0 + 0.5 / mu
            turned = np.arccos(np.clip(-towards(*views) @ towards(zenith, 270.0), -1, 1))
            for band, (rho, tau, _) in enumerate(optics):
                gamma = spherical_gamma(turned, rho, tau)
                note("seen once", first[:, band], gamma / (mu0 * mu) * -np.expm1(-k * lai) / k)
    return figures


def soil_closure(accuracy: Accuracy) -> Figures:
    """R(a) = R(0) + P a / (1 - a S): P and S from two soils must give the others."""
    soils = np.array([0.0, 0.2, 1.0, 0.5, 0.85])
    light = solver(accuracy)(slab(2.0, [(0.45, 0.4, a) for a in soils], 35.0, sky=0.2))
    curves = np.asarray(reflectance_of(light, VIEW_ZENITH, VIEW_AZIMUTH))
    gain = curves - curves[:, :1]
    a, b = soils[1:3]
    share = (gain[:, 2] / b - gain[:, 1] / a) / (gain[:, 2] - gain[:, 1])
    slope = gain[:, 1] * (1 - a * share) / a
    want = slope[:, None] * soils / (1 - soils * share[:, None])
    return {"soil closure": worst(gain[:, 3:], want[:, 3:]) / 100}


def thin_limit(accuracy: Accuracy) -> Figures:
    """Black soil: one leaf on the way."""
    lai, rho, tau = 1e-4, 0.45, 0.3
    light = solver(accuracy)(slab(lai, [(rho, tau, 0.0)], 40.0))
    got = np.asarray(reflectance_of(light, VIEW_ZENITH, VIEW_AZIMUTH))[:, 0] / lai
    sunward, views = towards(40.0, 270.0), towards(VIEW_ZENITH, VIEW_AZIMUTH)
    gamma = spherical_gamma(np.arccos(np.clip(-views @ sunward, -1, 1)), rho, tau)
    return {"thin limit": worst(got, gamma / (sunward[2] * views[:, 2])) / 100}


def phase_normalisation() -> float:
    vectors, weight = sphere()
    incoming = jnp.asarray(towards(np.linspace(0, 180, 19), np.linspace(0, 340, 19)))
    off = []
    for angle in ANGLES.values():
        for kind in area_scattering(angle, incoming, jnp.asarray(vectors)):
            got = np.asarray(kind) @ weight / np.pi
            off.append(worst(got, angle.projection(incoming[:, 2])) / 100)
    return max(off)


def reciprocity(accuracy: Accuracy) -> Figures:
    off = []
    pairs = [((20.0, 10.0), (50.0, 130.0)), ((40.0, 300.0), (5.0, 80.0)), ((60.0, 0.0), (30, 90))]
    for one, other in pairs:
        got = []
        for sun, view in ((one, other), (other, one)):
            light = solver(accuracy)(patchy(sun=sun, sky=(0.0, 0.0)))
            at = np.array([float(view[0])]), np.array([float(view[1])])
            got.append(np.asarray(reflectance_of(light, *at))[0])
        off.append(worst(got[0], got[1]))
    return {"reciprocity": max(off)}


def conservation(accuracy: Accuracy) -> Figures:
    energy = max(
        float(np.max(np.abs(closure(solver(accuracy)(patchy(seed=seed, sun=(zenith, 50.0)))) - 1)))
        for seed in range(3)
        for zenith in (33.0, 72.0, 85.0)
    )
    furnace = max(
        float(np.max(np.abs(fluxes_of(solver(accuracy)(white(patchy(), sun))).albedo - 1)))
        for sun in (0.0, 0.7, 1.0)
    )
    return {"energy": energy, "furnace": furnace}


def uniform_light(accuracy: Accuracy) -> Figures:
    light = solver(accuracy)(white(patchy(), 0.0))
    views = np.array([0.0, 30.0, 50.0, 70.0]), np.array([0.0, 50.0, 123.0, 200.0])
    return {"even sky stays even": worst(reflectance_of(light, *views), 1.0) / 100}


def ball_gap(accuracy: Accuracy, finer: int = 0) -> Figures:
    """Mean gap through a ball of ten voxels a radius: 2 [1 - (1 + t) exp(-t)] / t^2. With a
    structure of `finer` voxels along an edge, or none."""
    parts, off = max(4, 2 * finer), {}
    x = (np.arange(24 * parts) + 0.5) / parts - 12
    inside = (x[:, None, None] ** 2 + x[:, None] ** 2 + x**2) < 100
    made = slab(1.0, [(0.0, 0.0, 1.0)], 0.0, layers=24, columns=24)  # sun overhead
    made = type(made)(made.area_density, made.classes, made.ground, made.illumination, 0.1, 0.1)
    for density in (1.0, 4.0, 16.0):
        scene = with_shape(made, inside, finer, density)
        got = 1 - float(fluxes_of(solver(accuracy)(scene)).transmitted_direct[0])
        t = 2 * 1.0 * 0.5 * density
        gap = 2 * (1 - (1 + t) * np.exp(-t)) / t**2
        want = (1 - gap) * np.pi / 2.4**2
        off[f"light stopped by a ball, depth {t:g}"] = worst(got, want)
    return off


def closed_forms(setting: Setting) -> Iterator[Row]:
    """Notes on paper: the tolerance of each is that of the formula's own digits."""
    tolerances: dict[str, float | None] = {
        "direct light": 1e-6, "gap": 1e-6, "soil seen once": 1e-6, "seen once": 1e-4,
        "soil closure": 1e-6, "thin limit": 1e-3,
    }  # fmt: skip
    for measure in (slab_formulas, soil_closure, thin_limit):
        yield from compare("closed form", measure, FINE, tolerances, "rel")
    yield Row("closed form", "phase normalisation", phase_normalisation(), 1e-3, unit="rel")
    yield from compare("closed form", reciprocity, MANY, {"reciprocity": 0.3})
    # Half-empty voxels of its rim stop too much: said of even voxels, asked of a structure.
    ball = {"light stopped by a ball, depth 1": 1.0}
    yield from compare("closed form", ball_gap, BALL, ball)
    ball = {f"light stopped by a ball, depth {t}": 1.0 for t in (1, 4, 16)}
    yield from compare("closed form, structure", partial(ball_gap, finer=4), BALL, ball)


def energy(setting: Setting) -> Iterator[Row]:
    """What comes in is what goes out."""
    accuracy = Accuracy(coarsening=(1, 1), tolerance=1e-7)
    yield from compare(
        "energy, furnace", conservation, accuracy, {"energy": 1e-5, "furnace": 1e-4}, "abs"
    )
    yield from compare("energy, furnace", uniform_light, MANY, {"even sky stays even": 1e-4}, "rel")
