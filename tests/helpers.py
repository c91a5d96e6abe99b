"""Checks, and files to read, that several test files share."""

import json
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import jsonschema
import numpy as np
import optimistix as optx
import pytest
import rasterio
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float
from rasterio import Affine

from fynjax._core.least_squares import NO_TAGS
from fynjax.app.io.raster import Cube, open_raster

unix = pytest.mark.skipif(sys.platform == "win32", reason="signals and links as Unix has them")
"""Mark of a test that kills a process or makes a link."""


def stand_in(kind: type, **fields: Any) -> Any:
    """An object of a class that has no more than these fields."""
    base: type = tuple if issubclass(kind, tuple) else object
    return base.__new__(type(kind)(kind.__name__, (kind,), fields))


def read_cube(path: Path) -> Cube:
    """An image with all that its file states of it."""
    with open_raster(path, "an image") as file:
        raster = file.read()
        known = np.isfinite(raster.values).any(axis=(1, 2))
        return Cube(
            raster.values, file.names, file.wavelengths, file.fwhm,
            file.good if file.header else known, file.cell_m or 0.0, raster.origin,
            file.tags.get("quantity", file.tags.get("fynjax quantity", "reflectance")),
            file.crs.to_wkt() if file.crs else None,
        )  # fmt: skip


def assert_gradients(
    function: Callable[[Any], Any],
    at: Any,
    *,
    step: float = 1e-6,
    rtol: float = 1e-6,
    seed: int = 0,
) -> None:
    """Compare reverse- and forward-mode AD of `function` with central differences.

    The outputs are contracted to one scalar first, and the comparison is made along each
    coordinate axis of `at` with a step relative to the coordinate's size, so that a single
    wrong derivative cannot hide behind many right ones.
    """
    leaves, tree = jax.tree.flatten(jax.tree.map(np.asarray, at))
    flat = np.concatenate([leaf.ravel() for leaf in leaves]).astype(float)
    ends = np.cumsum([leaf.size for leaf in leaves])

    def outputs(vector: Any) -> Any:
        parts = [
            part.reshape(leaf.shape).astype(leaf.dtype)
            for part, leaf in zip(jnp.split(vector, ends[:-1]), leaves)
        ]
        return ravel_pytree(function(jax.tree.unflatten(tree, parts)))[0]

    weight = np.random.default_rng(seed).normal(size=jax.eval_shape(outputs, flat).shape)

    def scalar(vector: Any) -> Any:
        return weight @ outputs(vector)

    value = jax.jit(scalar)
    reverse, forward = jax.device_get(
        jax.jit(lambda v: (jax.grad(scalar)(v), jax.jacfwd(scalar)(v)))(flat)
    )
    assert np.all(np.isfinite(reverse)), "a reverse-mode derivative is not finite"
    differences = np.empty_like(flat)
    for index in range(flat.size):
        h = step * max(abs(flat[index]), 1e-3)
        up, down = flat.copy(), flat.copy()
        up[index] += h
        down[index] -= h
        differences[index] = (value(up) - value(down)) / (2 * h)
    scale = np.abs(differences) + 1e-9 * np.abs(differences).max()
    worst = np.abs(reverse - differences) / scale
    assert worst.max() < rtol, (
        f"AD and differences disagree by {worst.max():.2e} at {worst.argmax()}"
    )
    np.testing.assert_allclose(forward, reverse, rtol=1e-8, atol=1e-12 * np.abs(reverse).max())


@contextmanager
def compilations() -> Iterator[list[str]]:
    """Names of the programs that are compiled, or fetched from the cache on disk, inside."""
    names: list[str] = []

    def listen(event: str, duration: float, **details: Any) -> None:
        if event == "/jax/core/compile/backend_compile_duration":
            names.append(str(details.get("fun_name", "")))

    jax.monitoring.register_event_duration_secs_listener(listen)
    try:
        yield names
    finally:
        jax.monitoring.unregister_event_duration_listener(listen)


IMAGE_PROGRAMS = {"jit(_voxels_under)", "jit(solve_light)", "jit(_measured)"}
"""Names of the programs that an image is made by."""


def write_raster(
    path: Path,
    bands: np.ndarray,
    *,
    transform: Affine,
    scale: float | None = None,
    unit: str | None = None,
    **options: Any,
) -> Path:
    """A GeoTIFF of `bands` [band, row, column] as another program writes it."""
    count, height, width = bands.shape
    with rasterio.open(
        path, "w", driver="GTiff", dtype=bands.dtype, count=count, height=height, width=width,
        transform=transform, **options,
    ) as file:  # fmt: skip
        file.write(bands)
        if scale is not None:
            file.scales = [scale] * count
        if unit is not None:
            file.units = [unit] * count
    return path


def write_ply(path: Path, properties: Sequence[str], table: np.ndarray) -> Path:
    """An ASCII PLY of points [point, property]; properties such as "double x"."""
    head = ["ply", "format ascii 1.0", f"element vertex {len(table)}"]
    head += [f"property {one}" for one in properties] + ["end_header"]
    rows = [" ".join(map(repr, row)) for row in table.tolist()]
    path.write_text("\n".join([*head, *rows]) + "\n", encoding="utf-8")
    return path


def assert_valid_summary(summary: Any) -> None:
    """A job's result, or the summary that a command wrote, is what the schema says."""
    from fynjax.app.jobs._schemas import json_schema

    if not isinstance(summary, dict):
        summary = json.loads(summary.model_dump_json())
    jsonschema.validate(summary, json_schema("summary"))


def descend(
    residual: Callable[[Array], Array],
    solver: Any,
    start: Float[Array, " free"],
    *,
    max_steps: int,
    jacobian: Callable[[Array], tuple[Array, Array]] | None = None,
) -> Iterator[tuple[Float[Array, " free"], Any, optx.RESULTS]]:
    """Steps of a solver of optimistix, one by one, for who watches, keeps or stops them.

    **Arguments:**

    - `residual`: residuals at y; need not be traceable where the solver only calls it.
    - `solver`: for least squares, such as `BroydenLM()`.
    - `start`: where to start from.
    - `max_steps`: most steps.
    - `jacobian`: gives residuals and Jacobian at y to a `BroydenLM`.

    **Returns:** an iterator over y, the solver's state there, and why it stopped; at first of the
    start. While it goes on the reason is `optx.RESULTS.nonlinear_max_steps_reached`.
    """
    options = {} if jacobian is None else {"jacobian": lambda y, _: jacobian(y)}
    call = lambda y, _: (residual(y), None)  # noqa: E731
    y = jnp.asarray(start)
    struct = None if jacobian is not None else jax.eval_shape(residual, y)
    state = solver.init(call, y, None, options, struct, None, NO_TAGS)
    for number in range(max_steps + 1):
        if number:
            y, state, _ = solver.step(call, y, None, options, state, NO_TAGS)
        done, result = solver.terminate(call, y, None, options, state, NO_TAGS)
        ended = bool(done) or bool(result != optx.RESULTS.successful)
        going: Any = optx.RESULTS.nonlinear_max_steps_reached
        yield y, state, result if ended else going
        if ended:
            return


def radiance_to_counts(radiance: Any, camera: Any) -> Any:
    """Counts of a picture of a given radiance, neither rounded nor cut off: the inverse of
    `fynjax.sensors.counts_to_radiance`."""
    scale = camera.sensitivity / (camera.gain * camera.exposure * camera.full_scale)
    return radiance * camera.response(radiance.shape) / scale + camera.black_level
