"""Radiation: from a voxel grid and its optics to radiance at a sensor."""

from fynjax.radiation._ground import RahmanPintyVerstraete
from fynjax.radiation._multiple import DiffuseField
from fynjax.radiation._phase import area_scattering
from fynjax.radiation._rays import RayLattice, nadir_rays, parallel_rays
from fynjax.radiation._render import (
    Accuracy,
    Fluxes,
    Light,
    directional_reflectance,
    fluxes,
    reflectance_factor,
    render,
    solve_light,
)
from fynjax.radiation._scene import Illumination, OpticalClasses, VoxelScene, check_scene

__all__ = [
    "Accuracy",
    "DiffuseField",
    "Fluxes",
    "Illumination",
    "Light",
    "OpticalClasses",
    "RahmanPintyVerstraete",
    "RayLattice",
    "VoxelScene",
    "area_scattering",
    "check_scene",
    "directional_reflectance",
    "fluxes",
    "nadir_rays",
    "parallel_rays",
    "reflectance_factor",
    "render",
    "solve_light",
]
