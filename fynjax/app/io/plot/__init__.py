"""A plot as its files describe it: plot file, species and leaf tables, statistics."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
