"""Plant models from meshes: read, generated taxon by taxon, scanned, put together from branches."""

from fynjax.canopy._plant import organ_of_name
from fynjax.canopy.mesh._branches import plant_from_branches
from fynjax.canopy.mesh._generate import GeneratedPlant, generate_plant
from fynjax.canopy.mesh._model import plant_model_from_mesh, read_plant_mesh
from fynjax.canopy.mesh._plant_mesh import MeshPlant, PlantMaterial, PlantMesh, mesh_plant
from fynjax.canopy.mesh._read import default_up, find_up
from fynjax.canopy.mesh._scan import plant_model_from_points, read_scan

__all__ = [
    "GeneratedPlant",
    "MeshPlant",
    "PlantMaterial",
    "PlantMesh",
    "generate_plant",
    "plant_model_from_mesh",
    "read_plant_mesh",
]
