"""What a second worker gains: `python -m tests.benchmarks.bench_workers [PLOTS] [VOXEL]`.

Plots of the shared field tables are inferred as `fynjax bioscape calibrate` does, by one worker and
by two, after a first round in which both compile. Printed are wall and CPU time of each worker,
and, apart from them, what dask takes: to start, and for a part that does nothing. The ratio of wall
times means something where nothing else runs; that of the CPU times always: the work of one worker
over that of the busier of two.
"""

import os
import resource
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np

from fynjax._core.parts import Workers, at_work
from fynjax.inversion import spectrum_view
from fynjax.io.plot import DEFAULT_PRIOR, read_plot, read_prior
from fynjax.studies.bioscape import read_bioscape, run_bioscape
from fynjax.studies.bioscape._calibrate import chosen_bands
from fynjax.studies.bioscape._inversion import (
    ROOM,
    SOFTNESS,
    PlotCase,
    PlotSpectrumForward,
    infer_plot,
    plot_data,
    prior_space,
)
from fynjax.studies.bioscape._scenes import ACCURACY, Resolution, build_scenes, slots_of
from fynjax.studies.bioscape._spectra import read_plot_spectra, read_spectrometer

TABLES = Path(os.environ.get("FYNJAX_SHARED_DATA", "data")) / "eco" / "bioscape"


def cases(count: int, voxel: float) -> tuple[list[PlotCase], PlotSpectrumForward]:
    """Plots to infer."""
    spectra = read_plot_spectra(TABLES)
    read = [p for p in read_bioscape(TABLES) if p.name in spectra and spectra[p.name].times][:count]
    learned = read_prior(DEFAULT_PRIOR)
    with tempfile.TemporaryDirectory() as work:
        run_bioscape(TABLES, Path(work), plots=[p.name for p in read])
        files = [read_plot(Path(work) / p.name / "plot.toml") for p in read]
        each = [(file, seed) for file in files for seed in range(3)]
        scenes = build_scenes(
            [f for f, _ in each], Resolution(5.0, voxel), [s for _, s in each],
            room=ROOM, softness=SOFTNESS,
        )  # fmt: skip
    bands, flights = chosen_bands(
        read_spectrometer(TABLES), [spectra[p.name] for p in read], TABLES
    )
    view = spectrum_view(bands, *scenes[0], ACCURACY)
    made = [
        PlotCase(
            plot_data(view.names, flights[i], None),
            prior_space(plot, None, learned),
            scenes[3 * i][1],
            tuple(scene for scene, _ in scenes[3 * i : 3 * i + 3]),
        )
        for i, plot in enumerate(read)
    ]
    dead = tuple(form == "deadwood" for form in slots_of(files))
    return made, PlotSpectrumForward(view, dead)


def inferred(case: PlotCase, predict: PlotSpectrumForward) -> tuple[Any, ...]:
    """The fit of a plot, then the process that did it and its CPU time [s]."""
    before = resource.getrusage(resource.RUSAGE_SELF)
    fit = infer_plot(case, predict)
    after = resource.getrusage(resource.RUSAGE_SELF)
    spent = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return *fit, np.array([os.getpid(), spent])


def nothing(number: int) -> tuple[np.ndarray]:
    return (np.array(number),)


def main() -> None:
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 12
    voxel = float(sys.argv[2]) if len(sys.argv) > 2 else 0.25
    parts, predict = cases(count, voxel)
    wall: dict[int, float] = {}
    busiest: dict[int, float] = {}
    fits = {}
    for workers in (1, 2):
        began = time.perf_counter()
        with at_work(Workers(workers)) as pool:
            opened = time.perf_counter() - began
            began = time.perf_counter()
            pool.all(nothing, range(500))
            each = (time.perf_counter() - began) / 500
            began = time.perf_counter()
            pool.all(inferred, parts[:1] * workers, predict)
            compiled = time.perf_counter() - began
            began = time.perf_counter()
            found = pool.all(inferred, parts, predict)
            wall[workers] = time.perf_counter() - began
        spent: Counter[int] = Counter()
        for *_, (process, seconds) in found:
            spent[int(process)] += seconds
        busiest[workers] = max(spent.values())
        fits[workers] = [[a.tobytes() for a in arrays[:-1]] for arrays in found]
        print(
            f"{workers} workers: {wall[workers]:.1f} s for {len(parts)} plots, CPU "
            f"{', '.join(f'{s:.1f}' for s in spent.values())} s; start {opened:.1f} s, first plot "
            f"with compilation {compiled:.1f} s, a part that does nothing {1e3 * each:.1f} ms",
            flush=True,
        )
    print(f"one over two: wall {wall[1] / wall[2]:.2f}, CPU {busiest[1] / busiest[2]:.2f}")
    print(f"the same to the bit: {fits[1] == fits[2]}")


if __name__ == "__main__":
    main()
