"""The 2006 burn plot of the article: its files, its calibration, its recovery after fire."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
