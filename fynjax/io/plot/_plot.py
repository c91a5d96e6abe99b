"""A plot as its files describe it: plain records, lengths in m, shares as fractions."""

from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from fynjax.scene import PARAMETERS, Crowns, LeafRow, SpeciesRow, parameter_kind
from fynjax.sensors import Panel

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Sun:
    """Direction to the sun."""

    zenith_deg: float
    """From straight up [degree]."""
    azimuth_deg: float
    """Clockwise from north [degree]."""
    solar_factor: float = 1.0
    """Sunlight of the day over that at one astronomical unit [-]; 1 where no time is given."""


@dataclass(frozen=True)
class Sky:
    """Diffuse light: the table if there is one, else a clear sky with this aerosol."""

    aerosol_optical_depth: float
    """At 500 nm [-]."""
    wavelength: Floats | None
    """Wavelengths of the table [nm], rising."""
    diffuse_fraction: Floats | None
    """Diffuse over global irradiance [-]."""
    pattern: Floats | None = None
    """Relative radiance [zenith, azimuth] at even steps from 0 to 90 degrees and from north round
    clockwise; `None`: the same from everywhere."""


@dataclass(frozen=True)
class Ground:
    """Soil and what lies on it."""

    spectrum: Path | None
    """The user's soil spectrum; `None` takes the shipped dry and wet soil."""
    brightness: float
    """Factor on the soil's reflectance [-]."""
    moisture: float
    """Share of the shipped wet soil in the mixture [-]; 0 with a spectrum of the user."""
    fractions: tuple[float, float, float]
    """Share of the ground under litter, char and rock [-]; without effect where there is a map."""
    spectra: tuple[Path | None, Path | None, Path | None]
    """The user's spectra of litter, char and rock; `None` takes the shipped ones."""
    patch_m: float
    """Width of the patches in which they lie [m]; 0 mixes them alike."""
    map: Path | None
    """Raster of the shares of litter, char and rock."""
    rpv: tuple[float, float, float] | None
    """k, theta and rho_c of the ground's angular shape; `None`: alike in all directions."""
    wood_brightness: float
    """Factor on the reflectance of bark, deadwood and dead tissue of shoots [-]."""


@dataclass(frozen=True)
class Sensor:
    """Which sensor looks, and from where. `None` means: as the sensor's file has it."""

    name: str
    """Name of a shipped sensor, or that in the sensor's own file."""
    altitude_m: float
    """Above the ground [m]."""
    pixel_m: float
    """Side of a pixel on the ground [m]."""
    path: Path | None = None
    """Sensor file of the user, instead of a shipped one."""
    stated_altitude_m: float | None = None
    """What the plot file says of `altitude_m`."""
    stated_pixel_m: float | None = None
    """What the plot file says of `pixel_m`."""
    tilt_deg: float | None = None
    """Of the optical axis from straight down, towards the heading [degree]."""
    heading_deg: float | None = None
    """Clockwise from north [degree]."""
    noise: bool | None = None
    """Whether to draw noise; `None`: if the sensor has a model of it."""
    point_spread: bool = True
    """Whether the optics blur."""
    panels: tuple[Panel, ...] = ()
    """In the picture."""


@dataclass(frozen=True)
class Air:
    """The air between sun, plot and sensor."""

    model: str = "table"
    """'table' (6S), 'clear-sky' (SPCTRL2), 'file' (the user's curves) or 'none'."""
    file: Path | None = None
    """The user's curves."""
    water_vapour_cm: float = 1.5
    """Column of water vapour [cm]."""
    aerosol_optical_depth: float | None = None
    """At 550 nm [-]; `None`: that of the sky."""
    ozone_cm_atm: float = 0.3
    """Column of ozone [cm-atm]."""
    pressure_hpa: float = 1013.25
    """At the ground [hPa]."""


