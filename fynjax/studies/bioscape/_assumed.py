"""Assumed properties of plants that the BioSCape tables lack: form, size, leaf shape, pigments.

All of it is assumed, from the botany of genera and families of the Cape and from the plot that
this program ships. Each value goes into a plot's files with the word for where it came from.
"""

import math
from dataclasses import dataclass

from fynjax.app.io.plot import FACTORS, assumed_by_form
from fynjax.canopy import FORMS, form_of_taxon
from fynjax.leaf import FLAT, ROUND

DOME = "rounded_shrub"
"""Growth form of plants of which neither genus nor family is known here."""

OLD_GENERA = {
    "Calopsis": "Restio", "Chondropetalum": "Elegia", "Chrysanthemoides": "Osteospermum",
    "Dicerothamnus": "Elytropappus", "Dovea": "Elegia", "Ischyrolepis": "Restio",
    "Nebelia": "Brunia", "Raspalia": "Brunia", "Rhus": "Searsia", "Seriphium": "Stoebe",
}  # fmt: skip
"""Genera of older floras, or of newer ones than the tables, and the genus that the tables use."""


@dataclass(frozen=True)
class PlantShape:
    """Form of a plant and shape of its leaves."""

    growth_form: str
    source: str
    """'genus' or 'family' of the plant, or 'default' where neither is known here."""
    area_ratio: float
    """Half of a leaf's surface over its projected area [-], `FLAT` or `ROUND`."""


def plant_shape(genus: str, family: str) -> PlantShape:
    """Form and leaf shape of a genus, else of its family, else a rounded shrub with flat leaves."""
    found = form_of_taxon(genus, family)
    if found is not None:
        return PlantShape(found.growth_form, found.source, ROUND if found.round_leaves else FLAT)
    return PlantShape(DOME, "default", FLAT)


@dataclass(frozen=True)
class PlantSize:
    """Size of a plant."""

    crown_diameter_m: float
    """Mean diameter of the crown [m]."""
    height_m: float
    """Height of the tallest plants of a plot [m]."""
    source: str


def plant_size(family: str, growth_form: str) -> PlantSize:
    """Size of a grown plant of fynbos that burnt some 6 to 17 years ago."""
    if family == "Proteaceae" and growth_form == "broad_leaved":
        return PlantSize(
            1.0, 1.4, "height: Kraaij et al. 2013, Applied Vegetation Science 16:84 (127 to 148 cm "
            "at 6 to 15 years, mean of three Proteaceae); crown: assumed",
        )  # fmt: skip
    form = FORMS[growth_form]
    return PlantSize(form.diameter, form.height, form.size_source)


def pigments(growth_form: str) -> dict[str, float]:
    """Pigments in PROSPECT's units; those of the shipped plot's leaves.

    Nitrogen is not turned into chlorophyll: how much of a leaf's nitrogen its chlorophyll holds
    is known for crops (Evans 1989, Oecologia 78:9), not for sclerophyllous leaves and culms. Brown
    pigments are a trace: what is brown of a shoot is its dead tissue.
    """
    form = FORMS[growth_form]
    return {
        "chlorophyll": form.chlorophyll,
        "carotenoids": form.carotenoids,
        "anthocyanins": form.anthocyanins,
        "brown_pigments": 0.03,
    }


ASSUMED_POPULATION = {
    **{name: median for name, (median, _) in assumed_by_form().items()},
    **dict.fromkeys(FACTORS, 1.0),
}
"""What plots share (`PRIOR_PARAMETERS`) before any population is learned: the centre of the prior
of `fynjax bioscape learn`. By growth form it is what the form itself assumes
(`GrowthForm.prior`)."""

MOST_WATER = 0.05
"""Water of a leaf is at most this [cm]: that of the thickest leaves that PROSPECT was made with
(LOPEX, Jacquemoud et al. 1996). Culms and succulent leaves hold more, deeper than the light comes
that a layer of leaf cells sends back; PROSPECT would put all of it in its way."""

DEFAULT_TRAITS = {"leaf_mass_per_area": 200.0, "water_content": 52.0}
"""For a form of which the library has no measured species [g m-2, %]: a sclerophyllous leaf."""

STANDING_DEAD = 0.5
"""Share of the dead cover that stands, the rest is litter [-]. The tables do not
distinguish the two, so neither is preferred."""

OPEN_GROUND_LITTER = 0.5
"""Share of the ground under litter where a plot shows no ground at all [-]."""

CLOSED_COVER = 0.95
"""Crowns set at random never close: a higher live cover is planted as this [-]."""

PLOT_SIDE_M = 10.0
"""The plots are circles of 10 m (doi:10.3334/ORNLDAAC/2425, same protocol); here squares [m]."""


COVERS_MEAN = (
    'Covers are those of cover_definition = "article", with the packing at which all crowns of a '
    "plot together, at random, cover what crews saw live or standing dead from above."
)
"""Meaning of the covers of these plots, for pages and summaries."""


def random_packing(crowns: float, live: float) -> float:
    """Share of crowns over other crowns [-] with which random crowns cover the share `live`.

    Crowns of a total area `t` per ground area, set at random, cover 1 - exp(-t) of the ground.
    `crowns` is the sum of the covers [-], to which t is `crowns / (1 - packing)` (equation 8).
    0 where the covers alone cover more than `live`.
    """
    total = -math.log1p(-min(live, CLOSED_COVER))
    return max(0.0, 1.0 - crowns / total) if total > 0 else 0.0
