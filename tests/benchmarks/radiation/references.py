"""Slabs and crowns against discrete ordinates, Monte Carlo and published fluxes."""

import json
from collections.abc import Iterator
from functools import lru_cache, partial
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from fynjax.canopy import SphericalLeafAngle, leaf_angle
from fynjax.radiation import Accuracy, Illumination, OpticalClasses, VoxelScene
from tests.benchmarks.radiation.report import Figures, Row, Setting, compare, worst
from tests.radiation.scenes import (
    fluxes_of,
    reflectance_of,
    slab,
    solver,
    views_of_reference,
    with_shape,
)
from tests.radiation.test_reference_scenes import floating_spheres

FLUXES = ("albedo", "transmission_total", "transmission_direct", "absorbed_canopy")

SLAB = Accuracy(coarsening=(1, 2), levels=4, azimuths=4)
"""Cells one layer thin: an LAI of 5 in twenty layers is deep for a view at 75 degrees."""

CROWNS = Accuracy(sublayers=2, levels=4, azimuths=8)


def flux_figures(light: Any, want: dict, figures: Figures) -> None:
    """Enter the errors of the fluxes beyond two standard errors, the worst kept."""
    flux = fluxes_of(light)
    got = (flux.albedo[0], flux.transmitted[0], flux.transmitted_direct[0], flux.absorbed.sum())
    for name, value in zip(FLUXES, got, strict=True):
        found = want[name]
        if found < 1e-9:
            continue
        error = 0.0
        if "photons" in want:
            spread = np.sqrt(found * abs(1 - found) / want["photons"])
            error = 2 * want.get(f"{name}_se", spread)
        label = name.replace("_", " ")
        figures[label] = max(figures.get(label, 0.0), worst(value, found, error))


def view_error(brf: np.ndarray, want: dict, figures: Figures, label: str = "BRF") -> None:
    error = 2 * np.asarray(want.get("brf_se", 0.0))
    figures[label] = max(figures.get(label, 0.0), worst(brf, want["brf"], error))


def slab_figures(cases: list[dict], accuracy: Accuracy, layers: int = 20) -> Figures:
    figures: Figures = {}
    for case in cases:
        kind, optics = case["scene"], case["optics"]
        scene = slab(
            kind["lai"],
            [(optics["rho"], optics["tau"], optics["soil"])],
            case["sza"],
            angle=leaf_angle("spherical" if kind["lad"] == "uniform" else kind["lad"]),
            layers=layers,
        )
        light = solver(accuracy)(scene)
        views = np.array(case["views"], float)
        brf = np.asarray(reflectance_of(light, *views_of_reference(views)))[:, 0]
        view_error(brf, case["result"], figures)
        flux_figures(light, case["result"], figures)
    return figures


def slabs(setting: Setting) -> Iterator[Row]:
    """Homogeneous layers: all views to 75 degrees, fluxes."""
    tolerances: dict[str, float | None] = {"BRF": 0.5}
    tolerances |= dict.fromkeys((name.replace("_", " ") for name in FLUXES), 0.2)
    for name in ("slab_uniform_turbid", "slab_lad_turbid"):
        cases = setting.cases(f"{name}.json")[:: 5 if setting.quick else 1]
        yield from compare(name, partial(slab_figures, cases), SLAB, tolerances)


@lru_cache(maxsize=1)
def _crowns(text: str, voxel: float, finer: int = 0) -> VoxelScene:
    return floating_spheres(json.loads(text), voxel, finer)


def het01_figures(
    cases: list[dict], accuracy: Accuracy, voxel: float = 0.5, finer: int = 0
) -> Figures:
    figures: Figures = {}
    for case in cases:
        light = solver(accuracy)(_crowns(json.dumps(case), voxel, finer))
        views = np.array(case["views"], float)
        brf = np.asarray(reflectance_of(light, *views_of_reference(views)))[:, 0]
        view_error(brf, case["result"], figures)
        flux_figures(light, case["result"], figures)
        lossless = case["optics"]["rho"] + case["optics"]["tau"] > 1 - 1e-6
        if lossless and case["optics"]["soil"] == 1:
            albedo = float(fluxes_of(light).albedo[0])
            figures["conservative: albedo - 1"] = 100 * abs(albedo - 1)
    return figures


