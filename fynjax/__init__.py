"""fynjax: an open, differentiable simulator of low-stature, species-rich shrubland.

`import fynjax as fx` is quick: what follows is imported when it is first used.

- `fx.Scene.from_table`, `fx.observe`: a scene from a species table, and what a sensor measures.
- `fx.Leaf` (short for `fx.LeafParameters`), `fx.prospect`, `fx.fit_leaf`: leaf optics, forward and
  backward.
- `fx.canopy_reflectance`, `fx.canopy_albedo`, `fx.fit_canopy`: a uniform canopy in one line, and
  backward.
- `fx.read_plot`, `fx.sensor`: a plot, and a sensor or LiDAR, from files or by a shipped name.
- `fx.calibrate`, `fx.posterior`: what the commands of these names do, from Python.
- `fx.fit`, `fx.ParameterSpace`, `fx.Data`: any forward model fitted to any statistics, by
  `fx.BroydenLM` or any solver of optimistix and jaxopt; `fx.whitened_residual` for one's own loop.
- `fx.cite`: BibTeX of the models used.
- `fx.errors`: what a user's input can raise; `fx.jobs` and the other packages by their names.
"""

import lazy_loader

__version__ = "0.1.0"
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
