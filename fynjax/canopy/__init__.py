"""Plants: how many, where, what shape, and how much area of them in each voxel."""

from fynjax.canopy._angles import (
    AbstractLeafAngle,
    EllipsoidalLeafAngle,
    SphericalLeafAngle,
    TabulatedLeafAngle,
    TiltedLeafAngle,
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
from fynjax.canopy._form import FORMS_SHOWN as FORMS_SHOWN
from fynjax.canopy._form import FormPrior, GrowthForm, LeafGeometry, Shrubland, Taxa
from fynjax.canopy._greenness import Greenness, band_roles, band_word, choose_greenness
from fynjax.canopy._grid import VoxelGrid, deposit
from fynjax.canopy._instances import random_orientation, unit_shapes
from fynjax.canopy._pattern import VegetationPattern, vegetation_pattern
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
from fynjax.canopy._table import table1_2006
from fynjax.canopy._taxa import form_of_taxon
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
    "AbstractLeafAngle",
    "Crown",
    "EllipsoidalLeafAngle",
    "Foliage",
    "FormPrior",
    "GeneratedPlant",
    "GrowthForm",
    "LeafGeometry",
    "MeshPlant",
    "Organ",
    "PlantMaterial",
    "PlantMesh",
    "PlantModel",
    "Shoots",
    "SphericalLeafAngle",
    "TabulatedLeafAngle",
    "Taxa",
    "TrigonometricLeafAngle",
    "VerhoefLeafAngle",
    "VoxelGrid",
    "generate_plant",
    "instance_area",
    "leaf_angle",
    "modelled_diameter",
    "plant_model",
    "plant_model_from_mesh",
    "poisson_disk",
    "read_plant_mesh",
    "rounded_count",
    "soft_count",
    "table1_2006",
    "target_area",
]
