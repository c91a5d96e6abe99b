"""Files in and out. Each sub-package reads and writes one kind of file, and is imported when it is
first used."""

import lazy_loader

__getattr__, __dir__, _ = lazy_loader.attach(
    __name__, ["captures", "frames", "instruments", "plot", "raster", "spectra", "text"]
)
