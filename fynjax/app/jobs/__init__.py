"""The jobs of the commands: read, compute, write. One function a command.

The command line calls them, and so can a notebook, as
`fynjax.app.jobs.render_plot("plot.toml", "output")`. They are imported when they are first used.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
