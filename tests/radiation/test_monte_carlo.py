"""A tiny heterogeneous canopy against photons traced one by one (`fynjax.radiation.reference`)."""

import jax.numpy as jnp
import numpy as np
import pytest

from fynjax.canopy import leaf_angle
from fynjax.radiation import Accuracy, Illumination, OpticalClasses, VoxelScene
from tests import reference
from tests.radiation.scenes import fluxes_of, reflectance_of, solver

BANDS = ("red, sun and sky", "near infrared, sun alone")


def clumps(first: str, second: str, parts: int = 1) -> VoxelScene:
    """Two kinds of clump over two kinds of soil, each block of 0.3 m about one optical depth.

    The blocks are cut in `parts` voxels along each edge: the same medium, on a finer grid.
    """
    rng = np.random.default_rng(11)
    density = rng.gamma(0.6, 4.0, (2, 3, 4, 4)) * (rng.random((2, 3, 4, 4)) > 0.45)
    soil = np.where(rng.random((4, 4)) > 0.5, 0.35, 0.1)[None] * np.array([1, 1.3])[:, None, None]
    for axis in (1, 2, 3):
        density = density.repeat(parts, axis)
    return VoxelScene(
        jnp.asarray(density),
        OpticalClasses(
            jnp.array([[0.10, 0.48], [0.05, 0.35]]),
            jnp.array([[0.04, 0.44], [0.01, 0.20]]),
            (leaf_angle(first), leaf_angle(second)),
            (0, 1),
        ),
        jnp.asarray(soil.repeat(parts, 1).repeat(parts, 2)),
        Illumination(
            jnp.array(40.0), jnp.array(65.0), jnp.array([0.7, 1.0]), jnp.array([0.3, 0.0])
        ),
        0.3 / parts,
        0.3 / parts,
    )


@pytest.fixture(
    scope="module",
    params=[
        ("planophile", "spherical"),
        pytest.param(("erectophile", "planophile"), marks=pytest.mark.study),
    ],
)
def both(request):
    scene = clumps(*request.param)
    accuracy = Accuracy(
        lattice=2, sublayers=4, coarsening=(1, 1), levels=4, azimuths=12, tolerance=1e-5
    )
    light = solver(accuracy)(clumps(*request.param, parts=5))
    flux = fluxes_of(light)
    nadir = reflectance_of(light, np.zeros(1), np.zeros(1))[0]
    found = []
    for band in range(2):
        drawn = reference.fluxes(scene, photons=200_000, seed=band, band=band)._asdict()
        drawn.pop("sides")
        drawn["nadir"] = reference.reflectance(
            scene, 0.0, 0.0, photons=200_000, seed=10 + band, band=band
        )
        found.append(drawn)
    return flux, nadir, found


@pytest.mark.slow
@pytest.mark.parametrize("band", range(2), ids=BANDS)
def test_agrees_with_photons(both, band):
    """Within three standard errors (0.1-0.3 %), plus 0.3 % that voxels of 0.2 optical depths
    leave, with one diffuse radiance each."""
    flux, nadir, found = both
    got = {
        "nadir": nadir[band],
        **{name: getattr(flux, name)[band] for name in found[band] if name != "nadir"},
    }
    for name, (mean, error) in found[band].items():
        np.testing.assert_array_less(np.abs(got[name] - mean), 3 * error + 0.003 * mean, name)
