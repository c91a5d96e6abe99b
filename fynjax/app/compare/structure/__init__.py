"""Two point clouds compared: heights above ground, cells, structure metrics with intervals."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
