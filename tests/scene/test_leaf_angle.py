"""The mean leaf angle of a species as a parameter: what it does to light, cover and structure."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import fynjax as fx
from fynjax._core.errors import InputError
from fynjax._core.precision import double_precision
from fynjax.canopy import (
    FORMS,
    PlantMesh,
    TiltedLeafAngle,
    leaf_angle,
    plant_model_from_mesh,
    table1_2006,
)
from fynjax.metrics.structure import StructureSettings
from fynjax.radiation import canopy_reflectance
from fynjax.scene import Placement, aim, named_values, scene_structure, with_values
from fynjax.scene._optics import seen_from_above
from fynjax.sensors import Frame, Pose, shipped_sensor
from tests.scene.plots import EXACT, TAXA, small_parameters, small_plot

ERICA = f"species.{TAXA[0]}.leaf_angle"


def inclined(*degrees):
    """Parameters of the small plot, its leaves inclined so [degrees]."""
    parameters = small_parameters()
    species = dataclasses.replace(parameters.species, leaf_angle=jnp.asarray(degrees))
    return dataclasses.replace(parameters, species=species)


OF_FORMS = [float(leaf_angle(name).mean_angle) for name in ("spherical", "erectophile")]


def oblique(tilt=35.0):
    """The means of the bands of a frame that looks down from the south."""
    sensor = dataclasses.replace(shipped_sensor("mavic_3m"), psf=None)
    away = 20.0 * np.tan(np.radians(tilt))
    frame = Frame(Pose([0.8, 0.8 - away, 20.0], 0.0, tilt), name="aside")
    camera = aim(small_plot(), small_parameters(), sensor, Placement(None, 0.2, frame=frame),
                 accuracy=EXACT)  # fmt: skip
    scene = small_plot()
    return lambda parameters: camera.observe(scene, parameters).reflectance.mean(axis=(1, 2))


def test_leaves_at_the_mean_of_their_form_look_as_before():
    look = oblique()
    same, flat = inclined(*OF_FORMS, 57.3), inclined(20.0, OF_FORMS[1], 57.3)
    before = look(small_parameters())
    np.testing.assert_allclose(look(same), before, rtol=2e-5)
    assert np.abs(np.asarray(look(flat)) / before - 1.0).max() > 0.02


@double_precision
def test_slopes_of_an_oblique_frame_are_those_of_differences():
    look, base = oblique(), inclined(40.0, 60.0, 57.3)

    second = f"species.{TAXA[1]}.leaf_angle"

    @jax.jit
    def of_angles(angles):
        return look(with_values(base, TAXA, {ERICA: angles[0], second: angles[1]}))

    at = jnp.array([40.0, 60.0])
    found = jax.jit(jax.jacrev(of_angles))(at)
    for i, step in enumerate(0.05 * np.eye(2)):
        differences = (of_angles(at + step) - of_angles(at - step)) / 0.1
        np.testing.assert_allclose(found[:, i], differences, rtol=1e-4, atol=1e-9)
    assert np.abs(found[3]).min() > 1e-5


def test_flat_leaves_hide_more_of_the_ground():
    """From straight above a leaf hides the cosine of its angle of its area."""
    scene, gaps, through = small_plot(), [], []
    for mean in (20.0, 50.0, 80.0):
        parameters = inclined(mean, mean, 57.3)
        gaps.append(float(scene.gap_fraction(parameters)))
        settings = StructureSettings()
        found = scene_structure(scene, parameters, ["gap_fraction"], settings, grain=0.4, pulses=50)
        through.append(float(found[0]))
        seen = np.asarray(seen_from_above(scene.species, parameters.species.leaf_angle))
        for i, name in enumerate(("spherical", "erectophile")):
            (angle,) = TiltedLeafAngle.to_means([leaf_angle(name)], jnp.array([mean]))
            vectors, weight = angle.normals()
            assert seen[i] == pytest.approx(float(weight @ vectors[:, 2]), rel=1e-3)
        np.testing.assert_allclose(seen[2:], 0.5, rtol=1e-5)  # wood and petals face all ways
    for share in (gaps, through):
        assert share[0] < share[1] - 0.01 < share[2] - 0.02


@pytest.mark.parametrize("mean", [25.0, 70.0])
def test_light_scattered_once_is_that_of_a_turbid_medium(mean):
    """Against leaves drawn at random: both ways through them and once from a leaf, dark enough
    that little light is scattered twice (Ross 1981)."""
    random, number = np.random.default_rng(2), 400_000
    (angle,) = TiltedLeafAngle.to_means([leaf_angle("erectophile")], jnp.array([mean]))
    grid = (np.arange(3000) + 0.5) * (0.5 * np.pi / 3000)
    density = np.asarray(leaf_angle("erectophile").inclination_density(jnp.asarray(grid)), float)
    density = density * np.exp(float(angle.tilt) * grid)
    lean = random.choice(grid, number, p=density / density.sum())
    turn = random.uniform(0.0, 2.0 * np.pi, number)
    normal = np.stack([np.sin(lean) * np.cos(turn), np.sin(lean) * np.sin(turn), np.cos(lean)])

    def towards(zenith, azimuth):
        z, a = np.radians([zenith, azimuth])
        return np.array([np.sin(z) * np.cos(a), np.sin(z) * np.sin(a), np.cos(z)])

    rho, tau, area = 0.004, 0.002, 1.5
    for view, turned in ((0.0, 0.0), (50.0, 180.0), (50.0, 60.0)):
        sun, eye = towards(35.0, 0.0), towards(view, turned)
        lit, seen = sun @ normal, eye @ normal
        way = np.abs(lit).mean() / sun[2] + np.abs(seen).mean() / eye[2]
        sent = np.abs(lit * seen) * np.where(lit * seen > 0.0, rho, tau)
        want = sent.mean() / (sun[2] * eye[2]) * (1.0 - np.exp(-area * way)) / way
        found = canopy_reflectance(
            np.array([rho]), np.array([tau]), area, soil=0.0, leaf_angles=angle,
            sun_zenith=35.0, view_zenith=view, relative_azimuth=turned, hot_spot=0.0,
        )  # fmt: skip
        assert float(found[0]) == pytest.approx(want, rel=0.01)


def test_a_table_says_the_mean_angle_and_a_fit_may_have_it_free():
    rows = table1_2006().iloc[:3].assign(leaf_angle_deg=[35.0, None, None])
    scene = fx.Scene.from_table(rows, size=1.0, voxel=0.5)
    values = named_values(scene.parameters, scene.taxa)
    found = [float(values[f"species.{taxon}.leaf_angle"]) for taxon in scene.taxa]
    usual = [float(leaf_angle(fx.canopy.FORMS[form].leaf_angle).mean_angle) for form in scene.forms]
    assert found == pytest.approx([35.0, *usual[1:]], abs=0.01)
    space = fx.free(scene, "species.*.leaf_angle")
    assert space.names == tuple(f"species.{taxon}.leaf_angle" for taxon in scene.taxa)
    np.testing.assert_allclose(space.prior_sd, 12.0, rtol=1e-3)
    without = fx.Scene.from_table(table1_2006().iloc[:3], size=1.0, voxel=0.5)
    assert without.parameters.species.leaf_angle is None
    with pytest.raises(InputError, match=r"leaf_angle_deg"):
        fx.Scene.from_table(rows.assign(leaf_angle_deg=91.0), size=1.0, voxel=0.5)


def blades(upright=True):
    """A mesh of narrow blades that all stand upright, or lie."""
    random, vertices, faces = np.random.default_rng(0), [], []
    for _ in range(40):
        x, y, turn = *random.uniform(-0.15, 0.15, 2), random.uniform(0.0, np.pi)
        along = np.array([np.cos(turn), np.sin(turn), 0.0]) * 0.02
        up = np.array([0.0, 0.0, 0.4]) if upright else np.array([-along[1], along[0], 0.0]) * 5.0
        foot = np.array([x, y, 0.0 if upright else random.uniform(0.0, 0.3)])
        n = len(vertices)
        vertices += [foot, foot + along, foot + along + up, foot + up]
        faces += [(n, n + 1, n + 2), (n, n + 2, n + 3)]
    mesh = PlantMesh(np.array(vertices), np.array(faces), np.zeros(len(faces), int), ("leaf",))
    return plant_model_from_mesh(mesh, 200)


@pytest.mark.parametrize("upright", [True, False])
def test_a_mesh_whose_leaves_lie_one_way_stays_as_it_is_where_another_species_is_stated(upright):
    rows = table1_2006().to_dict("records")[:2]
    mesh = {rows[1]["taxon"]: blades(upright)}
    each = []
    own = float(leaf_angle(FORMS[rows[0]["growth_form"]].leaf_angle).mean_angle)
    for angle in (None, own):
        rows[0]["leaf_angle_deg"] = angle
        scene = fx.Scene.from_table(rows, size=1.0, voxel=0.25, structure="even", meshes=mesh)
        image = fx.observe(scene, "mavic_3m", pixel=0.25).reflectance
        gap = float(scene.gap_fraction(scene.parameters))
        each.append((*np.asarray(image).mean(axis=(1, 2)), gap))
    np.testing.assert_allclose(each[1], each[0], rtol=0.02)
    rows[0]["leaf_angle_deg"], rows[1]["leaf_angle_deg"] = None, 40.0
    with pytest.raises(InputError, match=r"its mesh can have, from \d+ to \d+ degrees, but got 40"):
        fx.Scene.from_table(rows, size=1.0, voxel=0.25, structure="even", meshes=mesh)


@pytest.mark.parametrize("tilt", [-60.0, 60.0])
def test_the_steepest_tilt_has_a_density_in_single_precision(tilt):
    tilted = TiltedLeafAngle(leaf_angle("spherical"), jnp.float32(tilt))
    with jax.enable_x64(False):
        at = jnp.linspace(0.001, 1.57, 4000, dtype=jnp.float32)
        density = np.asarray(tilted.inclination_density(at), float)
    assert np.isfinite(density).all()
    assert np.trapezoid(density, np.asarray(at, float)) == pytest.approx(1.0, abs=0.05)
