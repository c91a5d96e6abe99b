"""The 2006 burn plot of the article: its recovery after fire."""

from fynjax.studies.fynbos_2006._recovery import (
    SURVEY_YEAR,
    GroundAfterFire,
    ground_after_fire,
    table_after_fire,
)

__all__ = [
    "SURVEY_YEAR",
    "GroundAfterFire",
    "ground_after_fire",
    "table_after_fire",
]
