"""Files that other files name, and how much a compressed file may unfold to."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydantic_core import CoreSchema, core_schema

from fynjax._core.errors import InputError
from fynjax._core.files import existing_file, why_not

_TIGHTEST = 3000
"""Bytes for each byte of a compressed file above which it cannot hold them: deflate packs no
tighter than 1 in 1032, and few measurements tighter than 1 in 10."""
_FREELY = 1 << 28
"""Bytes that a file may state whatever its size."""


def named_file(
    owner: Path,
    name: str,
    what: str,
    *,
    within: Path | None,
    row: int | None = None,
    column: str | None = None,
) -> Path:
    """The file that another file names, by a path from its own folder.

    **Arguments:**

    - `owner`: the file that names it, in `row` and `column`.
    - `name`: the path, as it stands there.
    - `what`: names the file in errors, such as "a sky table".
    - `within`: folder in which it must lie, also behind links: a file from somebody else shall not
      choose what of this machine is read. `None` allows any place.

    **Raises:** `InputError` for a file elsewhere, and as `existing_file`.
    """
    try:
        return _file_beside(owner, name, what, within)
    except ValueError as error:
        raise InputError(str(error), file=owner, row=row, column=column) from error


def _file_beside(owner: Path, name: str, what: str, within: Path | None) -> Path:
    place = owner.parent / name
    try:
        path = place.resolve()
        if within is not None and not path.is_relative_to(within.resolve()):
            raise InputError(
                f"expected {what} in this file's folder or below. Copy it there; for a plot file "
                "that you trust, allow other places: --allow-outside (`allow_outside`)"
            )
        existing_file(place, what)  # as it is named: of a link that leads nowhere it says so
        return path
    except InputError as error:
        text = str(error).removeprefix(f"{error.file}: ")
    except ValueError:  # a null character
        text = f"expected {what}, but no file can have this name"
    except (OSError, RuntimeError) as error:  # a link in a loop
        text = f"expected {what}, but {why_not(place, error)}"
    raise ValueError(f"{name!r}: {text}")


@dataclass(frozen=True)
class NamedFile:
    """Type of a key that names a file: `Annotated[Path, NamedFile("a sky table")]`.

    Where `read_toml` reads the record, the text becomes the path of a file that is there, as
    `named_file` has it; elsewhere the path is taken as it is.
    """

    what: str
    """Names the file in errors."""
    words: tuple[str, ...] = ()
    """Texts that stand for something else and are kept."""

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> CoreSchema:
        return core_schema.with_info_wrap_validator_function(self._path, core_schema.str_schema())

    def _path(self, value: Any, text: Any, info: core_schema.ValidationInfo) -> Path | str:
        if isinstance(value, Path):
            return value
        name = str(text(value))
        if name in self.words:
            return name
        if info.context is None:
            return Path(name)
        return _file_beside(info.context["owner"], name, self.what, info.context["within"])


def check_stated_size(path: Path, stated: int, what: str, *, packed: bool) -> None:
    """Refuse a file whose header states more content than the file can hold, before any is read.

    **Arguments:**

    - `path`: a file that exists.
    - `stated`: bytes of content by the header.
    - `what`: that content, such as "30 000 points".
    - `packed`: whether the content may be compressed.

    **Raises:** `InputError`.
    """
    held = path.stat().st_size
    if stated < 0 or stated > (max(_TIGHTEST * held, _FREELY) if packed else held):
        raise InputError(
            f"it states {what}, but its {held} bytes cannot hold them. Is it cut short or "
            "damaged? Copy it again.",
            file=path,
        )
