"""Moss layers: carpets of Hylocomium, Hypnum, Pleurozium or Sphagnum; their plant is a patch."""

from fynjax.canopy._elements import Crown, Foliage, Shoots
from fynjax.canopy._form import FormPrior, GrowthForm, LeafGeometry, Taxa

FORM = GrowthForm(
    description="Carpet of a few centimetres, as good as flat and closed, of minute leaves on "
    "crowded upright shoots that are brown below; a plant is a patch of it.",
    sources="Leaf area: of bryophytes in boreal stands it peaks at 3.1 and 3.7 (Bond-Lamberty and "
    "Gower 2007, Oecologia 151:584), known to a half. All else: assumed; leaves are one cell "
    "thick, so that they hold little chlorophyll, and drawn as leafy branchlets of a feather moss.",
    leaf_area_index=3.4,
    wood_area_index=0.05,
    flower_fraction=0.0,
    shoot_clumping=0.30,
    dead_fraction=0.30,
    leaf_angle="spherical",
    leaf_diameter=0.0026,
    prior=FormPrior(
        dead_fraction=(0.30, 0.21), leaf_area_index=(3.4, 1.7), shoot_clumping=(0.30, 0.15)
    ),
    diameter=0.15,
    height=0.05,
    crown=Crown(0.0, 0.5, 8.0, 8.0, height_power=1.0, shell_power=0.0),
    shoots=Shoots(40, 0.45, (0.05, 0.48), (0.70, 0.95), 1.0, 0.5),
    foliage=Foliage(200, 0.055, 0.35, outline=0.30, uneven=0.10, bare=0.0),
    leaf=LeafGeometry("blade", "lanceolate", 0.005, 0.0018),
    leaf_mass_per_area=40.0,
    water_content=0.80,
    stand_share=0.05,
    chlorophyll=15.0,
    carotenoids=4.0,
    flat_leaved=Taxa(
        genera="Bryum Campylopus Ceratodon Cetraria Cladonia Dicranum Homalothecium "
        "Hylocomium Hypnum Leucobryum Pleurozium Polytrichum Ptilidium "
        "Racomitrium Rhytidiadelphus Scleropodium Sphagnum",
        families="Bryaceae Dicranaceae Hylocomiaceae Hypnaceae Polytrichaceae Sphagnaceae",
    ),
)
