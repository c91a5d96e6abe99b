"""Scene: a plot put together from leaves, plants, ground and light; what sensors measure of it.

Its light is computed in float32.
"""

from fynjax._core.compiler import keep_compiled
from fynjax.scene._cover import ProjectedCover, projected_cover
from fynjax.scene._cover_words import cover_range, name_classes
from fynjax.scene._ground import COVERS, Ground
from fynjax.scene._instances import (
    Instances,
    clark_evans_indices,
    hard_counts,
    hard_instances,
    hard_scene,
)
from fynjax.scene._large import TiledPicture, check_image, is_large
from fynjax.scene._lidar import LidarObservation, ReturnTruth
from fynjax.scene._materials import check_leafy, plant_materials, undescribed, with_areas
from fynjax.scene._model_error import ModelError
from fynjax.scene._observe import (
    AimedSensor,
    Observation,
    Placement,
    PlotAir,
    aim,
    fitted_accuracy,
    observe,
    sensor_of,
)
from fynjax.scene._optics import mean_trait
from fynjax.scene._parameters import (
    LEAF_FIELDS,
    PARAMETERS,
    GroundParameters,
    LightParameters,
    MaterialParameters,
    PlotParameters,
    SpeciesParameters,
    named_values,
    parameter_kind,
    parameter_reference,
    with_values,
)
from fynjax.scene._planting import (
    MOST_LISTED,
    Crowns,
    Planting,
    PlantingRules,
    element_count,
    individual_seeds,
    leaf_classes,
    material_classes,
    organ_classes,
    planting_memory,
    relative_sizes,
)
from fynjax.scene._profile import height_profile
from fynjax.scene._program import Program, compile
from fynjax.scene._scene import (
    Recipe,
    Scene,
    build_scene,
    check_projected_scene,
    ground_at,
    room_needed,
)
from fynjax.scene._species import (
    USUAL_LEAF,
    CoverDefinition,
    LeafRow,
    Material,
    Species,
    SpeciesRow,
    check_materials,
    check_species,
    check_taxa,
    cover_definition_of,
    drawn_leaves,
    leaf_parameters,
    leaves_of,
    own_spread,
    species_parameters,
    table_spreads,
)
from fynjax.scene._spectra import Spectrum, background_spectrum, soil_shapes, visible_sensor
from fynjax.scene._stand import StandArea, stand_area
from fynjax.scene._structure import fitting_structure, scene_structure
from fynjax.scene._truth import PixelTruth, pixel_truth, truth_of_layers, truth_of_pixels

keep_compiled()

__all__ = [
    "PARAMETERS",
    "USUAL_LEAF",
    "AimedSensor",
    "CoverDefinition",
    "Crowns",
    "Ground",
    "GroundParameters",
    "Instances",
    "LeafRow",
    "LidarObservation",
    "LightParameters",
    "Material",
    "MaterialParameters",
    "ModelError",
    "Observation",
    "PixelTruth",
    "Placement",
    "Planting",
    "PlantingRules",
    "PlotAir",
    "PlotParameters",
    "Program",
    "Recipe",
    "ReturnTruth",
    "Scene",
    "Species",
    "SpeciesParameters",
    "SpeciesRow",
    "Spectrum",
    "TiledPicture",
    "aim",
    "build_scene",
    "compile",
    "hard_instances",
    "hard_scene",
    "named_values",
    "observe",
    "pixel_truth",
    "with_values",
]
