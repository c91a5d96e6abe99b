"""Cushions: low dense domes such as Azorella, and the mat-like shrubs of Muraltia and Erica."""

from fynjax.canopy._elements import Crown, Foliage, Shoots
from fynjax.canopy._form import FormPrior, GrowthForm, LeafGeometry, Taxa

FORM = GrowthForm(
    description="Hemisphere resting on the ground, an even closed surface of many small leaf "
    "rosettes at the ends of short stems that rise from one foot; bare or dead leaves inside.",
    sources="Shape and dead leaves that stay inside: hemispherical cushions of the catalogue of "
    "Aubert et al. 2014 (Alpine Botany 124:59; cushionplants.osug.fr). All numbers: assumed; leaf "
    "area and clumping as of dense domes (rounded_shrub), of which they are the dense end, leaf "
    "mass and water those of a sclerophyllous leaf.",
    leaf_area_index=4.0,
    wood_area_index=0.30,
    flower_fraction=0.05,
    shoot_clumping=0.40,
    dead_fraction=0.45,
    leaf_angle="spherical",
    leaf_diameter=0.0018,
    prior=FormPrior(
        dead_fraction=(0.45, 0.2475), leaf_area_index=(4.0, 2.0), shoot_clumping=(0.4, 0.2)
    ),
    diameter=0.30,
    height=0.12,
    crown=Crown(0.0, 0.1, 2.0, 2.0, height_power=0.0, shell_power=6.0),
    shoots=Shoots(24, 0.04, (0.05, 0.45), (0.40, 0.90), 1.0, 0.6),
    foliage=Foliage(200, 0.055, 0.12, outline=0.25, uneven=0.04, bare=0.02),
    leaf=LeafGeometry("blade", "linear", 0.004, 0.0012),
    leaf_mass_per_area=200.0,
    water_content=0.52,
    stand_share=0.05,
    flat_leaved=Taxa(
        genera="Androsace Anthyllis Arenaria Armeria Azorella Diapensia Minuartia Silene"
    ),
)
