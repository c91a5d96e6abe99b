"""What JAX compiles, how long it takes, what it makes: `python -m tests.benchmarks.table_compile`.

The plot of the README, 2 m, in pixels of 10 cm. First the programs by themselves: equations of the
traced function, fusions of the compiled one, CPU time to trace, lower and compile, CPU time and
memory of a run. Then CPU time of what a person does one after another, from empty caches: image,
gradient by all parameters, another metric, gradients by some of the parameters, larger pixels, a
second plot of like size, and one of other taxa and covers, both with room for plants that never
stand (`Scene.padded`). `--beside FOLDER`, again for each other version of the repository, has its
numbers beside, and by how much results differ over their largest. Each version has processes of its
own, one after the other.
"""

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tests.benchmarks._measure import options, seconds

TAXA = (
    ("Erica irregularis", "rounded_shrub", 40, 30, 0.6),
    ("Restio eleocharis", "tussock", 30, 15, 0.5),
)
COLUMNS = "taxon", "growth_form", "mean_diameter_cm", "cover_percent", "height_max_m"
RESULTS = "results.npz"


def plot(tiny: bool, seed: int = 1, other: str = "", share: float = 1.0) -> Any:
    """The README's plot, or one of `other` names with a `share` of its covers [-]; where `tiny`, a
    smaller one in voxels filled evenly."""
    import fynjax as fx

    table: list[dict[str, Any]] = [dict(zip(COLUMNS, taxon, strict=True)) for taxon in TAXA]
    for row in table:
        row |= {"taxon": row["taxon"] + other, "cover_percent": share * row["cover_percent"]}
    if tiny:
        return fx.Scene.from_table(table[:1], size=1.0, seed=seed, voxel=0.25, structure="even")
    return fx.Scene.from_table(table, size=2.0, seed=seed)


def picture(scene: Any, parameters: Any, pixel: float) -> Any:
    """The image of a drone's camera."""
    import fynjax as fx

    return fx.observe(scene, "mavic_3m", pixel=pixel, parameters=parameters)


def ndvi(scene: Any, parameters: Any, pixel: float) -> Any:
    """Mean NDVI of that image."""
    return picture(scene, parameters, pixel).index("NDVI").mean()


def equations(jaxpr: Any) -> int:
    """Equations of a traced function, with those within each."""
    inner = (
        part
        for equation in jaxpr.eqns
        for value in equation.params.values()
        for part in (value if isinstance(value, tuple | list) else (value,))
    )
    inner_jaxprs = (getattr(part, "jaxpr", part) for part in inner)
    return len(jaxpr.eqns) + sum(equations(j) for j in inner_jaxprs if hasattr(j, "eqns"))


def programs(tiny: bool, folder: Path) -> dict[str, float]:
    """Numbers of the programs of image and gradient, with the scene as an argument."""
    import equinox as eqx
    import jax

    scene, pixel = plot(tiny), 0.25 if tiny else 0.1
    arrays, rest = eqx.partition(scene, eqx.is_array)
    numbers: dict[str, float] = {}

    def image(arrays: Any, parameters: Any) -> Any:
        return picture(eqx.combine(arrays, rest), parameters, pixel).reflectance

    def gradient(arrays: Any, parameters: Any) -> Any:
        value = lambda p: ndvi(eqx.combine(arrays, rest), p, pixel)  # noqa: E731
        return jax.grad(value)(parameters)

    for name, function in (("image", image), ("gradient", gradient)):
        times = [time.process_time()]
        stage: Any = jax.jit(function)
        for step in ("trace", "lower", "compile"):
            arguments = (arrays, scene.parameters) if step == "trace" else ()
            stage = getattr(stage, step)(*arguments)
            times.append(time.process_time())
            if step == "trace":
                numbers[f"{name}: equations"] = equations(stage.jaxpr.jaxpr)
        numbers[f"{name}: fusions"] = stage.as_text().count(" fusion(")
        for step, took in zip(("trace", "lower", "compile"), np.diff(times), strict=True):
            numbers[f"{name}: {step} [CPU s]"] = float(took)
        call = lambda stage=stage: stage(arrays, scene.parameters)  # noqa: E731
        numbers[f"{name}: run [CPU s]"] = seconds(call, 10)[2]
        plan = stage.memory_analysis()
        numbers[f"{name}: temporary [MiB]"] = plan.temp_size_in_bytes / 2**20
    return numbers


