"""Files that are shipped under a name, or that a user has."""

from collections.abc import Sequence
from pathlib import Path

from fynjax._core.errors import InputError, did_you_mean
from fynjax._core.files import existing_file


def shipped_or_own(
    name_or_path: str | Path, what: str, shipped: Sequence[str], folder: Path
) -> Path:
    """The path of a shipped file by its name, or the path given.

    **Arguments:**

    - `name_or_path`: a name in `shipped`, or the path of a file.
    - `what`: names the thing in errors, such as "sensor".
    - `shipped`: names of the shipped files, without suffix.
    - `folder`: where the shipped files lie.

    **Returns:** the path of the file.

    **Raises:** `InputError` for a name that is not in `shipped`, and for a path without a file.
    """
    text = str(name_or_path)
    if Path(text).suffix or len(Path(text).parts) != 1:
        return existing_file(text, f"a {what} file")
    if text not in shipped:
        raise InputError(
            f"expected a shipped {what} or the path of a {what} file, but got {text!r}."
            f"{did_you_mean(text, shipped)} Shipped: {', '.join(shipped)}."
        )
    return folder / f"{text}.toml"
