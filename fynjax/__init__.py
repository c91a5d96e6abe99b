"""fynjax: an open, differentiable simulator of low-stature, species-rich shrubland.

Start here: a plot, what a drone's camera sees of it, and how that changes with the plants.

    import fynjax as fx, jax
    scene = fx.read_scene(size=2.0)                      # the shipped plot, or "species.csv"
    image = fx.observe(scene, "mavic_3m", pixel=0.1)     # image["nir"], image.index("NDVI")
    ndvi = lambda p: fx.observe(scene, "mavic_3m", pixel=0.1, parameters=p).index("NDVI").mean()
    jax.grad(ndvi)(scene.parameters).species.cover       # a slope for each species

`import fynjax as fx` is quick: what follows is imported when it is first used.

- `fx.read_scene`, `fx.Scene.from_table`: a scene from a plot file or a species table, or from a
  frame or records. `fx.observe`, `fx.sensor`: what a sensor measures of it; `scene.parameters` are
  what gradients and fits are by. `fx.pixel_truth`: which species each pixel sees.
- `fx.lit_view`, `fx.photo`: the plants of a scene, and an image of them, in colours to look at.
- `fx.information`: how well an image can tell parameters, for each size of pixel.
- `fx.design`: the most informative bands of a camera on a stand.
- `fx.free`, `fx.prior`, `fx.Data`, `fx.fit`, `fx.sample`: the arrow backwards, of a scene or of any
  function, by `fx.BroydenLM` or any solver of optimistix and jaxopt; `fx.whitened_residual` for a
  loop of one's own, `fx.emulate` for a polynomial in place of a costly function;
  `fx.check_vegetation` before any fit: is this an image that shrubland can have?
- `fx.find_plants`: which plants stand where, in the pixels of an orthophoto.
- `fx.Leaf` (short for `fx.LeafParameters`), `fx.prospect`: leaf optics; `fx.read_spectra`,
  `fx.fit_leaf`: from a folder of measured leaves to their traits.
- `fx.canopy_reflectance`, `fx.canopy_albedo`, `fx.fit_canopy`: a uniform canopy in one line, and
  backward.
- `fx.diversity`: diversity of covers and of images, and how well species separate.
- `fx.jobs`: what the commands do, from Python.
- `fx.progress`: bars of how far long work is, `with fx.progress(): ...`; the logger `fynjax` has
  its stages too.
- `fx.cite`: BibTeX of the models used.
- `fx.errors`: what a user's input can raise; the other packages by their names.
"""

import os
from typing import Any

import lazy_loader

# Compiled programs that are kept are read with lines of false alarm: settings of this machine's own
# compiler are called features that it lacks. JAX asks for this when it is first imported.
os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")
__version__ = "0.2.0"
_found, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)


def __getattr__(name: str) -> Any:
    """A name of the front door, imported when it is first used.

    **Raises:** `MissingExtraError` where a package that the app needs is not installed.
    """
    from fynjax._core.errors import MissingExtraError  # late: `import fynjax` is quick

    return MissingExtraError.unless_found(_found, name)
