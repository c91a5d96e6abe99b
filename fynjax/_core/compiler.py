"""Compilers of JAX that are known to compute wrong numbers."""

import os
from importlib.metadata import version

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
