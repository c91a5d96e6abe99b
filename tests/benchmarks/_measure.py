"""What the benchmarks share: options, the example plot, processor time, memory, references."""

import argparse
import os
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import equinox as eqx
import jax

from fynjax._core.memory import peak_memory
from fynjax.app.io.plot import Plot, example_folder, read_plot
from fynjax.studies.bioscape import BioscapePlot, read_bioscape
from fynjax.studies.bioscape._spectra import PlotSpectra, read_plot_spectra


def options(text: str | None) -> argparse.ArgumentParser:
    """Options of the benchmark that `text` describes, with `--tiny`."""
    parser = argparse.ArgumentParser(
        description=text, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--tiny", action="store_true", help="so small that only the way is tried")
    return parser


def data_folder() -> Path:
    """Folder of the reference data: `FYNJAX_SHARED_DATA`, or `../shared/data`."""
    beside = Path(__file__).parents[3] / "shared" / "data"
    return Path(os.environ.get("FYNJAX_SHARED_DATA", beside))


def bioscape_plots() -> tuple[Path, list[BioscapePlot], dict[str, PlotSpectra]]:
    """Folder of BioSCape's tables, its plots that have spectra, and the spectra of each."""
    folder = data_folder() / "eco" / "bioscape"
    spectra = read_plot_spectra(folder)
    plots = [p for p in read_bioscape(folder) if p.name in spectra and spectra[p.name].times]
    return folder, plots, spectra


def example_plot(size: float, tiny: bool = False, **changes: Any) -> Plot:
    """The shipped plot with another side [m]; where `tiny`, of its first two species alone, in
    voxels filled evenly."""
    plot = read_plot(example_folder() / "plot.toml").replace(size_m=(size, size), **changes)
    return plot.replace(species=plot.species[:2], structure_m="even") if tiny else plot


def seconds(call: Callable[[], Any], repeats: int = 3) -> tuple[Any, float, float]:
    """Result of a call, CPU time of the first one, with compilation, and the least of later ones,
    all threads added up [s]."""
    times = []
    for _ in range(1 + repeats):
        start = time.process_time()
        result = jax.block_until_ready(call())
        times.append(time.process_time() - start)
    return result, times[0], min(times[1:])


def compiled(function: Callable[..., Any], *arguments: Any) -> tuple[Any, float, float, float]:
    """Result of a function, CPU time of its compilation and of a call [s], and the memory that XLA
    plans for arguments, results and temporaries [GiB]."""
    arrays, rest = eqx.partition(arguments, eqx.is_array)
    start = time.process_time()
    program = jax.jit(lambda arrays: function(*eqx.combine(arrays, rest))).lower(arrays).compile()
    compiling = time.process_time() - start
    plan = program.memory_analysis()
    planned = plan.argument_size_in_bytes + plan.output_size_in_bytes + plan.temp_size_in_bytes
    result, *times = seconds(lambda: program(arrays), 1)
    return result, compiling, min(times), planned / 2**30


def peak_gib() -> float:
    """Most memory that this process has held so far [GiB]."""
    return peak_memory() / 2**30
