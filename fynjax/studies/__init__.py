"""Work on data sets and questions of its own: `fynbos_2006`, the article's plot; `bioscape`;
`communities`, what sensors can know of diversity. Each is imported when it is first used."""

import lazy_loader

__getattr__, __dir__, _ = lazy_loader.attach(__name__, ["bioscape", "communities", "fynbos_2006"])
