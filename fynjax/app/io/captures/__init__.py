"""Raw captures of multispectral cameras (MicaSense, DJI) and of their reference panels."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
