"""What an image tells of a plot whose plants are known: the experiment of LESS 3D-Diff.

    python -m tests.benchmarks.known_plants --size 3 --pixels 0.05 0.5 1.5

A virtual plot with the plants of the example plot, all of them known; its truth has other leaves,
ground and dead tissue, drawn from the prior. Printed for each size of pixel, without noise and with
noise of 1 %: root mean square error of the reflectance and transmittance of the leafy shoots of the
classes that the plot has, of the ground's reflectance, the relative difference of the images,
coverage of the 90 % intervals of the parameters, and CPU time. The same with the diameters, heights
and leaf areas of all species free (`--structure`). Qi et al. (2026, Remote Sensing of Environment
333:115115) find 0.015 at worst, and images within 0.07 % at 5 cm and 1.4 % at 2.5 m.
"""

import time

import jax.numpy as jnp
import numpy as np

from fynjax.app.assembly import aim_without_air, build_plot, plot_problem
from fynjax.app.io.plot import drone_sensor
from fynjax.inversion import ImageView, Pixels, Problem, fit, pixel_data
from fynjax.inversion._known_plants import PixelModel
from fynjax.scene import Crowns, hard_instances
from fynjax.sensors import Gains
from tests.benchmarks._measure import example_plot, options, peak_gib

OPTICS = (
    *(f"species.*.leaf.{name}" for name in ("structure", "chlorophyll", "dry_matter")),
    *("species.*.dead_fraction", "ground.brightness", "ground.litter_fraction"),
    "ground.wood_brightness",
)
STRUCTURE = tuple(f"species.*.{kind}" for kind in ("diameter", "height", "leaf_area_index"))
PRIORS = {"*.diameter": 0.1, "*.height": 0.1, "*": 0.3}
EXACT = 1e-4
"""Error of a pixel without noise that the search assumes: of float32, and a little more [-]."""


def known_plot(size, free, tiny):
    """The example plot, smaller, its plants as a table of crowns has them."""
    plot = example_plot(size, tiny)
    plot = plot.replace(calibration=plot.calibration.replace(free=free, priors=PRIORS))
    there = hard_instances(*build_plot(plot))
    foot = np.stack([there.x, there.y], axis=1)
    crowns = Crowns(there.species, foot, there.diameter, there.height)
    return plot.replace(known_crowns=crowns)


def optics(model, values):
    """Reflectance and transmittance of the classes and reflectance of the ground, [class, band]."""
    voxels = model._voxels(values)
    return voxels.classes.reflectance, voxels.classes.transmittance, voxels.ground[None]


def error(one, other):
    return float(np.sqrt(np.mean((np.asarray(one) - np.asarray(other)) ** 2)))


def main(arguments=None):
    """Print the table."""
    parser = options(__doc__)
    parser.add_argument("--size", type=float, default=5.0)
    parser.add_argument("--pixels", type=float, nargs="+", default=[0.05, 0.5, 2.5])
    parser.add_argument("--noise", type=float, nargs="+", default=[0.0, 0.01])
    parser.add_argument("--structure", action="store_true")
    parser.add_argument("--seed", type=int, default=1)
    chosen = parser.parse_args(arguments)
    if chosen.tiny:
        chosen.size, chosen.pixels, chosen.noise = 1.0, [0.1], [0.01]
    free = OPTICS + STRUCTURE * chosen.structure
    plot = known_plot(chosen.size, free, chosen.tiny)
    problem = plot_problem(plot, None, seed=0)
    space, scene = problem.free, problem.scene
    random = np.random.default_rng(chosen.seed)
    truth = space.physical(jnp.asarray(random.normal(size=len(space.names)).clip(-2.0, 2.0)))
    print(f"{chosen.size:g} m, {len(scene.planting.foot)} plants, {len(space.names)} parameters")
    for pixel in chosen.pixels:
        drone = drone_sensor(plot)
        camera = aim_without_air(plot, scene, scene.parameters, drone, pixel=pixel)
        view = ImageView((), camera, Gains(1e-5))
        model = PixelModel(scene, scene.parameters, space.names, camera, 1)
        image = np.asarray(model.image(truth), float)
        for noise in chosen.noise:
            measured = image * (1.0 + noise * random.normal(size=image.shape))
            began = time.process_time()
            pixels = Pixels(measured, 1, max(noise, EXACT))
            data = pixel_data(pixels, drone.bands.names, lambda *_, view=view: view)
            found = fit(Problem(scene, data, space, error="none"))
            seconds = time.process_time() - began
            result = found.fit
            estimate = result.estimate
            parts = zip(optics(model, estimate), optics(model, truth))
            errors = [error(a, b) for a, b in parts]
            before = [error(a, b) for a, b in zip(optics(model, space.prior), optics(model, truth))]
            low, high = (np.asarray(q) for q in result.quantiles(0.05, 0.95))
            inside = np.mean((np.asarray(truth) >= low) & (np.asarray(truth) <= high))
            differ = 100.0 * error(found.blocks.with_error, image) / image.mean()
            known = np.mean(np.asarray(result.constrained))
            optical = "; ".join(
                f"{name} {after:.1e} ({start:.1e} before)"
                for name, after, start in zip(
                    ("reflectance", "transmittance", "ground"), errors, before
                )
            )
            print(
                f"pixel {pixel:g} m, noise {100 * noise:g} %: RMSE of {optical}; image "
                f"{differ:.1e} %; in the 90 % intervals {inside:.2f}; prior variance removed "
                f"{known:.2f}; misfit {found.misfit:.0f} of {found.degrees}; {result.explanation} "
                f"{seconds:.0f} CPU s",
                flush=True,
            )
    print(f"peak memory {peak_gib():.1f} GiB")


if __name__ == "__main__":
    main()
