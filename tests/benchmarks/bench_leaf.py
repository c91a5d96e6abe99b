"""Figures of the leaf layer beside its peers: `python -m tests.benchmarks.bench_leaf [FOLDER]`.

FOLDER holds the leaf data (default: `FYNJAX_SHARED_DATA`/leaf). Peers that are not installed are
named and skipped. Times are CPU time, the least of several calls, all threads added up. Accuracy on
campaigns left out: `tests.benchmarks.leaf_campaigns`.
"""

import dataclasses
import importlib
import os
import resource
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd

from fynjax.io.spectra._asd import read_asd
from fynjax.leaf import (
    ErrorModel,
    LeafFit,
    LeafParameters,
    fit_leaf,
    prospect,
    sample_leaf_posterior,
)
from fynjax.leaf._error_model import to_bins

TRAITS = {
    "chlorophyll": ("cab", 1.0),
    "carotenoids": ("car", 1.0),
    "water": ("ewt", 1e3),
    "dry_matter": ("lma", 1e3),
}
COLUMNS = {
    "structure": "n", "chlorophyll": "cab", "carotenoids": "car", "anthocyanins": "ant",
    "brown_pigments": "brown", "water": "ewt", "dry_matter": "lma", "proteins": "prot",
    "carbon_constituents": "cbc",
}  # fmt: skip

RANGES = {
    "structure": (1, 3), "chlorophyll": (0.5, 100), "carotenoids": (0, 25),
    "anthocyanins": (0, 10), "water": (0.001, 0.06), "dry_matter": (0.001, 0.04),
}  # fmt: skip
"""Ranges from which leaves are drawn."""
SEVEN = (*RANGES, "brown_pigments")
"""Parameters of PROSPECT-D."""


def cpu_ms(call: Callable[[], Any], repeats: int = 20) -> float:
    """Least CPU time of a call [ms], after one to compile."""
    call()
    best = float("inf")
    for _ in range(repeats):
        start = time.process_time()
        call()
        best = min(best, time.process_time() - start)
    return best * 1e3


def agreement(folder: Path) -> None:
    """Largest difference to the authors' R package."""
    with np.load(folder / "reference_prospect_R.npz") as stored:
        reference = dict(stored)
    for dtype in (np.float64, np.float32):
        leaves = LeafParameters.many(
            **{name: reference[f"par_{key}"].astype(dtype) for name, key in COLUMNS.items()}
        )
        for version in ("D", "PRO"):
            optics = jax.vmap(lambda p, v=version: prospect(p, version=v))(leaves)
            worst = max(
                np.abs(np.asarray(optics.reflectance) - reference[f"refl_{version}"]).max(),
                np.abs(np.asarray(optics.transmittance) - reference[f"tran_{version}"]).max(),
            )
            print(f"agreement with R, {version}, {np.dtype(dtype).name}: {worst:.1e}")


def speed(batch: int = 100) -> None:
    """CPU time a spectrum, ours and PyPI `prosail`."""
    draw = np.random.default_rng(0)
    values = {name: draw.uniform(*limits, batch) for name, limits in RANGES.items()}
    forward = jax.jit(jax.vmap(lambda p: jax.tree.leaves(prospect(p))[:2]))
    for dtype in (np.float64, np.float32):
        leaves = LeafParameters.many(**{k: v.astype(dtype) for k, v in values.items()})
        leaves = jax.tree.map(lambda x, d=dtype: x.astype(d), leaves)
        took = cpu_ms(lambda leaves=leaves: jax.block_until_ready(forward(leaves)))
        print(f"forward, {np.dtype(dtype).name}: {took / batch:.4f} ms a spectrum")
    ours = took / batch
    rows = list(zip(*values.values()))
    for name in ("prosail", "prosail_jax", "torchrtm"):
        try:
            peer = importlib.import_module(name)
        except ImportError:
            print(f"forward, {name}: not installed, skipped")
            continue
        call = PEERS[name](peer, values, rows)
        took = cpu_ms(call, 5) / batch
        print(f"forward, {name}: {took:.4f} ms a spectrum, {took / ours:.1f} times ours in float32")


