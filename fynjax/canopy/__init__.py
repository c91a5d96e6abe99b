"""Plants: how many, where, what shape, and how much area of them in each voxel."""

from fynjax.canopy._angles import (
    AbstractLeafAngle,
    EllipsoidalLeafAngle,
    SphericalLeafAngle,
    TabulatedLeafAngle,
    TrigonometricLeafAngle,
    VerhoefLeafAngle,
    leaf_angle,
    projections,
)
from fynjax.canopy._counts import (
    expected_count,
    instance_area,
    modelled_diameter,
    most_projected,
    projected_count,
    rounded_count,
    share_from_above,
    soft_count,
    target_area,
)
from fynjax.canopy._elements import Crown, Foliage, Shoots
from fynjax.canopy._form import FormPrior, GrowthForm, LeafGeometry, Shrubland, Taxa
from fynjax.canopy._greenness import Greenness, band_roles, band_word, choose_greenness
from fynjax.canopy._grid import VoxelGrid, deposit
from fynjax.canopy._instances import random_orientation, unit_shapes
from fynjax.canopy._pattern import VegetationPattern, even_levels, vegetation_pattern
from fynjax.canopy._plant import Organ, PlantModel, thin_plant
from fynjax.canopy._plant_model import plant_model
from fynjax.canopy._sites import (
    SITES,
    assign_sites,
    clark_evans,
    clumping,
    grouped,
    poisson_disk,
    site_weight,
)
from fynjax.canopy._table import leaf_sizes, table1_2006
from fynjax.canopy._taxa import FormOfTaxon, form_of_taxon
from fynjax.canopy.forms import FORMS
from fynjax.canopy.mesh import (
    GeneratedPlant,
    MeshPlant,
    PlantMaterial,
    PlantMesh,
    generate_plant,
    plant_from_branches,
    plant_model_from_mesh,
    plant_model_from_points,
    read_plant_mesh,
    read_scan,
)

__all__ = [
    "FORMS",
    "SITES",
    "AbstractLeafAngle",
    "Crown",
    "EllipsoidalLeafAngle",
    "Foliage",
    "FormOfTaxon",
    "FormPrior",
    "GeneratedPlant",
    "Greenness",
    "GrowthForm",
    "LeafGeometry",
    "MeshPlant",
    "Organ",
    "PlantMaterial",
    "PlantMesh",
    "PlantModel",
    "Shoots",
    "Shrubland",
    "SphericalLeafAngle",
    "TabulatedLeafAngle",
    "Taxa",
    "TrigonometricLeafAngle",
    "VegetationPattern",
    "VerhoefLeafAngle",
    "VoxelGrid",
    "assign_sites",
    "band_roles",
    "band_word",
    "choose_greenness",
    "clark_evans",
    "clumping",
    "deposit",
    "even_levels",
    "expected_count",
    "form_of_taxon",
    "generate_plant",
    "grouped",
    "instance_area",
    "leaf_angle",
    "leaf_sizes",
    "modelled_diameter",
    "most_projected",
    "plant_from_branches",
    "plant_model",
    "plant_model_from_mesh",
    "plant_model_from_points",
    "poisson_disk",
    "projected_count",
    "projections",
    "random_orientation",
    "read_plant_mesh",
    "read_scan",
    "rounded_count",
    "share_from_above",
    "site_weight",
    "soft_count",
    "table1_2006",
    "target_area",
    "thin_plant",
    "unit_shapes",
    "vegetation_pattern",
]