def het01(setting: Setting) -> Iterator[Row]:
    """Floating spheres of RAMI, in voxels of half a metre."""
    cases = setting.cases("het01_turbid.json")
    tolerances: dict[str, float | None] = {"BRF": 1.0, "conservative: albedo - 1": 0.01}
    tolerances |= dict.fromkeys((name.replace("_", " ") for name in FLUXES), 1.0)
    voxel = 1.0 if setting.quick else 0.5
    yield from compare("het01_turbid", lambda a: het01_figures(cases, a, voxel), CROWNS, tolerances)
    finer = partial(het01_figures, cases, voxel=1.0, finer=2 if setting.quick else 4)
    yield from compare("het01, 1 m, structure", finer, CROWNS, tolerances)


def with_leaves(scene: VoxelScene, diameter: float) -> VoxelScene:
    """`scene` with round leaves of `diameter` [m]."""
    return eqx.tree_at(
        lambda s: s.classes.leaf_diameter,
        scene,
        jnp.full(1, diameter, scene.area_density.dtype),
        is_leaf=lambda leaf: leaf is None,
    )


def disc_figures(cases: list[dict], accuracy: Accuracy) -> Figures:
    """Principal plane of finite discs; where the sun stands behind the sensor is the peak."""
    figures: Figures = {}
    for case in cases:
        optics, size = case["optics"], 2 * case["scene"]["leaf_radius"]
        if case["scene"]["kind"] == "slab_discs":
            bands = [(optics["rho"], optics["tau"], optics["soil"])]
            # Two metres high, in voxels of 10 cm.
            made = slab(case["scene"]["lai"] / 2, bands, case["sza"], layers=20, columns=4)
            scene = VoxelScene(
                made.area_density, made.classes, made.ground, made.illumination, 0.1, 0.1
            )
            name = "slab"
        else:
            turbid = case["turbid"]
            scene, name = _crowns(json.dumps(turbid), 0.5), "spheres"
        light = solver(accuracy)(with_leaves(scene, size))
        zenith = np.array(case["vz"], float)
        views = np.stack([zenith, 0 * zenith], axis=-1)
        brf = np.asarray(reflectance_of(light, *views_of_reference(views)))[:, 0]
        error = np.abs(brf / case["brf"] - 1) - 2 * np.array(case["brf_se"]) / case["brf"]
        for label, chosen in (("plane", zenith == zenith), ("nadir", zenith == 0)):
            key = f"{name} {label}"
            figures[key] = max(figures.get(key, 0.0), 100 * float(error[chosen].max()), 0.0)
    return figures


def discs(setting: Setting) -> Iterator[Row]:
    """Leaves of finite size: the hot spot."""
    cases = setting.cases("disc_canopies.json")
    for case in cases:
        # The crowns of the discs are those of the turbid case under the same sun and light.
        for turbid in setting.cases("het01_turbid.json"):
            if turbid["optics"] == case["optics"] and turbid["sza"] == case["sza"]:
                case["turbid"] = turbid
    cases = [c for c in cases if c["scene"]["kind"] == "slab_discs" or "turbid" in c]
    tolerances: dict[str, float | None] = {
        "slab plane": 3.0, "slab nadir": 1.5, "spheres plane": 3.0, "spheres nadir": 1.5
    }  # fmt: skip
    accuracy = Accuracy(sublayers=2, coarsening=(1, 2), levels=4, azimuths=4)
    yield from compare("disc_canopies", lambda a: disc_figures(cases, a), accuracy, tolerances)


