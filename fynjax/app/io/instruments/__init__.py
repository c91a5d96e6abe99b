"""Files of instruments: sensors, LiDAR systems and clouds, atmospheres; scenes as meshes."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
