"""Columns: leafless stem succulents such as Hoodia, columnar Euphorbia and cacti."""

from fynjax.canopy._elements import Foliage, Shoots, along_shoots
from fynjax.canopy._form import FormPrior, GrowthForm, LeafGeometry, Taxa

FORM = GrowthForm(
    description="A clump of thick green stems without leaves, nearly upright from feet side by "
    "side, the inner ones taller; counted as leaf. No wood and no visible flowers.",
    sources="Stems 25 to 50 mm thick and to 1 m long, plants to 1 m tall and 0.6 m broad: Hoodia "
    "gordonii (worldfloradb.net). Fourteen stems of 38 mm on a crown of 0.4 m make a leaf area "
    "(half their surface) of 2 to 3. A round stem shades itself nowhere: clumping is that of its "
    "ribs and spines, assumed, as is all else. PROSPECT lets light through a leaf; through such a "
    "stem none comes.",
    leaf_area_index=2.5,
    wood_area_index=0.0,
    flower_fraction=0.0,
    shoot_clumping=0.05,
    dead_fraction=0.10,
    leaf_angle="erectophile",
    leaf_diameter=0.076,
    prior=FormPrior(
        dead_fraction=(0.10, 0.09), leaf_area_index=(2.5, 1.25), shoot_clumping=(0.05, 0.025)
    ),
    diameter=0.40,
    height=0.50,
    shoots=Shoots(14, 0.40, (0.05, 0.50), (0.45, 1.00), 1.0, 0.1),
    foliage=Foliage(14, 0.0, 0.0, outline=0.30, uneven=0.0, bare=0.0),
    leaf_elements=along_shoots(0.0, 1.0),
    leaf=LeafGeometry("stem", width=0.038),
    leaf_mass_per_area=400.0,
    water_content=0.90,
    round_leaves=True,
    stand_share=0.05,
    round_leaved=Taxa(
        genera="Carnegiea Cereus Echinopsis Eulychnia Ferocactus Hoodia Pachycereus Stenocereus",
        families="Cactaceae",
    ),
)
