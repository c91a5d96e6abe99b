"""Programs of images that are compiled beforehand and kept as bytes."""

import dataclasses
import os
import subprocess
import sys

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import fynjax as fx
from fynjax._core.errors import InputError, MissingExtraError
from fynjax.canopy import table1_2006
from fynjax.radiation import Accuracy
from fynjax.scene import _program

MADE = 'fx.Scene.from_table(table1_2006()[:2], size=1.0, voxel=0.25, structure="even", seed={})'
CAMERA = {"pixel": 0.25, "point_spread": False}


def plot(seed=0, rows=slice(2)):
    return fx.Scene.from_table(
        table1_2006()[rows], size=1.0, voxel=0.25, structure="even", seed=seed
    )


@pytest.fixture(scope="module")
def scene():
    return plot()


@pytest.fixture(scope="module")
def program(scene):
    return fx.compile(scene, "mavic_3m", **CAMERA)


@pytest.fixture(scope="module")
def kept(program):
    return program.to_bytes()


def observed(scene, parameters=None):
    return fx.observe(scene, "mavic_3m", parameters=parameters, **CAMERA).reflectance


def test_a_program_gives_the_image_of_other_parameters_and_seeds(scene, program):
    other = plot(1)
    for of in (scene, other):
        np.testing.assert_allclose(program(of), observed(of), rtol=1e-5)
    where = lambda p: p.leaf.chlorophyll  # noqa: E731
    darker = eqx.tree_at(where, scene.parameters, 2.0 * where(scene.parameters))
    found = program(scene, darker)
    np.testing.assert_allclose(found, observed(scene, darker), rtol=1e-5)
    assert np.abs(found - program(scene)).max() > 1e-3
    assert program.bands == ("green", "red", "red_edge", "nir")


def test_a_program_follows_the_sun(scene, program):
    low = scene.scaled({"light.sun_zenith": 1.5}).parameters
    assert np.abs(program(scene, low) - program(scene)).max() > 1e-3
    np.testing.assert_allclose(program(scene, low), observed(scene, low), rtol=1e-5)


def test_value_and_slope_are_of_one_stand(scene, program):
    """Of a loss that bends both belong to the stand in expectation: by all parameters as
    `fx.observe` has them, by leaves alone as differences of that stand."""
    stand = scene.expected()
    assert np.abs(program(stand) - program(scene)).max() > 1e-3

    def loss(image):
        return ((image[3] - 0.1) ** 2).mean()

    value, slope = jax.value_and_grad(lambda p: loss(program(scene, p)))(scene.parameters)
    real = jax.value_and_grad(lambda p: loss(observed(scene, p)))(scene.parameters)
    assert float(value) == pytest.approx(float(real[0]), rel=1e-5)
    for a, b in zip(jax.tree.leaves(slope), jax.tree.leaves(real[1]), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-4, atol=1e-6 * np.abs(b).max())

    def by_leaves(content):
        where = lambda p: p.leaf.dry_matter  # noqa: E731
        return loss(program(scene, eqx.tree_at(where, scene.parameters, content)))

    content = scene.parameters.leaf.dry_matter
    value, slope = jax.value_and_grad(by_leaves)(content)
    assert float(value) == pytest.approx(float(loss(program(stand))), rel=1e-5)
    step = 0.05
    more, less = (
        float(loss(program(stand, eqx.tree_at(
            lambda p: p.leaf.dry_matter, scene.parameters, (1.0 + one) * content
        ))))
        for one in (step, -step)
    )  # fmt: skip
    assert float(slope @ content) == pytest.approx((more - less) / (2 * step), rel=0.01)


def test_an_open_plot_has_room_for_a_sun_a_little_lower(scene):
    open_plot = dataclasses.replace(scene, boundary="open")
    program = fx.compile(open_plot, "mavic_3m", **CAMERA)
    at = lambda zenith: eqx.tree_at(  # noqa: E731
        lambda p: p.light.sun_zenith, open_plot.parameters, jnp.asarray(zenith)
    )
    sun = float(open_plot.parameters.light.sun_zenith)
    assert program.lowest == pytest.approx(sun + 5.0)
    lower = at(sun + 4.0)
    np.testing.assert_allclose(program(open_plot, lower), observed(open_plot, lower), rtol=1e-3)
    with pytest.raises(InputError, match="sun at most"):
        program(open_plot, at(sun + 6.0))
    with pytest.raises(InputError, match="sun at most"):
        jax.grad(lambda p: program(open_plot, p).sum())(at(sun + 6.0))


@pytest.mark.parametrize(
    ("sun", "accuracy", "lowest"), [(86.0, None, 86.0), (30.0, Accuracy(margin=9), 90.0)]
)
def test_what_a_program_has_room_for(scene, sun, accuracy, lowest):
    """A sun below all that there is room for is that of `fx.observe`; a stated margin is the
    user's word."""
    zenith = lambda s: s.parameters.light.sun_zenith  # noqa: E731
    low = eqx.tree_at(zenith, dataclasses.replace(scene, boundary="open"), jnp.asarray(sun))
    assert _program._lowest(low, accuracy=accuracy) == pytest.approx(lowest)
    assert _program._lowest(scene, accuracy=None) == 90.0


@pytest.mark.parametrize("name", ["parameters", "noise", "seed"])
def test_what_each_call_has_is_refused(scene, name):
    with pytest.raises(InputError, match=f"no `{name}` of a program"):
        fx.compile(scene, "mavic_3m", **CAMERA, **{name: None})


