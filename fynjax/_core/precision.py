"""Which numbers have 64 bits and which have 32: the rule, in one place.

Light is computed in the precision of the scene, which is float32 for a plot (`build_scene` takes
another `dtype`). Leaf inversion, the small systems of a fit (its Jacobian, its covariance), counts
of plants and a camera's radiometry are computed in float64: in float32 small differences of large
numbers would be lost there.

JAX makes float32 of everything unless `jax_enable_x64` is set, for the whole process. Importing
`fynjax.leaf`, `fynjax.scene`, `fynjax.inversion`, `fynjax.io.micasense` or a function of
`fynjax.jobs` sets it. The environment variable `JAX_ENABLE_X64` goes before: with 0 JAX stays at 32
bits, and what needs 64 raises an `InputError`. `fynjax.canopy`, `fynjax.radiation`,
`fynjax.sensors` and `fynjax.metrics` compute in the precision of their arrays and set nothing.
"""

import os

import jax

from fynjax._core.errors import InputError


def enable_double_precision() -> None:
    """Let JAX compute in 64 bits, unless the environment variable JAX_ENABLE_X64 decides."""
    if "JAX_ENABLE_X64" not in os.environ:
        jax.config.update("jax_enable_x64", True)


def require_double_precision(what: str) -> None:
    """Refuse to go on in 32 bits.

    **Arguments:** `what` needs 64 bits, the subject of the message.

    **Raises:** `InputError` if JAX is limited to 32 bits.
    """
    if not jax.config.read("jax_enable_x64"):
        raise InputError(
            f"{what} needs numbers of 64 bits, but JAX is set to 32. Leave out the environment "
            'variable JAX_ENABLE_X64=0, or call jax.config.update("jax_enable_x64", True)'
        )
