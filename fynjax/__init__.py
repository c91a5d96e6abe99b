"""fynjax: an open, differentiable simulator of low-stature, species-rich shrubland."""

__version__ = "0.1.0"