def derivatives(batch: int = 100, large: int = 10_000) -> None:
    """CPU time of derivatives by the seven parameters of PROSPECT-D over that of the forward model;
    of a large batch, mapped at once and in blocks, over a small one, and memory over the output."""
    draw = np.random.default_rng(0)

    def spectra(p: LeafParameters) -> tuple[jax.Array, jax.Array]:
        optics = prospect(p)
        return optics.reflectance, optics.transmittance

    def by_vector(p: LeafParameters) -> tuple[jax.Array, jax.Array]:
        def of(x: jax.Array) -> tuple[jax.Array, jax.Array]:
            return spectra(dataclasses.replace(p, **dict(zip(SEVEN, x))))

        return jax.jacfwd(of)(jnp.stack([getattr(p, name) for name in SEVEN]))

    forward = jax.jit(jax.vmap(spectra))
    blocks = jax.jit(lambda leaves: jax.lax.map(spectra, leaves, batch_size=batch))
    jacobian = jax.jit(jax.vmap(by_vector))
    gradient = jax.jit(jax.vmap(jax.grad(lambda p: sum((a**2).sum() for a in spectra(p)))))
    for dtype in (np.float64, np.float32):
        small, big = (
            jax.tree.map(
                lambda x, d=dtype: x.astype(d),
                LeafParameters.many(
                    **{name: draw.uniform(*RANGES[name], count) for name in RANGES},
                    proteins=0.0,
                    carbon_constituents=0.0,
                ),
            )
            for count in (batch, large)
        )
        # In turn, so that a slow minute of the machine meets all three.
        rounds = [
            [
                cpu_ms(lambda f=f, leaves=small: jax.block_until_ready(f(leaves)), 1)
                for f in (forward, jacobian, gradient)
            ]
            for _ in range(40)
        ]
        once, by_all, back = np.min(rounds, axis=0)
        print(
            f"derivatives, {np.dtype(dtype).name}: Jacobian {by_all / once:.1f}, gradient "
            f"{back / once:.1f} times the forward model"
        )
        for name, call in (("vmap", forward), (f"lax.map by {batch}", blocks)):
            many = cpu_ms(lambda f=call, leaves=big: jax.block_until_ready(f(leaves)), 3)
            used = call.lower(big).compile().memory_analysis()
            whole = used.temp_size_in_bytes + used.output_size_in_bytes
            print(
                f"{large} leaves, {np.dtype(dtype).name}, {name}: a spectrum "
                f"{many / large / (once / batch):.1f} times one of {batch}; memory "
                f"{whole / used.output_size_in_bytes:.1f} times the output"
            )


def fit_many(folder: Path, count: int = 10_000) -> None:
    """CPU time of `fit_leaf` on many spectra, and by how much it raises the peak of memory: leaves
    of ANGERS drawn again, 3 % brighter or darker (standard deviation)."""
    with np.load(folder / "angers_spectra.npz") as stored:
        grid, r = stored["wl"].astype(float), stored["refl"]
    draw = np.random.default_rng(0)
    rows = draw.integers(0, len(r), count)
    spectra = (r[rows] * draw.normal(1.0, 0.03, (count, 1))).astype(np.float32)
    start, before = time.process_time(), _peak_gb()
    fit_leaf(grid, spectra)
    took = time.process_time() - start
    print(
        f"fit_leaf on {count} spectra: {took:.0f} CPU s with compilation, peak {_peak_gb():.2f} GB "
        f"(before {before:.2f})"
    )


