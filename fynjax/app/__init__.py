"""What is built on the library: files, comparisons with measurements, pages, jobs and commands.

The library (`fynjax.leaf` to `fynjax.inversion`) imports nothing of it, and needs fewer packages.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
