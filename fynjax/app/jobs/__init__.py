"""The jobs of the commands: read, compute, write. One function a command.

The command line calls them, and so can a notebook, as
`fynjax.app.jobs.render_plot("plot.toml", "output")`. They are imported when they are first used.
"""

from typing import Any

import lazy_loader

_found, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)


def __getattr__(name: str) -> Any:
    """A job, imported when it is first used.

    **Raises:** `MissingExtraError` where a package that the app needs is not installed.
    """
    from fynjax._core.errors import MissingExtraError  # late: `import fynjax` is quick

    return MissingExtraError.unless_found(_found, name)
