"""Scene: a plot put together from leaves, plants, ground and light; what sensors measure of it.

Its light is computed in float32.
"""

from fynjax._core.compiler import keep_compiled
from fynjax.scene._cover import ProjectedCover, crown_centres, projected_cover
from fynjax.scene._ground import COVERS, Ground, ground_shares, random_patches
from fynjax.scene._instances import Instances, hard_counts, hard_instances, hard_scene
from fynjax.scene._large import TiledPicture, is_large
from fynjax.scene._lidar import LidarObservation, ReturnTruth, observe_lidar
from fynjax.scene._observe import (
    DRONE,
    AimedSensor,
    Observation,
    Placement,
    PlotAir,
    aim,
    fitted_accuracy,
    observe,
)
from fynjax.scene._parameters import (
    FIXED_PARAMETERS,
    LEAF_FIELDS,
    PARAMETERS,
    GroundParameters,
    LightParameters,
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
    element_count,
    individual_seeds,
    leaf_classes,
)
from fynjax.scene._profile import height_profile
from fynjax.scene._scene import (
    PlantingRules,
    Scene,
    build_scene,
    check_projected_scene,
    ground_at,
    room_needed,
    slope_of_fading,
    stand_realisation,
)
from fynjax.scene._species import (
    SHRUB_LEAF,
    SHRUB_LEAF_SD,
    USUAL_LEAF,
    CoverDefinition,
    LeafRow,
    Species,
    SpeciesRow,
    check_species,
    check_taxa,
    cover_definition_of,
    drawn_leaves,
    leaf_parameters,
    leaves_of,
    species_parameters,
    species_rows,
    usual_leaf,
)
from fynjax.scene._spectra import (
    Spectrum,
    background_spectrum,
    band_wavelengths,
    visible_sensor,
)
from fynjax.scene._stand import StandArea, stand_area
from fynjax.scene._structure import fitting_structure, scene_structure
from fynjax.scene._truth import PixelTruth, pixel_truth, truth_of_layers, truth_of_pixels

keep_compiled()

__all__ = [
    "COVERS",
    "DRONE",
    "FIXED_PARAMETERS",
    "LEAF_FIELDS",
    "MOST_LISTED",
    "PARAMETERS",
    "SHRUB_LEAF",
    "SHRUB_LEAF_SD",
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
    "Observation",
    "PixelTruth",
    "Placement",
    "Planting",
    "PlantingRules",
    "PlotAir",
    "PlotParameters",
    "ProjectedCover",
    "ReturnTruth",
    "Scene",
    "Species",
    "SpeciesParameters",
    "SpeciesRow",
    "Spectrum",
    "StandArea",
    "TiledPicture",
    "aim",
    "background_spectrum",
    "band_wavelengths",
    "build_scene",
    "check_projected_scene",
    "check_species",
    "check_taxa",
    "cover_definition_of",
    "crown_centres",
    "drawn_leaves",
    "element_count",
    "fitted_accuracy",
    "fitting_structure",
    "ground_at",
    "ground_shares",
    "hard_counts",
    "hard_instances",
    "hard_scene",
    "height_profile",
    "individual_seeds",
    "is_large",
    "leaf_classes",
    "leaf_parameters",
    "leaves_of",
    "named_values",
    "observe",
    "observe_lidar",
    "parameter_kind",
    "parameter_reference",
    "pixel_truth",
    "projected_cover",
    "random_patches",
    "room_needed",
    "scene_structure",
    "slope_of_fading",
    "species_parameters",
    "species_rows",
    "stand_area",
    "stand_realisation",
    "truth_of_layers",
    "truth_of_pixels",
    "usual_leaf",
    "visible_sensor",
    "with_values",
]
