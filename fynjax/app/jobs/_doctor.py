"""The job of `fynjax doctor`: whether JAX computes rightly on this machine."""

import os
import tempfile
from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from fynjax._core.compiler import OWN_SUMS, WRONG_BY, error_of_sums, programs_folder, settings
from fynjax._core.memory import free_memory
from fynjax._core.store import cache_folder
from fynjax.app.assembly import read_scene
from fynjax.radiation import canopy_reflectance
from fynjax.scene import observe
from fynjax.sensors import shipped_sensor

_LEAST_MEMORY = 2 * 2**30


class Check(NamedTuple):
    """One part of the backend, as it was found."""

    name: str
    """Part of the backend, such as "sums"."""
    passed: bool
    """Whether it is as it should be."""
    found: str
    """Measured error or size, in words."""
    advice: str
    """Advice where the check did not pass."""


def doctor() -> list[Check]:
    """Check that JAX computes what fynjax relies on, on the device that it uses.

    Sums and products of matrices against NumPy's, an image of four bands against images of each, a
    gradient against differences, 64 bits, memory, and the folder of compiled programs. Takes some
    ten seconds.

    **Returns:** a `Check` for each. A part that fails with an error has not passed.

    >>> from fynjax.app.jobs import doctor
    >>> [check.name for check in doctor() if not check.passed]
    []
    """
    return [
        _checked("sums", error_of_sums, WRONG_BY, "set the environment variable "
                 f"XLA_FLAGS={OWN_SUMS}, or install another version of JAX"),
        _checked("products", _products, 1e-5, "unset JAX_DEFAULT_MATMUL_PRECISION"),
        _checked("image", _image, 1e-4, "install another version of JAX: bands of an image are "
                 "mixed up"),
        _checked("gradient", _gradient, 1e-2, "install another version of JAX"),
        _checked("64 bits", _double, 1e-6, "use a device that has float64: JAX_PLATFORMS=cpu"),
        _memory(),
        _kept(),
        Check("settings", True, settings(), "none"),
    ]  # fmt: skip


def _checked(name: str, error: Callable[[], float], most: float, advice: str) -> Check:
    try:
        found = error()
    except Exception as wrong:  # whatever the backend says
        return Check(name, False, f"{type(wrong).__name__}: {wrong}".split("\n")[0], advice)
    return Check(name, bool(found <= most), f"error {found:.1g}, at most {most:g}", advice)


def _products() -> float:
    """Relative error of a product of float32 matrices, which graphics cards cut short."""
    random = np.random.default_rng(1)
    left, right = random.normal(size=(2, 256, 256)).astype(np.float32)
    exact = left.astype(float) @ right.astype(float)
    return float(np.abs(jax.jit(jnp.matmul)(left, right) - exact).max() / np.abs(exact).max())


def _image() -> float:
    """Largest difference of an image of four bands from those of each band alone."""
    scene = read_scene(size=1.0, structure="even")
    camera = shipped_sensor("mavic_3m")
    together = np.asarray(observe(scene, camera, pixel=0.05).reflectance)
    alone = [
        np.asarray(observe(scene, camera.select([band]), pixel=0.05).reflectance[0])
        for band in (0, len(camera.bands) - 1)
    ]
    return float(np.abs(np.stack(alone) - together[[0, -1]]).max())


def _gradient() -> float:
    """Relative error of a slope of a canopy's reflectance by leaf area, against a difference."""

    def red(area: jax.Array) -> jax.Array:
        leaf = jnp.array([0.06]), jnp.array([0.03])
        return canopy_reflectance(*leaf, area, soil=jnp.array([0.2]))[0]

    step = 0.1
    above, below = red(jnp.asarray(1.0 + step)), red(jnp.asarray(1.0 - step))
    difference = float(above - below) / (2.0 * step)
    return abs(float(jax.grad(red)(jnp.asarray(1.0))) / difference - 1.0)


def _double() -> float:
    """Relative error of a small number that was added to one and is left when one is taken off."""
    with jax.enable_x64(True):
        # Of arguments: constants the compiler would take out.
        left = jax.jit(lambda x: (x[0] + x[1]) - x[0])(jnp.array([1.0, 1e-9]))
        return abs(float(left) / 1e-9 - 1.0)


def _memory() -> Check:
    try:
        free = free_memory()
    except Exception as wrong:  # of a system that does not say
        return Check("memory", False, f"{type(wrong).__name__}: {wrong}", "look yourself")
    return Check(
        "memory", free >= _LEAST_MEMORY, f"{free / 2**30:.1f} GiB free",
        "close other programs, or render smaller plots and larger voxels",
    )  # fmt: skip


def _kept() -> Check:
    stated = os.environ.get("JAX_COMPILATION_CACHE_DIR")
    name = "JAX_COMPILATION_CACHE_DIR" if stated else "XDG_CACHE_HOME"
    advice = f"set {name} to a folder that can be written: else each run compiles anew"
    folder = stated or "the cache of this user"
    try:
        if not stated:
            folder = str(cache_folder() / "jax")
            if programs_folder() is None:
                why = "it cannot be written, or is another user's"
                return Check("kept programs", False, f"{folder}: {why}", advice)
        os.makedirs(folder, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            return Check("kept programs", True, folder, advice)
    except OSError as wrong:
        return Check("kept programs", False, f"{folder}: {wrong.strerror or wrong}", advice)