def test_another_terrain_is_refused(scene):
    """Cameras are aimed by its heights when a program is compiled."""
    grid = scene.class_grid.shape
    first, other = (
        _program._given(dataclasses.replace(scene, terrain=h * np.ones(grid[:2][::-1])), None)[1]
        for h in (0.1, 0.2)
    )
    assert first != other
    flat = dataclasses.replace(scene, terrain=np.zeros(grid[:2][::-1]))
    with pytest.raises(InputError, match="`terrain` must be known"):
        eqx.filter_jit(lambda s: _program._given(s, None)[0])(flat)


def test_bytes_give_image_and_gradient_without_tracing(scene, kept, monkeypatch):
    def traced(*_):
        raise AssertionError("traced")

    mean = lambda image: image[3].mean()  # noqa: E731
    real = jax.grad(lambda p: mean(observed(scene, p)))(scene.parameters)
    monkeypatch.setattr(_program, "_observe_with", traced)
    again = fx.Program.from_bytes(kept)
    found = jax.grad(lambda p: mean(again(scene, p)))(scene.parameters)
    for a, b in zip(jax.tree.leaves(found), jax.tree.leaves(real), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-4, atol=1e-6 * np.abs(b).max())
    assert np.abs(found.leaf.chlorophyll).max() > 0.0


def test_another_process_knows_the_shapes_of_a_scene(scene, program, kept, tmp_path):
    (tmp_path / "kept").write_bytes(kept)
    lines = (
        "import pathlib, jax, fynjax as fx",
        "from fynjax.canopy import table1_2006",
        "program = fx.Program.from_bytes(pathlib.Path('kept').read_bytes())",
        f"scene = {MADE.format(0)}",
        "slope = jax.grad(lambda p: program(scene, p)[3].mean())(scene.parameters)",
        "print(float(program(scene).sum()), float(slope.leaf.dry_matter.sum()))",
    )
    run = [sys.executable, "-c", "\n".join(lines)]
    told = {
        wide: subprocess.run(
            run, cwd=tmp_path, capture_output=True, text=True,
            env=os.environ | {"JAX_ENABLE_X64": wide},
        )
        for wide in ("1", "0")
    }  # fmt: skip
    # The session computes in 64 bits.
    assert "InputError: expected jax_enable_x64" in told["0"].stderr
    told = told["1"]
    assert told.returncode == 0, told.stderr
    slope = jax.grad(lambda p: program(scene, p)[3].mean())(scene.parameters)
    real = float(program(scene).sum()), float(slope.leaf.dry_matter.sum())
    assert [*map(float, told.stdout.split())] == pytest.approx(real, rel=1e-4)


@pytest.mark.parametrize("rows", [slice(2, 4), slice(1)])
def test_another_table_is_refused(program, rows):
    with pytest.raises(InputError, match="terrain or settings of this one are others"):
        program(plot(rows=rows))


def test_another_number_of_plants_is_refused(scene, program):
    fewer = table1_2006()[:2]
    fewer["cover_percent"] = 0.3 * fewer["cover_percent"]
    other = fx.Scene.from_table(fewer, size=1.0, voxel=0.25, structure="even")
    with pytest.raises(InputError, match="numbers of plants of this one are others"):
        program(other)
    other = "open" if scene.boundary == "periodic" else "periodic"
    with pytest.raises(InputError, match="settings of this one are others"):
        program(dataclasses.replace(scene, boundary=other))


def test_with_room_for_plants_it_is_of_other_names_and_covers(scene):
    other = table1_2006()[:2]
    other["cover_percent"] = 0.95 * other["cover_percent"]
    other["taxon"] += " minor"
    like = fx.Scene.from_table(other, size=1.0, voxel=0.25, structure="even").padded()
    program = fx.compile(scene.padded(), "mavic_3m", **CAMERA)
    np.testing.assert_allclose(program(like), observed(like), rtol=1e-5)
    assert np.abs(program(like) - program(scene.padded())).max() > 1e-4


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda b: b"hello", "these are others"),
        (lambda b: b[:18], "these are others"),
        (lambda b: b[:200], "bytes are damaged"),
        (lambda b: b[:-1], "bytes are damaged"),
        (lambda b: b[:-9] + bytes([b[-9] ^ 1]) + b[-8:], "bytes are damaged"),
        (lambda b: b[:15] + b"\xff\xff\xff\xff" + b[19:], "bytes are damaged"),
        (lambda b: b.replace(b'"cpu"', b'"tpu"', 1), "one for tpu. Compile it anew"),
        (lambda b: b.replace(b'"fynjax": "', b'"fynjax": "9', 1), "bytes are damaged"),
    ],
)
def test_other_bytes_end_in_one_line(kept, change, words):
    with pytest.raises(InputError, match=words):
        fx.Program.from_bytes(change(kept))


def test_another_version_is_refused(kept, monkeypatch):
    monkeypatch.setattr(_program, "version", lambda _: "9.9")
    with pytest.raises(InputError, match=r"of fynjax 9\.9, but got one of"):
        fx.Program.from_bytes(kept)


def test_what_is_missing_is_named(kept, monkeypatch):
    monkeypatch.setitem(sys.modules, "flatbuffers", None)
    with pytest.raises(MissingExtraError, match=r"fynjax\[map\]"):
        fx.Program.from_bytes(kept)


def test_a_scene_that_is_traced_is_refused(scene):
    with pytest.raises(InputError, match="`scene` must be known"):
        jax.grad(lambda foot: fx.compile(
            eqx.tree_at(lambda s: s.planting.foot, scene, foot), "mavic_3m", **CAMERA
        )(scene).sum())(scene.planting.foot)  # fmt: skip
