"""What solvers ask of a plot until they have fitted it: `python -m tests.benchmarks.table_solvers`.

The shipped plot of 3 m in expectation, covers of its species, leaf area and brightness of the
ground free; the data are statistics of its drone image at a draw of the prior, with noise. One call
of `fit` for each solver, to the same tolerance. Prints steps; renders, gradients and Jacobians
asked for; CPU time once all is compiled, over that of the default, and of the first call, with
compilation; what is left of the objective above the least that any found; and whether the fit
converged.
"""

from collections import Counter
from collections.abc import Callable, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import jaxopt
import numpy as np
import optax
import optimistix as optx
import pandas as pd
from jaxtyping import Array, Float

from fynjax.app.assembly import build_plot, image_view
from fynjax.inversion import (
    BroydenLM,
    LogPosterior,
    PlotForward,
    fit,
    free_space,
    predicted_statistics,
    search_form,
    weigh_targets,
)
from fynjax.metrics import BANDS
from fynjax.scene import Scene
from tests.benchmarks._measure import example_plot, options, seconds

STATISTICS = tuple(f"{layer}.{kind}" for layer in (*BANDS, "NDVI") for kind in ("mean", "std"))
FREE = ("species.*.cover", "species.*.leaf_area_index", "ground.brightness")
SOLVERS: dict[str, Any] = {
    "the default, BroydenLM(renew=True)": None,
    "BroydenLM()": BroydenLM(),
    "optimistix.LevenbergMarquardt": optx.LevenbergMarquardt(1e-4, 1e-4),
    "optimistix.Dogleg": optx.Dogleg(1e-4, 1e-4),
    "optimistix.BFGS": optx.BFGS(1e-5, 1e-5),
    # Its own search along a line compiles the image in too many places.
    "jaxopt.LBFGSB, backtracking": jaxopt.LBFGSB(fun=jnp.sum, tol=1e-3, linesearch="backtracking"),
    "jaxopt.ProjectedGradient": jaxopt.ProjectedGradient(
        fun=jnp.sum, projection=jaxopt.projection.projection_box, tol=1e-3
    ),
    "optimistix.OptaxMinimiser(optax.adam)": optx.OptaxMinimiser(optax.adam(0.1), 1e-5, 1e-5),
}
_ASKED: Counter[str] = Counter()


def note(kind: str) -> None:
    """Count at each call of the compiled program."""
    jax.debug.callback(lambda: _ASKED.update([kind]))


@jax.custom_vjp
def noted(value: Array) -> Array:
    """The same value; counts where it is computed, and where a derivative goes back through it."""
    note("renders")
    return value


def _forward(value: Array) -> tuple[Array, None]:
    note("renders")
    return value, None


def _backward(_: None, cotangent: Array) -> tuple[Array]:
    note("gradients")
    return (cotangent,)


noted.defvjp(_forward, _backward)


class Counted(eqx.Module):
    """The forward model of a plot, and a count of what is asked of it."""

    forward: PlotForward

    def __call__(self, values: Float[Array, " free"], scene: Scene) -> Array:
        return noted(self.forward(values, scene))

    def jacobian(
        self, values_at: Callable[[Array], Array], u: Float[Array, " free"], scene: Scene
    ) -> tuple[Array, Array]:
        note("Jacobians")
        return self.forward.jacobian(values_at, u, scene)


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the table."""
    parser = options(__doc__)
    parser.add_argument("--steps", type=int, default=300, help="most steps of a solver")
    given = parser.parse_args(arguments)
    read = example_plot(1.0 if given.tiny else 3.0, given.tiny)
    scene, parameters = build_plot(read, seed=0)
    names = STATISTICS[:2] if given.tiny else STATISTICS
    view = image_view(read, scene, parameters, names)
    quick, cheap = search_form(scene, parameters, [view])
    space = free_space(scene, parameters, FREE, read.calibration.relative_sd)
    model = Counted(PlotForward(parameters, space.names, cheap))
    context = (quick.expected(),)
    random = np.random.default_rng(1)
    none = weigh_targets(names, np.ones(len(names)), 1.0)
    truth = 0.7 * random.normal(size=len(space.names))
    seen = predicted_statistics(
        LogPosterior(model, space, none, context=context), jnp.asarray(truth)
    )
    data = weigh_targets(names, np.asarray(seen), 0.02)
    off = random.normal(size=len(names)) * np.asarray(data.sd)
    data = eqx.tree_at(lambda d: d.value, data, data.value + off)
    rows = []
    for name, solver in list(SOLVERS.items())[: 2 if given.tiny else None]:
        call = lambda s=solver: fit(  # noqa: E731
            model, data, space, solver=s, max_steps=given.steps, context=context
        )
        found, first, again = seconds(call, 1)
        _ASKED.clear()
        jax.block_until_ready(call())
        jax.effects_barrier()
        rows.append(
            {
                "solver": name, "steps": int(found.steps),
                **{kind: _ASKED[kind] for kind in ("renders", "gradients", "Jacobians")},
                "CPU s": again, "first call": first, "objective": float(found.loss[-1]),
                "converged": bool(found.converged),
            }
        )  # fmt: skip
        print(rows[-1], flush=True)
    table = pd.DataFrame(rows)
    table.insert(6, "over the default", table["CPU s"] / table["CPU s"][0])
    table["above the least"] = table["objective"] - table["objective"].min()
    print(f"{len(space.names)} parameters, {len(names)} statistics")
    print(table.to_string(index=False, float_format=lambda v: f"{v:.4g}"))


if __name__ == "__main__":
    main()
