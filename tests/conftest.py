"""Fixtures shared by all tests: 64-bit JAX and the place of the reference data."""

import ctypes
import functools
import gc
import os
import signal
import sys
import tempfile
import threading
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

# Before JAX is imported, here and in the children of a test. Programs of its cache are read with
# long lines of false alarm, which fill the pipe of a child that nobody reads.
os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")
# A program need not say where its operations were written: a tenth of its compilation.
os.environ.setdefault("JAX_TRACEBACK_IN_LOCATIONS_LIMIT", "0")

import jax
import jaxtyping
import numpy as np
import psutil
import pytest
from jax._src import compilation_cache
from jax._src.interpreters import mlir
from jax._src.lax import lax

if os.environ.get("FYNJAX_TYPES"):  # before the package is imported, whose functions it wraps
    import tests.checked  # noqa: F401

    jaxtyping.install_import_hook("fynjax", "tests.checked.checked")

from fynjax._core.compiler import known_flags
from fynjax._core.errors import MissingExtraError

# Tests compile much and run little. So they compile in a quarter of the time; what comes out runs
# a little slower. One piece of code a program: to split it for several cores costs more. Passes
# that look for what could move out of loops find nothing, and take a fifth of the compilation.
# Read when JAX is first used; the children of a test inherit it.
PASSES = (
    "while-loop-invariant-code-motion",
    "while-loop-trip-count-annotator",
    "while-loop-constant-sinking",
    "small-while-loop-hoisting",
    "simplify-while-loops",
    "simplify-conditional",
    "simplify-sorts",
    "reshape-mover",
)
if os.environ["XLA_FLAGS"] == " ".join(known_flags()):  # else a person tries others
    os.environ["XLA_FLAGS"] += (
        " --xla_backend_optimization_level=0 --xla_llvm_disable_expensive_passes=true"
        " --xla_cpu_parallel_codegen_split_count=1 --xla_disable_hlo_passes=" + ",".join(PASSES)
    )
jax.config.update("jax_enable_x64", True)  # in 32 bits: tests/test_precision.py


# JAX makes the context that holds a program's text anew for every program, a quarter of the time
# that a small one takes. Here one serves a whole file, but for programs within another.
new_context = mlir.make_ir_context
context_of_file = functools.cache(new_context)
mlir.make_ir_context = lambda: (
    context_of_file() if mlir.ir.Context.current is None else new_context()
)


# Outside `jit` JAX compiles a program for every shape of an array that comes from NumPy, that is
# converted or filled. NumPy makes the same, in a hundredth of the time.
def by_numpy(primitive: Any, make: Callable[..., np.ndarray]) -> None:
    """Let `make` do, outside `jit`, what a primitive does to real numbers of one precision."""
    compiled = primitive.impl

    def done(operand: Any, *others: Any, **how: Any) -> Any:
        kept = isinstance(operand, np.ndarray | jax.Array) and operand.dtype.kind in "biuf"
        weak = getattr(operand, "weak_type", False) or how.get("weak_type", False)
        if not kept or weak or others or how.get("sharding") is not None:
            return compiled(operand, *others, **how)
        made = make(np.asarray(operand), **how)
        return compiled(operand, **how) if made is None else jax.device_put(made)

    primitive.def_impl(done)


def converted(values: np.ndarray, new_dtype: Any, **_: Any) -> np.ndarray | None:
    """Numbers that become floats; others may not fit."""
    with np.errstate(over="ignore"):
        return values.astype(new_dtype) if np.dtype(new_dtype).kind == "f" else None


def filled(values: np.ndarray, shape: Any, broadcast_dimensions: Any, **_: Any) -> np.ndarray:
    sides = np.ones(len(shape), int)
    sides[list(broadcast_dimensions)] = values.shape
    return np.broadcast_to(values.reshape(sides), shape).copy()


by_numpy(lax.stage_p, np.copy)
by_numpy(lax.convert_element_type_p, converted)
by_numpy(lax.broadcast_in_dim_p, filled)

