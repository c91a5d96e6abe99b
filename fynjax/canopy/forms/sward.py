"""Swards: meadow, pasture and lawn, grasses that stand as a carpet; their plant is a patch."""

from fynjax.canopy._elements import Foliage, Shoots, along_shoots
from fynjax.canopy._form import FormPrior, GrowthForm, LeafGeometry, Taxa

FORM = GrowthForm(
    description="Carpet of upright blades that rise from all of the ground of a patch, arched at "
    "their ends and of many lengths, with dead ones at the base; no crown stands apart. Counted as "
    "leaf; a plant is a patch of it.",
    sources="Leaf area: that of grasslands, 1.7 with standard deviation 1.2 green (Asner et al. "
    "2003, Global Ecology and Biogeography 12:191), all over the ground of the patch. All else: "
    "assumed; leaf mass and water those of a grass.",
    leaf_area_index=2.4,
    wood_area_index=0.05,
    flower_fraction=0.02,
    shoot_clumping=0.05,
    dead_fraction=0.30,
    leaf_angle="erectophile",
    leaf_diameter=0.0044,
    prior=FormPrior(
        dead_fraction=(0.30, 0.21), leaf_area_index=(2.4, 1.7), shoot_clumping=(0.05, 0.05)
    ),
    diameter=0.30,
    height=0.15,
    shoots=Shoots(260, 0.42, (0.02, 0.50), (0.80, 1.00), 1.6, 0.5),
    foliage=Foliage(260, 0.0, 0.0, outline=0.30, uneven=0.30, bare=0.0),
    leaf_elements=along_shoots(0.0, 1.0),
    wood_elements=along_shoots(0.0, 0.2),
    flower_elements=along_shoots(0.85, 1.0),
    leaf=LeafGeometry("culm", width=0.0022),
    leaf_mass_per_area=60.0,
    water_content=0.70,
    stand_share=0.05,
    chlorophyll=45.0,
    carotenoids=9.0,
    flat_leaved=Taxa(genera="Cynodon Cynosurus Lolium Phleum Stenotaphrum Zoysia"),
)
