"""What an earlier run left in a folder, and whether it is still as that run wrote it."""

import hashlib
import json
import stat
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from fynjax._core.files import file_hash

SUMMARY = "summary.json"
"""File in which a run lists what it wrote."""
_LARGEST = 1 << 28
"""Bytes of a list of files that is read."""


def sealed(record: dict[str, Any]) -> str:
    """SHA-256 of a `record` of JSON without its key "hash", whatever its layout."""
    content = {key: value for key, value in record.items() if key != "hash"}
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def _is_inside(name: str) -> bool:
    """Whether a name is that of a file below a folder."""
    path = Path(name)
    plain = "\0" not in name and all(len(part) < 256 for part in path.parts)
    return plain and bool(path.parts) and not path.is_absolute() and ".." not in path.parts


class EarlierRun:
    """What the last run of a command left in a folder, by the hashes in its `summary.json`."""

    def __init__(self, folder: str | Path, command: str) -> None:
        """Of the `command`, such as "terrain", in a `folder`, which need not be there."""
        self._folder, self._command = Path(folder), command
        self.hashes: dict[str, str] = {}
        """SHA-256 of each file that it wrote, by its name; empty where no list can be trusted."""
        self._why = ""
        path = self._folder / SUMMARY
        try:
            state = path.stat()
            read = stat.S_ISREG(state.st_mode) and state.st_size < _LARGEST  # a pipe has no end
            record = json.loads(path.read_bytes()) if read else None
        except FileNotFoundError:
            return
        except (OSError, ValueError, RecursionError):
            record = None
        if not isinstance(record, dict) or not isinstance(record.get("command"), str):
            self._why = "it is no list of results"
        elif record["command"] != command:
            self._why = f"it belongs to results of `fynjax {record['command']}`"
        elif not isinstance(record.get("hashes"), dict) or "hash" not in record:
            self._why = "it has no hashes, as versions before them wrote it"
        elif record["hash"] != sealed(record):
            self._why = "it was changed since"
        elif not all(map(_is_inside, record["hashes"])):
            self._why = "it lists files of other folders"
        else:
            self.hashes = {name: str(value) for name, value in record["hashes"].items()}

    def strange(self, names: Iterable[str]) -> dict[str, str]:
        """Files of these names, relative to the folder, that stand there and are not as the earlier
        run wrote them, each with the reason."""
        found = ((name, self._strange(name)) for name in names)
        return {name: why for name, why in found if why}

    def unchanged(self) -> list[str]:
        """Files of the earlier run that are still as it wrote them."""
        strange = self.strange(self.hashes)
        return [n for n in self.hashes if n not in strange and (self._folder / n).is_file()]

    def in_the_way(self, names: Iterable[str]) -> dict[str, str]:
        """Those names that no file can have, since a folder or a link stands in the way."""
        found = {}
        for name in names:
            path = self._folder / name
            above = [self._folder / part for part in Path(name).parents if part != Path(".")]
            if path.is_dir() and not path.is_symlink():
                found[name] = "it is a folder"
            for part in above:
                if part.is_symlink() or (part.exists() and not part.is_dir()):
                    kind = "link" if part.is_symlink() else "file"
                    found[name] = f"the folder {part.name!r} that it belongs in is a {kind}"
        return found

    def _strange(self, name: str) -> str:
        if blocked := self.in_the_way([name]):
            return blocked[name]
        path = self._folder / name
        if path.is_symlink():
            return "it is a link"
        if not path.exists():
            return ""
        if name == SUMMARY:
            return self._why
        if name not in self.hashes:
            return f"no earlier run of `fynjax {self._command}` wrote it"
        try:
            same = path.is_file() and file_hash(path) == self.hashes[name]
        except OSError as error:
            return f"it cannot be read ({error.strerror})"
        return "" if same else "it was changed since a run wrote it"
