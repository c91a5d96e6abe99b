"""Work on one data set each: `fynbos_2006`, the article's plot, and `bioscape`; each is imported
when it is first used."""

import lazy_loader

__getattr__, __dir__, _ = lazy_loader.attach(__name__, ["bioscape", "fynbos_2006"])
