"""Mats: prostrate shrubs on creeping stems such as Empetrum, Dryas, Thymus and bearberry."""

from fynjax.canopy._elements import Crown, Foliage, Shoots
from fynjax.canopy._form import FormPrior, GrowthForm, LeafGeometry, Taxa

FORM = GrowthForm(
    description="Flat sheet that is many times as broad as high, its top nearly level up to the "
    "rim; stems creep outwards along the ground and rise at their ends, with small leaves.",
    sources="Leaf area: green 2.6 over the mat, as crowns of shrublands at large have (Asner et "
    "al. 2003, Global Ecology and Biogeography 12:191), known to a half. All else: assumed.",
    leaf_area_index=3.5,
    wood_area_index=0.20,
    flower_fraction=0.03,
    shoot_clumping=0.20,
    dead_fraction=0.25,
    leaf_angle="plagiophile",
    leaf_diameter=0.0054,
    prior=FormPrior(
        dead_fraction=(0.25, 0.1875), leaf_area_index=(3.5, 1.75), shoot_clumping=(0.20, 0.10)
    ),
    diameter=0.30,
    height=0.06,
    crown=Crown(0.0, 0.4, 2.0, 8.0, height_power=0.5, shell_power=0.0),
    shoots=Shoots(60, 0.05, (0.05, 0.48), (0.40, 0.90), 0.3, 0.6),
    foliage=Foliage(120, 0.06, 0.35, outline=0.35, uneven=0.15, bare=0.02),
    leaf=LeafGeometry("blade", "elliptic", 0.010, 0.004),
    leaf_mass_per_area=130.0,
    water_content=0.55,
    stand_share=0.05,
    chlorophyll=50.0,
    carotenoids=10.0,
    flat_leaved=Taxa(
        genera="Antennaria Dryas Fumana Helianthemum Herniaria Loiseleuria Teucrium "
        "Thymus Trifolium"
    ),
    round_leaved=Taxa(genera="Empetrum Kalmia"),
)
