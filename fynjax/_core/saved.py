"""Records of this package as a file, and back: no code is stored, and none of a file is run."""

import dataclasses
import enum
import importlib
import json
import zipfile
import zlib
from collections.abc import Mapping
from importlib.metadata import version
from pathlib import Path, PurePath
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from pydantic import BaseModel

from fynjax._core.errors import InputError

_MOST_BYTES = 1 << 32
"""Most bytes that a file may unfold to."""

_DAMAGED = (
    OSError, EOFError, ValueError, KeyError, RuntimeError, MemoryError, zlib.error,
    zipfile.BadZipFile,
)  # fmt: skip
"""What reading a damaged file may raise."""


def save(path: str | Path, value: Any) -> None:
    """Write a record of this package, or a tuple of some, as a compressed NumPy file.

    **Arguments:** `path` of the file; `value`, of dataclasses, records of equinox and pydantic,
    arrays, numbers, texts, paths, and functions that a module of this package has by name.

    **Raises:** `TypeError` for a value of another kind, such as a function of one's own.
    """
    arrays: dict[str, np.ndarray] = {}
    tree = _packed(value, arrays)
    text = json.dumps({"version": version("fynjax"), "value": tree})
    with Path(path).open("wb") as file:
        np.savez_compressed(file, **arrays, tree=np.frombuffer(text.encode(), np.uint8))  # type: ignore[arg-type]


def load(path: str | Path) -> Any:
    """The record that `save` wrote into a file.

    **Raises:** `InputError` for a file that is none of `save`'s, or of another version of the
    package.
    """
    path = Path(path)
    try:
        with zipfile.ZipFile(path) as packed:
            if sum(one.file_size for one in packed.infolist()) > _MOST_BYTES:
                raise InputError("expected a fit of at most 4 GiB", file=path)
        with np.load(path, allow_pickle=False) as file:
            arrays = {name: file[name] for name in file.files}
        tree = json.loads(arrays.pop("tree").tobytes().decode())
    except _DAMAGED as error:
        raise InputError(f"expected a fit that fynjax wrote: {error}", file=path) from error
    if not isinstance(tree, dict) or not {"version", "value"} <= tree.keys():
        raise InputError("expected a fit that fynjax wrote", file=path)
    if tree["version"] != version("fynjax"):
        raise InputError(
            f"expected a fit of fynjax {version('fynjax')}, but this is of {tree['version']}: "
            "calibrate again",
            file=path,
        )
    try:
        return _unpacked(tree["value"], arrays)
    except (AttributeError, ImportError, KeyError, RuntimeError, TypeError, ValueError) as error:
        raise InputError(
            f"expected a fit of this code, but {error}: calibrate again", file=path
        ) from error


def _packed(value: Any, arrays: dict[str, np.ndarray]) -> Any:
    """A value as JSON, its arrays apart."""
    if value is None or isinstance(value, bool | str):
        return value
    if isinstance(value, jax.Array | np.ndarray | np.generic):
        name = f"a{len(arrays)}"
        arrays[name] = np.asarray(value)
        scalar = "scalar" if isinstance(value, np.generic) else "numpy"
        return {"is": "jax" if isinstance(value, jax.Array) else scalar, "array": name}
    if isinstance(value, int | float) and not isinstance(value, enum.Enum):
        return value if np.isfinite(value) else {"is": "float", "text": repr(value)}
    if isinstance(value, PurePath):
        return {"is": "path", "text": str(value)}
    if isinstance(value, Mapping):
        pairs = [[_packed(k, arrays), _packed(v, arrays)] for k, v in value.items()]
        return {"is": "dict", "pairs": pairs}
    kind = type(value)
    if isinstance(value, list | tuple | set | frozenset):
        each = [_packed(one, arrays) for one in value]
        name = kind.__name__ if kind in (list, tuple, set, frozenset) else _name_of(kind)
        return {"is": name, "each": each}
    if isinstance(value, enum.Enum):
        return {"is": "enum", "class": _name_of(kind), "name": value.name}
    if isinstance(value, BaseModel):
        fields = {name: getattr(value, name) for name in kind.model_fields}
        stated = sorted(value.model_fields_set)
        return {
            "is": "model", "class": _name_of(kind), "stated": stated,
            "fields": {k: _packed(v, arrays) for k, v in fields.items()},
        }  # fmt: skip
    if isinstance(value, eqx.Module) or dataclasses.is_dataclass(kind):
        fields = {
            one.name: _packed(getattr(value, one.name), arrays)
            for one in dataclasses.fields(value)
            if hasattr(value, one.name)
        }
        return {"is": "record", "class": _name_of(kind), "fields": fields}
    if callable(value) and hasattr(value, "__qualname__"):
        return {"is": "function", "name": _name_of(value)}
    raise TypeError(f"a {kind.__name__} cannot be kept in a file")


