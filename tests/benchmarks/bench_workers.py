"""What a second worker gains: `python -m tests.benchmarks.bench_workers --plots 12`.

Plots of the shared field tables are inferred as `fynjax bioscape calibrate` does, by one worker and
by two, after a first round in which both compile. Printed are wall and CPU time of each worker,
and, apart from them, what dask takes: to start, and for a part that does nothing. The ratio of wall
times means something where nothing else runs; that of the CPU times always: the work of one worker
over that of the busier of two.
"""

import os
import tempfile
import time
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from fynjax._core.parts import Workers, at_work
from fynjax.app.io.plot import DEFAULT_PRIOR, read_plot, read_prior
from fynjax.inversion import spectrum_view
from fynjax.studies.bioscape import run_bioscape
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
from fynjax.studies.bioscape._spectra import read_spectrometer
from tests.benchmarks._measure import bioscape_plots, options

EMPTY = 100
"""Parts that do nothing."""


def cases(count: int, size: float, voxel: float) -> tuple[list[PlotCase], PlotSpectrumForward]:
    """Plots to infer, of `size` in voxels of `voxel` [m]."""
    tables, read, spectra = bioscape_plots()
    read = read[:count]
    learned = read_prior(DEFAULT_PRIOR)
    with tempfile.TemporaryDirectory() as work:
        run_bioscape(tables, Path(work), plots=[p.name for p in read])
        files = [read_plot(Path(work) / p.name / "plot.toml") for p in read]
        each = [(file, seed) for file in files for seed in range(3)]
        scenes = build_scenes(
            [f for f, _ in each], Resolution(size, voxel), [s for _, s in each],
            room=ROOM, softness=SOFTNESS,
        )  # fmt: skip
    bands, flights = chosen_bands(
        read_spectrometer(tables), [spectra[p.name] for p in read], tables
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


def inferred(case: PlotCase, predict: PlotSpectrumForward, tiny: bool) -> tuple[Any, ...]:
    """The fit of a plot, or where `tiny` its prior, without what compiles for minutes; then the
    process that did it and its CPU time [s]."""
    before = time.process_time()
    fit = (np.asarray(case.space.physical(np.zeros(len(case.space.names)))),)
    if not tiny:
        fit = infer_plot(case, predict)
    return *fit, np.array([os.getpid(), time.process_time() - before])


def nothing(number: int) -> tuple[np.ndarray]:
    return (np.array(number),)


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the table."""
    parser = options(__doc__)
    parser.add_argument("--plots", type=int, default=12)
    parser.add_argument("--voxel", type=float, default=0.25, help="edge of a voxel [m]")
    given = parser.parse_args(arguments)
    parts, predict = cases(2, 2.0, 0.5) if given.tiny else cases(given.plots, 5.0, given.voxel)
    wall: dict[int, float] = {}
    busiest: dict[int, float] = {}
    fits = {}
    for workers in (1, 2):
        began = time.perf_counter()
        with at_work(Workers(workers)) as pool:
            opened = time.perf_counter() - began
            began = time.perf_counter()
            pool.all(nothing, range(EMPTY))
            each = (time.perf_counter() - began) / EMPTY
            began = time.perf_counter()
            pool.all(inferred, parts[:1] * workers, predict, given.tiny)
            compiled = time.perf_counter() - began
            began = time.perf_counter()
            found = pool.all(inferred, parts, predict, given.tiny)
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