def open_forest(
    lai: float, crowns: int, seed: int, bands: list[tuple[float, float, float]], zenith: float,
    voxel: float, finer: int = 0,
) -> VoxelScene:  # fmt: skip
    """Spheres of 5 m radius and LAI 5 from 4 to 14 m above ground, thrown without overlap.

    The tile is as large as `crowns` spheres need for the LAI, so that it is exact. With a structure
    of `finer` voxels along an edge, or none.
    """
    side = float(np.sqrt(crowns * np.pi * 25.0 * 5.0 / lai))
    columns = 2 * round(side / voxel / 2)
    width, layers, parts = side / columns, round(14 / voxel), 3 * max(finer, 1)
    rng = np.random.default_rng(seed)
    places: list[np.ndarray] = []
    while len(places) < crowns:
        at = rng.uniform(0, side, 2)
        apart = [np.abs(at - other) for other in places]
        if all(np.hypot(*np.minimum(d, side - d)) >= 10.0 for d in apart):
            places.append(at)
    x = (np.arange(columns * parts) + 0.5) * (width / parts)
    z = (np.arange(layers * parts) + 0.5) * (14 / layers / parts)
    inside = np.zeros((len(z), len(x), len(x)), bool)
    for at in places:
        dx, dy = (np.abs(x - a) for a in at)
        dx, dy = np.minimum(dx, side - dx), np.minimum(dy, side - dy)
        flat = dy[:, None] ** 2 + dx**2
        inside |= (z - 9.0)[:, None, None] ** 2 + flat < 25.0
    # The staircase of points must not change the area planted.
    volume = inside.mean() * side**2 * 14
    density = 0.75 * (crowns * 4 / 3 * np.pi * 125) / volume
    rho, tau, soil = (jnp.asarray(a, jnp.float32) for a in np.array(bands).T)
    ones = jnp.ones(len(bands), jnp.float32)
    made = VoxelScene(
        jnp.zeros((1, layers, columns, columns), jnp.float32),
        OpticalClasses(rho[None], tau[None], (SphericalLeafAngle(),), (0,)),
        soil,
        Illumination(jnp.float32(zenith), jnp.float32(270.0), ones, 0 * ones),
        width,
        14.0 / layers,
    )
    return with_shape(made, inside, finer, density)


def rami_figures(
    reference: dict, accuracy: Accuracy, seeds: int, voxel: float = 0.5, finer: int = 0
) -> tuple[Figures, dict[str, Figures]]:
    """Largest absolute differences of the mean over layouts, per sun; and each quantity's mean
    signed difference."""
    leaf, soils = reference["scene"]["leaf"], reference["scene"]["soil"]
    names = [(band, soil) for band in leaf for soil in soils[band]]
    bands = [(leaf[b]["rho"], leaf[b]["tau"], soils[b][s]) for b, s in names]
    figures: Figures = {}
    signed: dict[str, Figures] = {}
    for index, zenith in enumerate((27.0, 60.0, 83.0)):
        off: dict[str, list[float]] = {}
        for key, crowns in (("050", 13), ("150", 38)):
            lai = reference["scene"]["lai"][key]
            total = np.zeros((3, len(bands)))
            for seed in range(seeds):
                scene = open_forest(lai, crowns, seed, bands, zenith, voxel, finer)
                flux = fluxes_of(solver(accuracy)(scene))
                total += np.stack([flux.absorbed.sum(axis=1), flux.albedo, flux.transmitted])
            for b, (band, soil) in enumerate(names):
                want = reference["published"][f"{band}_{key}_{soil}"]
                for row, flux_name in enumerate(("fabs", "fref", "ftran")):
                    difference = total[row, b] / seeds - want[flux_name][index]
                    off.setdefault(flux_name, []).append(float(difference))
        figures[f"sun {zenith:g}"] = max(abs(d) for list_ in off.values() for d in list_)
        signed[f"sun {zenith:g}"] = {k: float(np.mean(v)) for k, v in off.items()}
    return figures, signed


def rami4pilps(setting: Setting) -> Iterator[Row]:
    """Open forest canopy: published fluxes, layouts of our own."""
    with open(setting.data / "rt" / "rami4pilps_ofc.json", encoding="utf-8") as file:
        reference = json.load(file)
    seeds, voxel = (1, 1.0) if setting.quick else (3, 0.5)
    tolerances: dict[str, float | None] = {"sun 27": 0.006, "sun 60": 0.02, "sun 83": 0.02}
    yield from compare(
        "rami4pilps_ofc",
        lambda a: rami_figures(reference, a, seeds, voxel)[0],
        CROWNS,
        tolerances,
        unit="abs",
    )
    yield from compare(
        "rami4pilps, 1 m, structure",
        lambda a: rami_figures(reference, a, seeds, 1.0, 2 if setting.quick else 4)[0],
        CROWNS,
        tolerances,
        unit="abs",
    )
