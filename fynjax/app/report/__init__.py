"""What a person looks at after a run: figures and pages, nothing else. Imported when first used."""

import lazy_loader

__getattr__, __dir__, _ = lazy_loader.attach(__name__, ["figures", "pages"])