def _peak_gb() -> float:
    """Largest resident memory of this process so far [GB], on Linux."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 / 1e9


def _prosail(peer: Any, values: dict, rows: list) -> Callable[[], Any]:
    return lambda: [
        peer.run_prospect(n, c, k, 0.0, w, m, ant=a, prospect_version="D")
        for n, c, k, a, w, m in rows
    ]


def _prosail_jax(peer: Any, values: dict, rows: list) -> Callable[[], Any]:
    place = Path(str(importlib.import_module("prosail").__file__)).parent
    table, _ = peer.load_coeffs(str(place))
    forward = jax.jit(
        jax.vmap(lambda p: peer.prospect_d(p[0], p[1], p[2], 0.0, p[4], p[5], p[3], table))
    )
    inputs = np.array(rows)
    return lambda: jax.block_until_ready(forward(inputs))


def _torchrtm(peer: Any, values: dict, rows: list) -> Callable[[], Any]:
    torch = importlib.import_module("torch")
    leaf = importlib.import_module("torchrtm.leaf.prospect")
    n, c, k, a, w, m = np.array(rows, np.float32).T
    # Its order is that of its tables (cab car brown ewt lma ant), not of its documentation.
    traits = torch.tensor(np.stack([c, k, np.zeros_like(c), w, m, a], 1))

    def call() -> Any:
        with torch.no_grad():
            return leaf.prospectd(traits, torch.tensor(n))

    return call


PEERS = {"prosail": _prosail, "prosail_jax": _prosail_jax, "torchrtm": _torchrtm}


def accuracy(folder: Path, name: str, use: str, **options: Any) -> LeafFit:
    """Print errors and coverage of one data set; `use` is R, T or RT."""
    with np.load(folder / f"{name}_spectra.npz") as stored:
        grid, ids = stored["wl"].astype(float), stored["id"]
        r = stored["refl"].astype(float)
        t = stored["tran"].astype(float) if "tran" in stored else np.full_like(r, np.nan)
    if r.ndim == 3:
        r, t = r.mean(1), t.mean(1)
    chemistry = pd.read_csv(folder / f"{name}_chemistry.csv.gz").set_index("id").loc[ids]
    if name == "california_asd":
        # The set's EWT is LMA x water content to the last digit, where the content is of fresh
        # mass: not water per area, which is LMA w / (1 - w). Compared with both.
        content = chemistry["water_pct"] / 100.0
        chemistry["ewt_as_stored"] = chemistry["ewt"]
        chemistry["ewt"] = chemistry["lma"] * content / (1.0 - content)
    given = (r if "R" in use else None, t if "T" in use else None)
    took = cpu_ms(lambda: fit_leaf(grid, *given, **options), 2) / len(r)
    fit = fit_leaf(grid, *given, **options)
    line = f"{name:15s} {use:2s} {options.get('domain', 'full'):8s}"
    if "T" not in use and np.isfinite(t).any():
        inner = (fit.wavelength >= 450) & (fit.wavelength <= 2400)
        error = (to_bins(grid, t) - fit.transmittance)[:, inner]
        width = 1.645 * fit.transmittance_deviation[:, inner]
        known = np.isfinite(error)
        weight = known * np.gradient(fit.wavelength)[inner]  # every nm counts the same
        rmse = np.sqrt(np.average(np.where(known, error, 0.0) ** 2, weights=weight))
        covered = np.average(np.abs(np.where(known, error, 0.0)) < width, weights=weight)
        line += f" | T {rmse:.4f} covered {covered:.2f}"
    for trait, (key, unit) in TRAITS.items():
        if key not in chemistry:
            continue
        truth = chemistry[key].to_numpy(float)
        known, i = np.isfinite(truth), fit.names.index(trait)
        found = np.asarray(getattr(fit.parameters, trait))
        inside = (truth >= fit.lower[:, i]) & (truth <= fit.upper[:, i])
        rmse = np.sqrt(np.mean((found - truth)[known] ** 2)) * unit
        line += f" | {key} {rmse:.2f} covered {inside[known].mean():.2f}"
    if "ewt_as_stored" in chemistry:
        stored = chemistry["ewt_as_stored"].to_numpy(float)
        w, m = np.asarray(fit.parameters.water), np.asarray(fit.parameters.dry_matter)
        for label, found in (("EWT", w), ("EWT LMA / (EWT + LMA)", w * m / (w + m))):
            error = 1e3 * np.sqrt(np.nanmean((found - stored) ** 2))
            line += f" | {label} against ewt as stored {error:.2f}"
    print(f"{line} | {took:.1f} ms a leaf")
    return fit


def posterior(folder: Path) -> None:
    """Effective draws a CPU second of six ANGERS leaves, R only."""
    with np.load(folder / "angers_spectra.npz") as stored:
        grid, r = stored["wl"].astype(float), stored["refl"].astype(float)
    sample_leaf_posterior(grid, r[:1], target=50.0)
    start = time.process_time()
    drawn = sample_leaf_posterior(grid, r[:6], target=1000.0)
    took = time.process_time() - start
    print(f"posterior: {drawn.effective_size.sum() / took:.0f} effective draws a CPU second")


def asd_files(folder: Path) -> None:
    """How many real ASD files give reflectance, and why the others do not."""
    files = sorted((folder / "asd").glob("*.asd"))
    good = 0
    for file in files:
        try:
            read_asd(file)
            good += 1
        except ValueError as error:
            print(f"  {error}")
    print(f"ASD files: reflectance from {good} of {len(files)}")


def main(folder: Path, error_model: ErrorModel | None = None) -> None:
    """Print every figure."""
    # First, as the peak of memory is that of the whole process.
    fit_many(folder)
    agreement(folder)
    speed()
    derivatives()
    posterior(folder)
    asd_files(folder)
    for name, use, domain in (
        ("angers", "RT", "full"), ("angers", "RT", "optimal"), ("angers", "R", "full"),
        ("angers", "T", "full"),
        ("lopex", "RT", "full"), ("lopex", "R", "full"), ("nasa_fft", "R", "full"),
        ("nasa_fft", "RT", "full"), ("california_asd", "R", "full"),
        ("california_asd", "R", "optimal"),
    ):  # fmt: skip
        accuracy(folder, name, use, domain=domain, error_model=error_model)


if __name__ == "__main__":
    default = Path(os.environ.get("FYNJAX_SHARED_DATA", "../shared/data")) / "leaf"
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else default)
