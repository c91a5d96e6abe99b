"""Radiation: from a voxel grid and its optics to radiance at a sensor."""

from fynjax.radiation._arrays import voxel_scene
from fynjax.radiation._canopy import CanopyAlbedo, canopy_albedo, canopy_reflectance
from fynjax.radiation._check import voxel_values
from fynjax.radiation._fluxes import Fluxes, absorption, diffuse_sources, fluxes
from fynjax.radiation._ground import RahmanPintyVerstraete
from fynjax.radiation._multiple import DiffuseField
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
    first_met,
    reflectance_factor,
    render,
    solve_light,
)
from fynjax.radiation._scene import Illumination, OpticalClasses, VoxelScene
from fynjax.radiation._tiles import LightInWindows, Tiling, light_tiling

__all__ = [
    "AbstractRays",
    "Accuracy",
    "CanopyAlbedo",
    "DiffuseField",
    "Fluxes",
    "Illumination",
    "Lattice",
    "Light",
    "OpticalClasses",
    "RahmanPintyVerstraete",
    "RayField",
    "RayLattice",
    "VoxelScene",
    "absorption",
    "canopy_albedo",
    "canopy_reflectance",
    "directional_reflectance",
    "fluxes",
    "nadir_rays",
    "parallel_rays",
    "perspective_rays",
    "reflectance_factor",
    "render",
    "solve_light",
    "voxel_scene",
]
