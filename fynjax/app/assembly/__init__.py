"""From files to a scene: what turns a plot file and its tables into a scene and parameters."""

from fynjax.app.assembly._build import build_plot, plot_parameters
from fynjax.app.assembly._find import FREE_OF_PLANTS, blocks_of, find_plants
from fynjax.app.assembly._flights import frames_image, simulated_flight
from fynjax.app.assembly._forward import batch_for_device, image_view, plot_problem, read_problem
from fynjax.app.assembly._front import check_vegetation, prior, read_fit, read_scene
from fynjax.app.assembly._ground import ground_heights
from fynjax.app.assembly._memory import check_memory
from fynjax.app.assembly._pixels import sample_pixel
from fynjax.app.assembly._sensing import aim_at_plot, aim_without_air
from fynjax.app.assembly._stands import (
    STAND_QUANTITIES,
    StandQuantity,
    Stands,
    StandSettings,
    simulate_stands,
    stand_forms,
    stand_numbers,
)
from fynjax.app.assembly._targets import (
    RealImage,
    image_data,
    image_sight,
    placed_by_image,
    read_targets,
    spectrum_data,
    structure_data,
)
from fynjax.app.assembly._twin import Twin, plant_twin, twin_image

__all__ = [
    "FREE_OF_PLANTS",
    "STAND_QUANTITIES",
    "RealImage",
    "StandQuantity",
    "StandSettings",
    "Stands",
    "Twin",
    "aim_at_plot",
    "aim_without_air",
    "batch_for_device",
    "blocks_of",
    "build_plot",
    "check_memory",
    "check_vegetation",
    "find_plants",
    "frames_image",
    "ground_heights",
    "image_data",
    "image_sight",
    "image_view",
    "placed_by_image",
    "plant_twin",
    "plot_parameters",
    "plot_problem",
    "prior",
    "read_fit",
    "read_problem",
    "read_scene",
    "read_targets",
    "sample_pixel",
    "simulate_stands",
    "simulated_flight",
    "spectrum_data",
    "stand_forms",
    "stand_numbers",
    "structure_data",
    "twin_image",
]
