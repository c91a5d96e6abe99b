"""Rosettes: long leaves from one foot such as Agave, Yucca, Puya and stemless Aloe."""

from fynjax.canopy._elements import Foliage, Shoots, along_shoots
from fynjax.canopy._form import FormPrior, GrowthForm, LeafGeometry, Taxa

FORM = GrowthForm(
    description="Stiff thick leaves that taper from one foot in all directions, the inner ones "
    "upright, the outer ones low and far out. No wood and no visible flowers.",
    sources="All assumed, sizes as of a small Agave. Leaves are round and taper to two fifths; "
    "their half surface is that of flat ones pi/2 times as wide.",
    leaf_area_index=2.5,
    wood_area_index=0.0,
    flower_fraction=0.0,
    shoot_clumping=0.05,
    dead_fraction=0.10,
    leaf_angle="spherical",
    leaf_diameter=0.070,
    prior=FormPrior(
        dead_fraction=(0.10, 0.09), leaf_area_index=(2.5, 1.25), shoot_clumping=(0.05, 0.025)
    ),
    diameter=0.60,
    height=0.45,
    shoots=Shoots(36, 0.06, (0.20, 0.50), (0.15, 1.00), 0.9, 0.60),
    foliage=Foliage(36, 0.0, 0.0, outline=0.20, uneven=0.0, bare=0.0),
    leaf_elements=along_shoots(0.0, 1.0),
    leaf=LeafGeometry("stem", width=0.035),
    leaf_mass_per_area=300.0,
    water_content=0.85,
    round_leaves=True,
    stand_share=0.05,
    round_leaved=Taxa(
        genera="Agave Dasylirion Eryngium Hechtia Nolina Puya Xanthorrhoea Yucca",
        families="Bromeliaceae",
    ),
)
