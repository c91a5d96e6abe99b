"""The compiler of JAX: its flags, by what the installed version knows, and where its programs are
kept."""

import os
import sys
from contextlib import suppress
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path

from fynjax._core.store import Store, cache_folder, code_hash

WRONG_SUMS = "0.10.2"
"""Version of jaxlib whose reductions on a processor may overwrite each other's sums: an image of a
frame camera gets its first bands in place of the others, depending on processor, threads and size,
without a word (github.com/jax-ml/jax/issues/39103)."""
OWN_SUMS = "--xla_cpu_experimental_ynn_fusion_type=-reduce"
"""XLA then makes its own reductions, which are right."""
WRONG_BY = 1e-5
"""Relative error of sums from which on they are wrong."""
LEVEL = "--xla_backend_optimization_level=2"
"""Optimisation of programs, from 0 to 3, the compiler's usual one: a quarter less compilation of an
image and of a gradient, which run as fast. For graphics cards not tried, so not set there."""
QUICK = {
    "--xla_backend_extra_options=xla_cpu_disable_slp_vectorizer": (0, 13),
    LEVEL: (0, 13),
    "--xla_cpu_scheduler_type=CPU_SCHEDULER_TYPE_MEMORY_OPTIMIZED": (0, 13),
    "--xla_cpu_use_fusion_emitters=false": (0, 11, 1),
}
"""Flags that save compilation and memory on processors, and the first version of jaxlib that does
not know the flag or was not tried: XLA ends the process where it does not know one. fynjax compiles
many small loops: without two parts of the compiler and at a lower level half of the compilation of
an image goes and a third of a gradient's, and what comes out is as fast. XLA's usual order makes
empty fields of loops long before they are filled: 0.76 GiB for 0.45 in an image of 10 m, 1.73 for
1.54 in its gradient."""
CARD = {
    "--xla_gpu_force_compilation_parallelism=16": (0, 13),
    "--xla_gpu_enable_triton_gemm=false": (0, 13),
}
"""The same for graphics cards. On an H100 with 16 cores, JAX 0.11.2, image and gradient of 10 m
compiled in 5.8 and 14.1 s with them, in 22 and 45 s without, and ran as fast: what takes long is
to choose among ways of many small products."""


OFF = "FYNJAX_JAX_SETTINGS"
"""Environment variable; "off": JAX is left as it is, slower to compile and less exact on a graphics
card."""


def _left_alone() -> bool:
    return os.environ.get(OFF, "").strip().lower() in ("off", "0", "no", "false")


def settings() -> str:
    """Settings of JAX and XLA that hold for this whole process: flags of the compiler, precision of
    products, folder of kept programs; in a sentence."""
    if _left_alone():
        own = f", but for {OWN_SUMS}" if OWN_SUMS in os.environ.get("XLA_FLAGS", "") else ""
        return f"none of fynjax{own} ({OFF}=off)"
    found = [f"XLA_FLAGS={os.environ.get('XLA_FLAGS', '')}"]
    if missing := len(_wanted_flags()) - len(known_flags()):
        found.append(f"{missing} flags left out, not tried with jaxlib {version('jaxlib')} here")
    jax = sys.modules.get("jax")
    if jax is not None:
        found += [
            f"products of matrices: {jax.config.jax_default_matmul_precision or 'as JAX has them'}",
            f"programs kept in {jax.config.jax_compilation_cache_dir or 'memory alone'}",
        ]
    return "; ".join(found) + f" (none of it with {OFF}=off)"


def known_flags() -> list[str]:
    """Flags for this machine that the installed jaxlib knows."""
    found = tuple(int(part) for part in version("jaxlib").split(".")[:3] if part.isdigit())
    return [flag for flag, until in _wanted_flags().items() if found < until]


def _wanted_flags() -> dict[str, tuple[int, ...]]:
    """`QUICK`; where JAX has a plugin for another device without `LEVEL`, and with `CARD`."""
    if find_spec("jax_plugins") is None:
        return QUICK
    return {flag: until for flag, until in QUICK.items() if flag != LEVEL} | CARD


def multiply_in_full() -> None:
    """Let products of float32 matrices keep their digits on a graphics card, unless the user has
    said how JAX is to multiply. Its default there cuts factors to the 10 bits of TensorFloat-32:
    images came out 6e-4 off, and 416 bands up to 24 % (measured on an H100). On a processor and in
    float64 nothing changes."""
    jax = sys.modules.get("jax")
    if _left_alone():
        return
    if jax is None:
        os.environ.setdefault("JAX_DEFAULT_MATMUL_PRECISION", "highest")
    elif jax.config.jax_default_matmul_precision is None:
        jax.config.update("jax_default_matmul_precision", "highest")


