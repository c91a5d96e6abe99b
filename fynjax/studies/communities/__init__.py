"""Diversity as sensors can know it: communities drawn along gradients, planted and observed."""

from fynjax.studies.communities._draw import Gradients, draw_community
from fynjax.studies.communities._job import DiversityResult, diversity

__all__ = ["DiversityResult", "Gradients", "diversity", "draw_community"]
