"""A job at work: the journal that an interrupted run goes on from."""

from pathlib import Path

import pytest

from fynjax._core.errors import InputError
from fynjax.app.jobs import Run


def test_a_journal_is_of_one_seed_of_what_is_signed_and_of_the_content_of_files(
    tmp_path: Path,
) -> None:
    file = tmp_path / "input.csv"
    file.write_text("a")

    def journal(signed: float = 1.0, seed: int = 0) -> object:
        return Run(tmp_path, seed=seed).journal(tmp_path / "kept", signed, files=[file, None])

    assert journal() is not None
    assert journal() is not None
    for other in ({"signed": 2.0}, {"seed": 1}):
        with pytest.raises(InputError, match="of another run"):
            journal(**other)  # type: ignore[arg-type]
    file.write_text("b")
    with pytest.raises(InputError, match="of another run"):
        journal()
    assert Run(tmp_path).journal(None, files=[]) is None