def set_flags() -> None:
    """Compile rightly and quickly, from the next program on. `XLA_FLAGS` of the environment is left
    as the user has set it, but for `OWN_SUMS` where the version needs it. A process whose JAX is
    already in use keeps its flags.

    **Raises:** `ImportError` with the way out, where JAX is in use already and computes wrong sums.
    """
    flags = os.environ.get("XLA_FLAGS")
    mended = version("jaxlib") != WRONG_SUMS or OWN_SUMS in (flags or "")
    bridge = sys.modules.get("jax._src.xla_bridge")
    if bridge is not None and bridge.backends_are_initialized():
        if not mended:
            raise ImportError(
                f"jaxlib {WRONG_SUMS} computes wrong sums on processors, and so wrong images, and "
                "JAX was used before fynjax was imported. Import fynjax first, or set the "
                f"environment variable XLA_FLAGS={OWN_SUMS}, or install another: "
                'pip install "jax!=0.10.2"'
            )
        return
    if mended and _left_alone():
        return
    wanted = [flags] if flags is not None else [] if _left_alone() else known_flags()
    os.environ["XLA_FLAGS"] = " ".join(wanted if mended else [*wanted, OWN_SUMS])


_PROGRAMS = Store("jax", largest=2 << 30, entry=1 << 28)
_SUMS = Store("right-sums", largest=1 << 16, entry=64)


def programs_folder() -> Path | None:
    """Folder of compiled programs; None where there can be none."""
    return _PROGRAMS.folder()


def keep_compiled() -> None:
    """Keep compiled programs for the next process, unless the environment variable
    JAX_COMPILATION_CACHE_DIR says where, or the process has said so already: in the folder `jax` of
    the store (`fynjax._core.store`). Of those a program is run only if it has the store's hash
    under its own key: what is put there otherwise is compiled anew."""
    import jax  # late: help and errors of the command line need none

    folder = None if _left_alone() else _PROGRAMS.folder()
    if folder is None or not _take_programs(folder):
        return  # a home that cannot be written costs compilation time, nothing else
    kept = getattr(jax.config, "jax_compilation_cache_dir", None)
    if kept or "JAX_COMPILATION_CACHE_DIR" in os.environ:
        return
    jax.config.update("jax_compilation_cache_dir", str(folder))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.5)
    jax.config.update("jax_persistent_cache_min_entry_size_bytes", -1)


def _take_programs(ours: Path) -> bool:
    """Let JAX read and write its programs in the folder `ours` through the store; gives whether
    this version of JAX has a way to do so."""
    try:
        from jax._src import compilation_cache
        from jax._src.compilation_cache_interface import CacheInterface

        files_of = compilation_cache.get_file_cache
    except (ImportError, AttributeError):
        return False

    class Programs(CacheInterface):
        """JAX's way to what it keeps."""

        def __init__(self, path: str) -> None:
            self._path = Path(path)

        def get(self, key: str) -> bytes | None:
            return _PROGRAMS.get(key)

        def put(self, key: str, value: bytes) -> None:
            _PROGRAMS.put(key, value)

    def file_cache(path: str) -> tuple[CacheInterface, str] | None:
        found: tuple[CacheInterface, str] | None = files_of(path)
        with suppress(OSError):
            if Path(path) == cache_folder() / "jax":
                return Programs(path), path
        return found

    if not hasattr(files_of, "of_fynjax"):
        file_cache.of_fynjax = True  # type: ignore[attr-defined]
        compilation_cache.get_file_cache = file_cache
    return True


def error_of_sums() -> float:
    """Relative error of a reduction that one version of jaxlib got wrong on processors, about every
    second time: the largest of ten."""
    import jax
    import jax.numpy as jnp
    import numpy as np

    random = np.random.default_rng(0)
    left, right = (
        random.normal(size=size).astype(np.float32) for size in ((4, 120, 120), (4, 4, 120, 120))
    )
    total = jax.jit(lambda a, b: jnp.sum(a[:, None] * b, axis=0))
    exact = np.einsum("ars,abrs->brs", left.astype(float), right.astype(float))
    off = [np.abs(total(left, right) - exact).max() for _ in range(10)]
    return float(np.max(off) / np.abs(exact).max())  # NaN where one is


def check_sums_once() -> None:
    """Check sums with each version of jaxlib, kind of device and flags once: that they were right
    is kept in the store.

    **Raises:** `RuntimeError` with the way out, where they are wrong.
    """
    import jax

    flags = os.environ.get("XLA_FLAGS", "")
    code = code_hash("_core/compiler.py")
    key = f"jaxlib {version('jaxlib')} {jax.default_backend()} {flags} {code}"
    if _SUMS.get(key) is not None:
        return
    off = error_of_sums()
    if not off <= WRONG_BY:
        raise RuntimeError(
            f"jaxlib {version('jaxlib')} computes wrong sums on this machine (relative error "
            f"{off:.1g}), and so would every image be. `fynjax doctor` says what is wrong; a way "
            f"out is the environment variable XLA_FLAGS={OWN_SUMS}, or another version of JAX"
        )
    _SUMS.put(key, b"right")
