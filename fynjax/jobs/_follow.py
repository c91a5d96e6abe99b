"""Go through a search step by step: show its progress, keep its state, go on from a kept one."""

import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from fynjax._core.checkpoint import Journal, signature
from fynjax._core.progress import advance
from fynjax.jobs._run import Run


def follow(
    search: Any,
    starts: Sequence[Any],
    run: Run,
    checkpoint: Path | None,
) -> list[Any]:
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
    began, steps = time.perf_counter(), []
    for number, u in enumerate(starts, start=1):
        name = f"start {number}, " if len(starts) > 1 else ""
        state = None if kept is None else kept.kept_state(f"start_{number}", search.state)
        if state is None:
            state = search.begin(u, *ends[:1])
        shown = 0
        while True:
            for loss, norm in np.asarray(state.trace)[shown:]:
                advance(
                    1,
                    stage=f"{name}round {int(state.turn) + 1}",
                    loss=f"{loss:.1f}",
                    gradient=f"{norm:.1f}",
                )
            shown = len(state.trace)
            if kept is not None:
                kept.put_state(f"start_{number}", state)
            if state.ended:
                break
            before = time.perf_counter()
            turn, state = int(state.turn), search.step(state)
            if int(state.turn) == turn:
                steps.append(time.perf_counter() - before)
        ends.append(state)
    if steps:
        run.seconds["search_step"] = float(np.median(steps))
    run.seconds["search"] = time.perf_counter() - began
    return ends
