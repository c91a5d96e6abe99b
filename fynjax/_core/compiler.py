"""The compiler of JAX: versions that compute wrong numbers, and where its programs are kept."""

import os
from importlib.metadata import version
from pathlib import Path

WRONG_SUMS = ("0.10.2", "0.11.0")
"""Versions of jaxlib whose reductions on a processor may overwrite each other's sums: an image of a
frame camera gets its first bands in place of the others, depending on processor, threads and size,
without a word (github.com/jax-ml/jax/issues/39103)."""
_WITHOUT = "--xla_cpu_experimental_ynn_fusion_type=-reduce"
"""XLA then makes its own reductions, which are right."""


def refuse_wrong_sums() -> None:
    """Go no further with a compiler that gives wrong numbers silently.

    **Raises:** `ImportError` with what to install instead.
    """
    found = version("jaxlib")
    if found in WRONG_SUMS and _WITHOUT not in os.environ.get("XLA_FLAGS", ""):
        raise ImportError(
            f"jaxlib {found} computes wrong sums on processors, and so wrong images. Install "
            'another: pip install "jax==0.10.1" "jaxlib==0.10.1" (or set the environment variable '
            f"XLA_FLAGS={_WITHOUT})"
        )


def cache_folder() -> Path:
    """Folder of JAX's compiled programs: `XDG_CACHE_HOME/fynjax`, or `~/.cache/fynjax`."""
    base = os.environ.get("XDG_CACHE_HOME")
    return (Path(base) if base else Path.home() / ".cache") / "fynjax"


def keep_compiled() -> None:
    """Keep compiled programs for the next process, unless the environment variable
    JAX_COMPILATION_CACHE_DIR says where, or the process has said so already: in `cache_folder`."""
    import jax  # late: help and errors of the command line need none

    kept = getattr(jax.config, "jax_compilation_cache_dir", None)
    if kept or "JAX_COMPILATION_CACHE_DIR" in os.environ:
        return
    folder = cache_folder() / "jax"
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:
        return  # a home that cannot be written costs compilation time, nothing else
    jax.config.update("jax_compilation_cache_dir", str(folder))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.5)
    jax.config.update("jax_persistent_cache_min_entry_size_bytes", -1)
