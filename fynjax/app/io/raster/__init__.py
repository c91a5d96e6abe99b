"""Rasters in and out: images, cubes, maps, and where they lie on Earth.

Imported when first used.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
