"""Leaf succulents: shrublets with swollen leaves such as Sedum, Suaeda and many vygies."""

from fynjax.canopy._elements import Crown, Foliage, Shoots
from fynjax.canopy._form import FormPrior, GrowthForm, LeafGeometry, Taxa

FORM = GrowthForm(
    description="Low rounded shrublet with thick leaves at the ends of its many shoots and gaps "
    "between these.",
    sources="All assumed; water as of leaves that are 2 mm thick.",
    leaf_area_index=2.5,
    wood_area_index=0.30,
    flower_fraction=0.05,
    shoot_clumping=0.15,
    dead_fraction=0.15,
    leaf_angle="spherical",
    leaf_diameter=0.011,
    prior=FormPrior(
        dead_fraction=(0.15, 0.13), leaf_area_index=(2.5, 1.25), shoot_clumping=(0.15, 0.075)
    ),
    diameter=0.40,
    height=0.30,
    crown=Crown(0.0, 0.40, 2.0, 2.2, height_power=0.3, shell_power=2.0),
    shoots=Shoots(18, 0.05, (0.05, 0.42), (0.35, 0.90), 1.0, 0.5),
    foliage=Foliage(60, 0.07, 0.16, outline=0.30, uneven=0.15, bare=0.03),
    leaf=LeafGeometry("blade", "elliptic", 0.020, 0.008),
    leaf_mass_per_area=150.0,
    water_content=0.91,
    round_leaves=True,
    stand_share=0.05,
    chlorophyll=35.0,
    carotenoids=8.0,
    flat_leaved=Taxa(genera="Sedum"),
    round_leaved=Taxa(genera="Arthrocnemum Opuntia Salicornia Sarcocornia Suaeda"),
)
