"""Time and memory of the leaf layer: `python -m tests.benchmarks.bench_leaf`.

Prints the CPU time of a spectrum beside that of PyPI's `prosail`, where that is installed; of
derivatives over the model; of a spectrum of many leaves, mapped at once and in blocks, over one of
few, and memory over the output; and what `fit_leaf` takes for many spectra. Accuracy on campaigns
left out: `tests.benchmarks.leaf_campaigns`.
"""

import dataclasses
import importlib
from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np

from fynjax.leaf import LeafParameters, fit_leaf, prospect
from tests.benchmarks._measure import options, peak_gib, seconds

RANGES = {
    "structure": (1, 3), "chlorophyll": (0.5, 100), "carotenoids": (0, 25),
    "anthocyanins": (0, 10), "water": (0.001, 0.06), "dry_matter": (0.001, 0.04),
}  # fmt: skip
"""Ranges from which leaves are drawn."""
SEVEN = (*RANGES, "brown_pigments")
"""Parameters of PROSPECT-D."""


def leaves(count: int, dtype: type = np.float32) -> LeafParameters:
    draw = np.random.default_rng(0)
    made = LeafParameters.many(
        **{name: draw.uniform(*limits, count) for name, limits in RANGES.items()},
        proteins=0.0, carbon_constituents=0.0,
    )  # fmt: skip
    return jax.tree.map(lambda x: x.astype(dtype), made)


def spectra(p: LeafParameters) -> tuple[jax.Array, jax.Array]:
    optics = prospect(p)
    return optics.reflectance, optics.transmittance


def by_vector(p: LeafParameters) -> tuple[jax.Array, jax.Array]:
    """Derivatives by `SEVEN`."""
    start = jnp.stack([getattr(p, name) for name in SEVEN])
    return jax.jacfwd(lambda x: spectra(dataclasses.replace(p, **dict(zip(SEVEN, x)))))(start)


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the table."""
    given = options(__doc__).parse_args(arguments)
    few, many, repeats = (5, 50, 1) if given.tiny else (100, 10_000, 20)
    forward = jax.jit(jax.vmap(spectra))
    jacobian = jax.jit(jax.vmap(by_vector))
    gradient = jax.jit(jax.vmap(jax.grad(lambda p: sum((a**2).sum() for a in spectra(p)))))
    blocks = jax.jit(lambda leaves: jax.lax.map(spectra, leaves, batch_size=few))
    for dtype in (np.float64, np.float32):
        small, big, name = leaves(few, dtype), leaves(many, dtype), np.dtype(dtype).name
        once, all_seven, back = (
            seconds(lambda f=f, at=small: f(at), repeats)[2] for f in (forward, jacobian, gradient)
        )
        print(f"{name}: {1e3 * once / few:.4f} ms a spectrum; Jacobian {all_seven / once:.1f}, "
              f"gradient {back / once:.1f} times that", flush=True)  # fmt: skip
        for way, call in (("vmap", forward), (f"lax.map by {few}", blocks)):
            spent = seconds(lambda f=call, at=big: f(at), repeats)[2]
            used = call.lower(big).compile().memory_analysis()
            memory = (used.temp_size_in_bytes + used.output_size_in_bytes) / (
                used.output_size_in_bytes
            )
            print(f"{name}, {many} leaves by {way}: a spectrum {spent / many / (once / few):.1f} "
                  f"times one of {few}; memory {memory:.1f} times the output")  # fmt: skip
    beside_prosail(few, once / few)
    draw = np.random.default_rng(1)
    reflectance = np.asarray(forward(big)[0]) * draw.normal(1.0, 0.03, (many, 1))
    before = peak_gib()
    _, spent, _ = seconds(lambda: fit_leaf(np.arange(400.0, 2501.0), reflectance), 1)
    print(f"fit_leaf of {many} spectra: {spent:.1f} CPU s with compilation, peak {peak_gib():.2f} "
          f"GiB (before {before:.2f})")  # fmt: skip


def beside_prosail(count: int, ours: float) -> None:
    """Print the time of a spectrum over `ours` [s]."""
    try:
        peer = importlib.import_module("prosail")
    except ImportError:
        print("prosail is not installed: left out")
        return
    rows = np.stack([np.asarray(getattr(leaves(count), name)) for name in RANGES], axis=1)

    def call() -> None:
        for n, c, k, a, w, m in rows.tolist():
            peer.run_prospect(n, c, k, 0.0, w, m, ant=a, prospect_version="D")

    took = seconds(call, 5)[2] / count
    print(f"prosail: {1e3 * took:.4f} ms a spectrum, {took / ours:.1f} times ours in float32")


if __name__ == "__main__":
    main()