def steps(tiny: bool, folder: Path) -> dict[str, float]:
    """CPU time of what a person does in one process [s]; results in `folder`."""
    import equinox as eqx
    import jax

    scene, other = plot(tiny), plot(tiny, seed=2)
    pixel = 0.25 if tiny else 0.1
    numbers: dict[str, float] = {}
    results: dict[str, np.ndarray] = {}

    def step(name: str, call: Callable[[], Any], repeats: int = 0) -> None:
        result, numbers[f"{name} [CPU s]"], *_ = seconds(call, 1)
        leaves = [np.ravel(leaf) for leaf in jax.tree.leaves(result)]
        results[name] = np.concatenate(leaves)
        if repeats:
            numbers[f"{name}, again [CPU s]"] = seconds(call, repeats)[2]

    def gradient(scene: Any, pixel: float) -> Any:
        return jax.grad(lambda p: ndvi(scene, p, pixel))(scene.parameters)

    def part(where: Callable[[Any], Any]) -> Any:
        def value(part: Any) -> Any:
            return ndvi(scene, eqx.tree_at(where, scene.parameters, part), pixel)

        return jax.grad(value)(where(scene.parameters))

    image = lambda scene, pixel: picture(scene, scene.parameters, pixel).reflectance  # noqa: E731
    step("image", lambda: image(scene, pixel), 10)
    step("gradient by all", lambda: gradient(scene, pixel), 10)
    red = lambda p: picture(scene, p, pixel)["red"].std()  # noqa: E731
    step("of another metric", lambda: jax.grad(red)(scene.parameters))
    step("by cover alone", lambda: part(lambda p: p.species.cover), 10)
    step("by chlorophyll alone", lambda: part(lambda p: p.leaf.chlorophyll), 10)
    along = jax.tree.map(jax.numpy.ones_like, scene.parameters)
    forward = lambda p: image(eqx.tree_at(lambda s: s.parameters, scene, p), pixel)  # noqa: E731
    step("forward mode", lambda: jax.jvp(forward, (scene.parameters,), (along,))[1])
    step("image, larger pixels", lambda: image(scene, 2 * pixel))
    step("gradient, larger pixels", lambda: gradient(scene, 2 * pixel))
    step("image, second plot", lambda: image(other, pixel))
    step("gradient, second plot", lambda: gradient(other, pixel))
    one, like = plot(tiny).padded(), plot(tiny, other=" minor", share=0.95).padded()
    step("image, with room", lambda: image(one, pixel), 10)
    step("gradient, with room", lambda: gradient(one, pixel), 10)
    step("image, other table, with room", lambda: image(like, pixel))
    step("gradient, other table, with room", lambda: gradient(like, pixel))
    np.savez(folder / RESULTS, **results)  # type: ignore[arg-type]
    return numbers


def measured(tree: Path, what: str, tiny: bool, folder: Path) -> dict[str, float]:
    """Numbers of a version of the repository in a process of its own, with nothing compiled."""
    cache = {"JAX_ENABLE_COMPILATION_CACHE": "false", "PYTHONPATH": str(tree)}
    command = [sys.executable, str(Path(__file__).absolute()), "--only", what, "--in", str(folder)]
    run = subprocess.run(
        [*command, *["--tiny"] * tiny],
        env=os.environ | cache, cwd=tree, stdout=subprocess.PIPE, text=True, check=True,
    )  # fmt: skip
    numbers: dict[str, float] = json.loads(run.stdout.splitlines()[-1])
    return numbers


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the table."""
    parser = options(__doc__)
    parser.add_argument("--beside", action="append", default=[], metavar="FOLDER")
    parser.add_argument("--only", choices=("programs", "steps"), help="in this process, as JSON")
    parser.add_argument("--in", dest="folder", type=Path, default=Path())
    given = parser.parse_args(arguments)
    if given.only:
        make = programs if given.only == "programs" else steps
        print(json.dumps(make(given.tiny, given.folder)))
        return
    trees = [*map(Path, given.beside), Path(__file__).parents[2]]
    with tempfile.TemporaryDirectory() as name:
        folders = [Path(name) / str(i) for i in range(len(trees))]
        columns: list[dict[str, float]] = [{} for _ in trees]
        for folder in folders:
            folder.mkdir()
        for what in ("programs", "steps"):
            for tree, folder, column in zip(trees, folders, columns, strict=True):
                column |= measured(tree.absolute(), what, given.tiny, folder)
        results = [dict(np.load(folder / RESULTS)) for folder in folders]
    for name in columns[-1]:
        row = [f"{column[name]:10.4g}" for column in columns]
        print(f"{name:38s}", *row)
    if len(trees) == 1:
        return
    print("largest difference of first and last, over the largest value")
    for name, values in results[-1].items():
        before = results[0][name]
        off = np.abs(values - before).max() / np.abs(before).max()
        print(f"{name:38s} {off:10.1e}")


if __name__ == "__main__":
    main()