# A program that is kept for other processes of the check is not worth compressing, which takes a
# twentieth of all: whatever reads zlib reads this too.
compilation_cache.zlib = SimpleNamespace(
    compress=functools.partial(zlib.compress, level=0), decompress=zlib.decompress
)

# Tracing makes many objects and few cycles: the collector's usual rhythm takes a tenth of the time.
gc.set_threshold(50_000, 20, 20)


def pytest_configure(config: pytest.Config) -> None:
    """What one test has compiled, another worker or a notebook need not compile again. Where
    pytest-xdist is installed, its workers take files in the order they are given below."""
    if hasattr(config.option, "loadscopereorder"):
        config.option.loadscopereorder = False
    if "JAX_COMPILATION_CACHE_DIR" not in os.environ:
        folder = tempfile.TemporaryDirectory(prefix="fynjax-compiled-")
        config.add_cleanup(folder.cleanup)
        # Workers and the kernels of notebooks inherit it; this process reads it below.
        os.environ["JAX_COMPILATION_CACHE_DIR"] = folder.name
        # Small programs too: an operation outside `jit` is one, and half its time is compilation.
        os.environ["JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS"] = "0"
        jax.config.update("jax_compilation_cache_dir", folder.name)
        jax.config.update("jax_persistent_cache_min_compile_time_secs", 0)


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Folder of the reference data (`FYNJAX_SHARED_DATA`, default `../shared/data`)."""
    named = os.environ.get("FYNJAX_SHARED_DATA")
    folder = Path(named or Path(__file__).resolve().parents[2] / "shared" / "data")
    if not folder.is_dir():
        if named:
            pytest.fail(f"FYNJAX_SHARED_DATA: expected a folder of reference data, but got {named}")
        pytest.skip(f"needs reference data, which are not at {folder}; set FYNJAX_SHARED_DATA")
    return folder


@pytest.fixture(autouse=True)
def close_figures() -> Iterator[None]:
    """Closes what a test has drawn: a later one in the same process would count it as its own."""
    yield
    if pyplot := sys.modules.get("matplotlib.pyplot"):
        pyplot.close("all")


@pytest.fixture(autouse=True)
def listen_to_ctrl_c() -> Iterator[None]:
    """Lets Ctrl-C end the tests still, after one has run a command: its process does not listen
    when it ends."""
    before = signal.getsignal(signal.SIGINT)
    yield
    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGINT, before)


@pytest.fixture(autouse=True)
def check_types(request: pytest.FixtureRequest) -> Iterator[None]:
    """Checks types and shapes if `FYNJAX_TYPES` is set, but not in slow tests or of wrong input."""
    unchecked = any(map(request.node.get_closest_marker, ("slow", "study", "untyped")))
    jaxtyping.config.update("jaxtyping_disable", unchecked)
    yield
    jaxtyping.config.update("jaxtyping_disable", False)


@pytest.fixture(scope="module", autouse=True)
def forget_compiled() -> Iterator[None]:
    """Frees what earlier files have compiled once it takes much memory; until then it serves."""
    yield
    context_of_file.cache_clear()
    if psutil.Process().memory_info().rss > 3 * 2**30:
        jax.clear_caches()
        gc.collect()
        getattr(ctypes.CDLL(None), "malloc_trim", int)(0)  # glibc keeps what is freed


def pytest_collection_finish() -> None:
    """What is imported by now stays: the collector need not look at it again and again."""
    gc.collect()
    gc.freeze()


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Files with slow tests go first, so that no worker is left alone with one at the end; then
    those of the whole package, which start processes."""
    slow = {item.path for item in items if item.get_closest_marker("slow")}
    here = Path(__file__).parent
    items.sort(key=lambda item: (item.path not in slow, item.path.parent != here))


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call(item: pytest.Item) -> Iterator[None]:
    """Where only the library is installed (`.ci/library`), what asks for an extra that the library
    itself names is left out; what asks for the app's fails."""
    try:
        yield
    except MissingExtraError as missing:
        of_rooms = missing.extra in ("analysis", "map", "posterior", "tables")
        if "FYNJAX_LIBRARY_ALONE" not in os.environ or not of_rooms:
            raise
        pytest.skip(str(missing))