@dataclass(frozen=True)
class Calibration:
    """What may move, and how far it is trusted."""

    free: tuple[str, ...]
    """Patterns of free parameters."""
    targets: tuple[str, ...]
    """Patterns of the target's statistics to use."""
    target_sd: float
    """Relative standard deviation of a target that states none [-]."""
    priors: dict[str, float]
    """Relative prior standard deviation by pattern [-]; without one, that of the parameter."""
    max_iterations: int
    gain_sd: float = 0.05
    """What a band of the camera may be off by, as a factor [-]."""
    starts: int = 1
    """Searches: from the prior's centre, the others from draws of the prior."""
    pixel_sd: float = 0.05
    """Relative error of a pixel's mean where plants are known [-]."""
    block_m: float | None = None
    """Side of the blocks of pixels compared there [m]; `None`: as many as are not too many."""

    def is_free(self, name: str) -> bool:
        """Whether parameter `name` may move."""
        return any(fnmatchcase(name, pattern) for pattern in self.free)

    def uses_target(self, statistic: str) -> bool:
        """Whether the target's statistic is to be used."""
        return any(fnmatchcase(statistic, pattern) for pattern in self.targets)

    def relative_sd(self, name: str) -> float | None:
        """Relative prior standard deviation of parameter `name` [-]; None where it has no prior, or
        that of its record is absolute."""
        for pattern, sd in self.priors.items():
            if fnmatchcase(name, pattern):
                return sd
        return PARAMETERS[parameter_kind(name)].relative_sd


@dataclass(frozen=True)
class Plot:
    """A plot as its files describe it: lengths in m, shares as fractions, paths absolute."""

    file: Path
    name: str
    size_m: tuple[float, float]
    """East-west and north-south side [m]; a whole number of voxels."""
    voxel_m: float
    """Side of a voxel [m]."""
    structure_m: float | Literal["even"] | None
    """Largest side of the voxels on which sun and sight follow the plants [m], or "even", as
    `fynjax.scene.PlantingRules` has it."""
    boundary: str
    """'periodic' or 'open'."""
    species: tuple[SpeciesRow, ...]
    """In the order of the species table."""
    leaves: tuple[LeafRow, ...]
    """Rows of the leaf table; empty where the plot has none."""
    probability_map: Path | None
    """GeoTIFF, 0 to 255."""
    terrain: Path | None
    """GeoTIFF of the height of the ground [m]; `None`: level."""
    map_origin_m: tuple[float, float] | None
    """South-west corner of the plot in the coordinates of its maps [m]; `None`: that of the map."""
    sun: Sun
    sky: Sky
    ground: Ground
    sensor: Sensor
    seed: int
    softness: float
    """Share of a species' plants over which one more is spread where a slope is taken [-]."""
    softness_plants: float
    """The same in plants, added to it, less one [plants]."""
    calibration: Calibration
    inputs: tuple[Path, ...]
    """Every file that was read or is named, for the provenance record."""
    dead_tissue: Path | None = None
    """The user's spectrum of dead tissue in live shoots; `None` takes that of bark."""
    hot_spot: bool = False
    """Whether leaves have the size of their growth form."""
    parameters: Path | None = None
    """Table of values that replace those above, for `build_plot`."""
    air: Air | None = None
    """The plot file's [atmosphere]; `None` where it has none."""
    crowns: Crowns | None = None
    """The plants, where they are known; `None`: as the species table has them, by chance."""
    crowns_note: str | None = None
    """How far covers and sizes that follow from the crowns are from the species table's."""

    @property
    def taxa(self) -> tuple[str, ...]:
        """Names, in the order of the species table."""
        return tuple(s.taxon for s in self.species)

    @property
    def cover(self) -> Floats:
        """Cover of each species [-]."""
        return np.array([s.cover for s in self.species])

    @property
    def diameter_m(self) -> Floats:
        """Mean crown diameter of each species [m]."""
        return np.array([s.diameter for s in self.species])

    @property
    def height_m(self) -> Floats:
        """Greatest height of each species [m]."""
        return np.array([s.height for s in self.species])