def _name_of(thing: Any) -> str:
    """Module and name of a class or function, by which it is found again."""
    name = f"{thing.__module__}:{thing.__qualname__}"
    if _found(name) is not thing:
        raise TypeError(f"{thing.__qualname__} cannot be kept in a file: it is not of this package")
    return name


def _found(name: str) -> Any:
    """A class or function of this package by its name."""
    module, _, inner = name.partition(":")
    if module.split(".")[0] != "fynjax" or not all(
        part.isidentifier() for part in (*module.split("."), *inner.split("."))
    ):
        raise TypeError(f"{name} is not of this package")
    found: Any = importlib.import_module(module)
    for part in inner.split("."):
        found = getattr(found, part)
    # Not what a module has imported from elsewhere, which another file could then call.
    if f"{getattr(found, '__module__', '')}:{getattr(found, '__qualname__', '')}" != name:
        raise TypeError(f"{name} is not of this package")
    return found


def _class(name: str) -> Any:
    found = _found(name)
    if not isinstance(found, type):
        raise TypeError(f"{name} is no class")
    return found


def _unpacked(tree: Any, arrays: Mapping[str, np.ndarray]) -> Any:
    """The value of what `_packed` gave."""
    if not isinstance(tree, dict):
        return tree
    kind = tree["is"]
    if kind in ("jax", "numpy", "scalar"):
        array = arrays[tree["array"]]
        return jnp.asarray(array) if kind == "jax" else array[()] if kind == "scalar" else array
    if kind == "float":
        return float(tree["text"])
    if kind == "path":
        return Path(tree["text"])
    if kind == "dict":
        return {_unpacked(k, arrays): _unpacked(v, arrays) for k, v in tree["pairs"]}
    if "each" in tree:
        each = [_unpacked(one, arrays) for one in tree["each"]]
        plain = {"list": list, "tuple": tuple, "set": set, "frozenset": frozenset}
        if kind in plain:
            return plain[kind](each)
        cls = _class(kind)
        if not issubclass(cls, tuple):
            raise TypeError(f"{kind} is no tuple")
        return cls(*each)
    if kind == "function":
        return _found(tree["name"])
    cls = _class(tree["class"])
    if kind == "enum" and not issubclass(cls, enum.Enum):
        raise TypeError(f"{tree['class']} is no enumeration")
    if kind == "enum":
        return cls[tree["name"]]
    fields = {name: _unpacked(one, arrays) for name, one in tree["fields"].items()}
    if kind == "model":
        if not issubclass(cls, BaseModel):
            raise TypeError(f"{tree['class']} is no model")
        if not fields.keys() <= cls.model_fields.keys():
            raise TypeError(f"{tree['class']} has no such fields")
        return cls.model_construct(set(tree["stated"]), **fields)
    if not dataclasses.is_dataclass(cls):
        raise TypeError(f"{tree['class']} is no record")
    # As it was, without its checks and conversions: these were done when it was made.
    if not fields.keys() <= {one.name for one in dataclasses.fields(cls)}:
        raise TypeError(f"{tree['class']} has no such fields")
    record: Any = object.__new__(cls)  # type: ignore[arg-type]
    for name, value in fields.items():
        object.__setattr__(record, name, value)
    return record
