"""Assumed properties of plants that the BioSCape tables lack: form, size, leaf shape, pigments.

All of it is assumed, from the botany of genera and families of the Cape and from the plot that
this program ships. Each value goes into a plot's files with the word for where it came from.
"""

import math
from dataclasses import dataclass
from functools import lru_cache

from fynjax.io.plot import FACTORS
from fynjax.leaf import FLAT, ROUND

ERICOID, DOME, TUFT, BROAD, TWINER = (
    "upright_ericoid", "rounded_shrub", "tussock", "broad_leaved", "climber",
)  # fmt: skip

_GENERA = {
    (ERICOID, ROUND): "Aspalathus Aulax Cyclopia Disparago Elytropappus Metalasia Stoebe Thesium",
    (ERICOID, FLAT): "Amphithalea Anthospermum Clutia Polygala Psoralea Rafnia",
    (DOME, ROUND): "Paranomus Serruria Sorocephalus Spatalla",
    (DOME, FLAT): "Diastella",
    (TUFT, FLAT): "Corymbium",
    (TUFT, ROUND): "Bobartia",
    (BROAD, FLAT): "Osteospermum Osyris Podalyria Virgilia",
    (BROAD, ROUND): "Hakea Pinus",
    (TWINER, ROUND): "Cassytha",
}
_FAMILIES = {
    (ERICOID, ROUND): "Bruniaceae Ericaceae Grubbiaceae Rhamnaceae Santalaceae Stilbaceae "
    "Thymelaeaceae",
    (ERICOID, FLAT): "Peraceae Polygalaceae Rosaceae Rubiaceae Rutaceae",
    (DOME, ROUND): "Aizoaceae Crassulaceae",
    (DOME, FLAT): "Apiaceae Apocynaceae Asteraceae Boraginaceae Campanulaceae Fabaceae "
    "Geissolomataceae Gentianaceae Geraniaceae Lamiaceae Malvaceae Penaeaceae Roridulaceae "
    "Scrophulariaceae Solanaceae Zygophyllaceae",
    (TUFT, ROUND): "Cyperaceae Juncaceae Restionaceae",
    (TUFT, FLAT): "Amaryllidaceae Asparagaceae Asphodelaceae Haemodoraceae Hyacinthaceae Iridaceae "
    "Orchidaceae Poaceae Tecophilaeaceae",
    (BROAD, FLAT): "Anacardiaceae Aquifoliaceae Araliaceae Celastraceae Cunoniaceae Ebenaceae "
    "Myricaceae Myrtaceae Oleaceae Pittosporaceae Primulaceae Proteaceae Salicaceae Sapindaceae "
    "Sapotaceae",
    (BROAD, ROUND): "Cupressaceae Pinaceae",
    (TWINER, FLAT): "Convolvulaceae Cucurbitaceae Menispermaceae",
}

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
    for name, table, source in ((genus, _GENERA, "genus"), (family, _FAMILIES, "family")):
        for (form, ratio), names in table.items():
            if name in names.split():
                return PlantShape(form, source, ratio)
    return PlantShape(DOME, "default", FLAT)


@dataclass(frozen=True)
class PlantSize:
    """Size of a plant."""

    crown_diameter_m: float
    """Mean [m]."""
    height_m: float
    """Greatest in a plot [m]."""
    source: str


@lru_cache
def plant_size(family: str, growth_form: str) -> PlantSize:
    """Size of a grown plant of fynbos that burnt some 6 to 17 years ago."""
    if family == "Proteaceae" and growth_form == BROAD:
        return PlantSize(
            1.0, 1.4, "height: Kraaij et al. 2013, Applied Vegetation Science 16:84 (127 to 148 cm "
            "at 6 to 15 years, mean of three Proteaceae); crown: assumed",
        )  # fmt: skip
    from fynjax.canopy import table1_2006

    table = table1_2006()
    rows = table[table["growth_form"] == growth_form]
    return PlantSize(
        float(rows["mean_diameter_cm"].mean()) / 100,
        float(rows["height_max_m"].mean()),
        f"mean of {len(rows)} taxa of this form in the shipped table of a plot burnt in 2006",
    )


def pigments(growth_form: str) -> dict[str, float]:
    """Pigments in PROSPECT's units; those of the shipped plot's leaves.

    Nitrogen is not turned into chlorophyll: how much of a leaf's nitrogen its chlorophyll holds
    is known for crops (Evans 1989, Oecologia 78:9), not for sclerophyllous leaves and culms. Brown
    pigments are a trace: what is brown of a shoot is its dead tissue.
    """
    chlorophyll, carotenoids, anthocyanins = {
        TUFT: (50.0, 10.0, 1.5),
        BROAD: (65.0, 13.0, 1.5),
        TWINER: (15.0, 5.0, 2.0),
    }.get(growth_form, (60.0, 12.0, 1.5))
    return {
        "chlorophyll": chlorophyll,
        "carotenoids": carotenoids,
        "anthocyanins": anthocyanins,
        "brown_pigments": 0.03,
    }


ASSUMED_POPULATION = {
    "dead_fraction.upright_ericoid": 0.40,
    "dead_fraction.rounded_shrub": 0.30,
    "dead_fraction.tussock": 0.45,
    "dead_fraction.broad_leaved": 0.25,
    "dead_fraction.climber": 0.30,
    "leaf_area_index.upright_ericoid": 2.5,
    "leaf_area_index.rounded_shrub": 3.0,
    "leaf_area_index.tussock": 2.0,
    "leaf_area_index.broad_leaved": 3.5,
    "leaf_area_index.climber": 1.5,
    "shoot_clumping.upright_ericoid": 0.5,
    "shoot_clumping.rounded_shrub": 0.4,
    "shoot_clumping.tussock": 0.2,
    "shoot_clumping.broad_leaved": 0.2,
    "shoot_clumping.climber": 0.2,
    **dict.fromkeys(FACTORS, 1.0),
}
"""What plots share (`PRIOR_PARAMETERS`) before any population is learned: the centre of the prior
of `fynjax learn`. Leaf areas lie in the range of 0.5 to 4 that shrub crowns commonly
show. Shares of dead tissue are near those with which the spectra of 18 BioSCape plots agree best
when each form has one value and these leaf areas; that of climbers is assumed. Clumping is that of
a pine shoot, 0.44, for small leaves along a twig, and less for culms, threads and large leaves."""

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


def random_packing(crowns: float, live: float) -> float:
    """Share of crowns over other crowns [-] with which random crowns cover the share `live`.

    Crowns of a total area `t` per ground area, set at random, cover 1 - exp(-t) of the ground.
    `crowns` is the sum of the covers [-], to which t is `crowns / (1 - packing)` (equation 8).
    0 where the covers alone cover more than `live`.
    """
    total = -math.log1p(-min(live, CLOSED_COVER))
    return max(0.0, 1.0 - crowns / total) if total > 0 else 0.0
