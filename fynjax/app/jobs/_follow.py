"""Go through a search step by step: keep its state, go on from a kept one."""

import time
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from fynjax._core.checkpoint import Journal, signature
from fynjax.app.jobs._run import Run
from fynjax.inversion import (
    Calibration,
    Problem,
    calibration,
    plot_search,
    search_starts,
    search_states,
)


def calibrated(problem: Problem, run: Run, checkpoint: Path | None) -> Calibration:
    """Calibrate a plot to what sensors measured, from every start.

    **Arguments:** `problem`; `run`, `checkpoint`, as of `follow`.

    **Raises:** `InputError` as `follow`.
    """
    search = plot_search(problem)
    return calibration(search, follow(search, search_starts(search), run, checkpoint))


def follow(search: Any, starts: Sequence[Any], run: Run, checkpoint: Path | None) -> list[Any]:
    """The state of a search at its end from each start.

    **Arguments:**

    - `search`: of a calibration, a `PlotSearch` or a `PixelSearch`.
    - `starts`: whitened coordinates; None is the prior's centre.
    - `run`: keeps the times of a step and of the search.
    - `checkpoint`: folder of the states; the same search goes on from them. None: nothing is kept.

    **Raises:** `InputError` for a checkpoint of another search, or one that cannot be written.
    """
    kept = None if checkpoint is None else Journal(checkpoint, signature(search.signed, starts))
    ends: list[Any] = []
    began, before, steps = time.perf_counter(), 0.0, []
    for number, u in enumerate(starts, start=1):
        name = f"start {number}, " if len(starts) > 1 else ""
        states = partial(_states, search, u, ends[:1], name)
        turn = -1
        for state in (
            states(None) if kept is None else kept.states(f"start_{number}", search.state, states)
        ):
            if int(state.turn) == turn:
                steps.append(time.perf_counter() - before)
            turn, before = int(state.turn), time.perf_counter()
        ends.append(state)
    if steps:
        run.seconds["search_step"] = float(np.median(steps))
    run.seconds["search"] = time.perf_counter() - began
    return ends


def _states(search: Any, u: Any, after: Sequence[Any], name: str, kept: Any) -> Iterator[Any]:
    return search_states(search, search.begin(u, *after) if kept is None else kept, name)
