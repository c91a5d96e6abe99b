"""The costly steps of a run, kept as they come: an interrupted run goes on without loss.

A run whose steps follow from each other the same way each time need not keep its state. It keeps
what its steps returned, and a run that starts again is given those instead of computing them.
"""

import os
import zipfile
from collections.abc import Callable
from pathlib import Path

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from fynjax._core.errors import InputError

Keep = Callable[[Callable[[], tuple[Array, ...]]], tuple[Array, ...]]
"""Does a step, or gives back what it returned in an earlier run."""


def keep_nothing(step: Callable[[], tuple[Array, ...]]) -> tuple[Array, ...]:
    """Do a step."""
    return step()


class Journal:
    """Keeps the arrays that each step returns in a file of its own, by the step's number."""

    def __init__(self, folder: str | Path, signature: str) -> None:
        """Open the journal in `folder`, or begin one.

        `signature` names the run: all that its steps follow from. Raises `InputError` if the
        folder has the journal of another run.
        """
        self._folder = Path(folder)
        self._count = 0
        self.repeating = False
        """Whether the last step was one of an earlier run."""
        mark = self._folder / _MARK
        if mark.is_file():
            if mark.read_text("utf-8").strip() != signature:
                raise InputError(
                    "this checkpoint is of another run: other files, data, parameters, settings "
                    "or seed. Choose another output, or remove it to start again",
                    file=self._folder,
                )
            return
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
            _write(mark, lambda path: path.write_text(signature + "\n", "utf-8"))
        except OSError as error:
            raise InputError(f"cannot write here: {error.strerror}", file=self._folder) from error

    def __call__(self, step: Callable[[], tuple[Array, ...]]) -> tuple[Array, ...]:
        """Do a step and keep what it returns; or, if an earlier run did it, give that back."""
        path = self._folder / _STEP.format(self._count)
        self._count += 1
        self.repeating = path.is_file()
        if self.repeating:
            try:
                with open(path, "rb") as raw, np.load(raw) as file:
                    return tuple(jnp.asarray(file[f"a{i}"]) for i in range(len(file.files)))
            except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile) as error:
                raise InputError(
                    "no checkpoint, or a damaged one; remove its folder to start again", file=path
                ) from error
        arrays = step()
        kept = {f"a{i}": np.asarray(value) for i, value in enumerate(arrays)}
        _write(path, lambda work: _save(work, kept))
        return arrays


_MARK = "calibration.mark"
_STEP = "calibration.{:04d}.npz"


def forget_journal(folder: str | Path) -> None:
    """Remove a journal, and its folder if nothing else is in it."""
    folder = Path(folder)
    for pattern in (_MARK, "calibration.*.npz", "calibration.*.work"):
        for path in folder.glob(pattern):
            path.unlink()
    if folder.is_dir() and not any(folder.iterdir()):
        folder.rmdir()


def _save(path: Path, arrays: dict[str, np.ndarray]) -> None:
    with open(path, "wb") as file:
        np.savez(file, **arrays)  # type: ignore[arg-type]


def _write(path: Path, how: Callable[[Path], object]) -> None:
    """Beside, then renamed: a kill leaves a whole file or none."""
    work = path.with_name(path.name + ".work")
    how(work)
    os.replace(work, path)
