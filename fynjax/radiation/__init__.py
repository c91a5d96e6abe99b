"""Radiation: from a voxel grid and its optics to radiance at a sensor."""

from fynjax.radiation._arrays import voxel_scene
from fynjax.radiation._canopy import canopy_reflectance
from fynjax.radiation._check import check_scene
from fynjax.radiation._fluxes import Fluxes, absorption, fluxes
from fynjax.radiation._ground import RahmanPintyVerstraete
from fynjax.radiation._multiple import DiffuseField
from fynjax.radiation._phase import area_scattering
from fynjax.radiation._rays import (
    AbstractRays,
    Lattice,
    RayField,
    RayLattice,
    nadir_rays,
    parallel_rays,
    perspective_rays,
)
from fynjax.radiation._render import (
    Accuracy,
    Light,
    check_light,
    directional_reflectance,
    reflectance_factor,
    render,
    solve_light,
)
from fynjax.radiation._scene import Illumination, OpticalClasses, VoxelScene
from fynjax.radiation._tiles import Tiling, render_tile, render_tiles, tile_picture

__all__ = [
    "AbstractRays",
    "Accuracy",
    "DiffuseField",
    "Fluxes",
    "Illumination",
    "Lattice",
    "Light",
    "OpticalClasses",
    "RahmanPintyVerstraete",
    "RayField",
    "RayLattice",
    "Tiling",
    "VoxelScene",
    "absorption",
    "area_scattering",
    "canopy_reflectance",
    "check_light",
    "check_scene",
    "directional_reflectance",
    "fluxes",
    "nadir_rays",
    "parallel_rays",
    "perspective_rays",
    "reflectance_factor",
    "render",
    "render_tile",
    "render_tiles",
    "solve_light",
    "tile_picture",
    "voxel_scene",
]
