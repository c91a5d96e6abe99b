"""A sensor file and its tables, as pydantic models."""

from pathlib import Path
from typing import Annotated, ClassVar, Literal

from pydantic import Field, model_validator

from fynjax.app.io.text import NamedFile, Slip, Strict, in_unit

RadianceUnit = Literal[
    "W m-2 sr-1 um-1", "mW m-2 sr-1 nm-1", "uW cm-2 sr-1 nm-1", "W m-2 sr-1 nm-1"
]
"""The units that `fynjax.sensors` knows, as a type."""
WayOfCalibration = Literal["panels", "light_sensor", "empirical_line", "product"]
"""How images of a sensor become reflectance."""


def _nanometre_slip(value: float) -> str | None:
    if 0 < value < 100:
        return f"Micrometres? In nm this is {value * 1000:g}."
    if 15000 < value <= 150000:
        return f"Ångström? In nm this is {value / 10:g}."
    return None


def _width_slip(value: float) -> str | None:
    return f"Micrometres? In nm this is {value * 1000:g}." if 0 < value < 0.2 else None


_SPECTRAL_SLIPS: dict[str, Slip] = {
    "centre_nm": _nanometre_slip,
    "wavelength_nm": _nanometre_slip,
    "fwhm_nm": _width_slip,
    "half_width_nm": _width_slip,
}


class BandRow(Strict):
    """One row of a table of bands."""

    slips: ClassVar[dict[str, Slip]] = _SPECTRAL_SLIPS
    unique = "name"

    name: str | None = None
    """Name; left out: band_1, band_2, ..."""
    centre_nm: float = in_unit("nm", ge=200, le=15000)
    """Centre wavelength [nm]."""
    fwhm_nm: float | None = in_unit("nm", default=None, ge=0.2, le=2000)
    """Full width at half maximum [nm]."""
    half_width_nm: float | None = in_unit("nm", default=None, ge=0.1, le=1000)
    """From the centre to half maximum; in place of fwhm_nm [nm]."""
    ground_sample_distance_m: float | None = in_unit("m", default=None, gt=0, le=100000)
    """Pixel of this band on the ground [m]."""

    @model_validator(mode="after")
    def _one_width(self) -> "BandRow":
        if (self.fwhm_nm is None) == (self.half_width_nm is None):
            raise ValueError("expected fwhm_nm or half_width_nm, one of them, in each row")
        return self


class CurveRow(Strict):
    """One point of a table of response curves; the rows of a band follow each other."""

    slips: ClassVar[dict[str, Slip]] = _SPECTRAL_SLIPS

    band: str = Field(min_length=1)
    """Name of the band."""
    wavelength_nm: float = in_unit("nm", ge=200, le=15000)
    """Wavelength [nm]."""
    response: float = in_unit("-")
    """Relative response, of any scale; noise below 0, up to 0.02 of a band's largest, is 0 [-]."""


class NoiseRow(Strict):
    """One row of a table of noise coefficients: |a sqrt(b + L) + c|."""

    slips: ClassVar[dict[str, Slip]] = _SPECTRAL_SLIPS

    wavelength_nm: float = in_unit("nm", ge=200, le=15000)
    """Wavelength [nm]."""
    a: float = in_unit("square root of radiance")
    """Photon noise [square root of radiance]."""
    b: float = in_unit("radiance")
    """Dark signal as radiance [radiance]."""
    c: float = in_unit("radiance")
    """Constant part [radiance]."""


class CameraGeometryTable(Strict):
    """What the lines of sight of a pinhole camera and of a pushbroom have in common."""

    slips: ClassVar[dict[str, Slip]] = {
        "focal_length_mm": lambda v: (
            f"Metres? In mm this is {v * 1000:g}." if 0 < v < 0.1 else None
        ),
        "pixel_pitch_um": lambda v: (
            f"Millimetres? In µm this is {v * 1000:g}." if 0 < v < 0.1 else None
        ),
        "tilt_deg": lambda v: "A gimbal pitch? Straight down is 0 here." if v == -90 else None,
    }

    kind: Literal["frame", "pushbroom"]
    altitude_m: float = in_unit("m", gt=0, le=1e6)
    """Usual height above the ground [m]."""
    focal_length_mm: float = in_unit("mm", ge=0.1, le=1e4)
    """Focal length [mm]."""
    pixel_pitch_um: float = in_unit("um", ge=0.1, le=1000)
    """Distance between pixels on the array [um]."""
    columns: int = Field(ge=1, le=100000)
    """Pixels across [-]."""
    tilt_deg: float = in_unit("degree", default=0.0, gt=-90, lt=90)
    """Angle of the optical axis from straight down, towards the heading [degree]."""
    heading_deg: float = in_unit("degree", default=0.0, ge=-360, le=360)
    """Direction of the image's upper edge, clockwise from north [degree]."""
    ground_sample_distance_m: float | None = in_unit("m", default=None, gt=0, le=100000)
    """Pixel on the ground that the source states, from altitude_m: that of images; left out, from
    the optics, whose lines of sight it has in any case [m]."""


class FrameGeometryTable(CameraGeometryTable):
    """Lines of sight of a pinhole camera."""

    kind: Literal["frame"]
    """A pinhole camera."""
    rows: int = Field(ge=1, le=100000)
    """Pixels along [-]."""


class PushbroomGeometryTable(CameraGeometryTable):
    """Lines of sight of a pushbroom: one line of pixels that a flight sweeps on."""

    kind: Literal["pushbroom"]
    """One line that a flight sweeps on."""


class OrthographicGeometryTable(Strict):
    """Parallel lines of sight and equal pixels, such as of a satellite product."""

    kind: Literal["orthographic"]
    """Parallel lines of sight."""
    pixel_m: float = in_unit("m", gt=0, le=100000)
    """Pixel on the ground [m]."""
    view_zenith_deg: float = in_unit("degree", default=0.0, ge=0, lt=90)
    """Angle between the vertical and the direction to the sensor [degree]."""
    view_azimuth_deg: float = in_unit("degree", default=0.0, ge=-360, le=360)
    """Direction from the ground to the sensor, clockwise from north [degree]."""


Centre = Annotated[float, Field(ge=200, le=15000, allow_inf_nan=False)]
Width = Annotated[float, Field(ge=0.1, le=2000, allow_inf_nan=False)]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NonNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]


class BandsTable(Strict):
    """Spectral responses: lists in this table, a table of bands, or a table of curves."""

    slips: ClassVar[dict[str, Slip]] = _SPECTRAL_SLIPS

    response: Literal["gaussian", "box", "tabulated"] = "gaussian"
    """Form of the response; 'tabulated' needs curves."""
    any_order: bool = False
    """Whether the bands may stand in another order than that of wavelength."""
    name: list[str] | None = Field(default=None, min_length=1)
    """Names of the bands."""
    centre_nm: list[Centre] | None = in_unit("nm", default=None, min_length=1, several=True)
    """Centre wavelength of each band, from 200 to 15000 [nm]."""
    fwhm_nm: list[Width] | None = in_unit("nm", default=None, several=True)
    """Full width at half maximum of each band, or width of a box [nm]."""
    half_width_nm: list[Width] | None = in_unit("nm", default=None, several=True)
    """Half width at half maximum of each band, in place of fwhm_nm [nm]."""
    ground_sample_distance_m: list[Positive] | None = in_unit("m", default=None, several=True)
    """Pixel of each band on the ground, where they differ [m]."""
    table: Annotated[Path, NamedFile("a table of bands")] | None = None
    """Table of bands (CSV); a path from this file's folder."""
    curves: Annotated[Path, NamedFile("a table of response curves")] | None = None
    """Table of curves (CSV); a path from this file's folder."""

    @model_validator(mode="after")
    def _one_description(self) -> "BandsTable":
        if twice := [n for k, n in enumerate(self.name or []) if n in (self.name or [])[:k]]:
            raise ValueError(f"the band name {twice[0]!r} is there twice")
        given = [n for n in ("centre_nm", "table", "curves") if getattr(self, n) is not None]
        if len(given) != 1:
            came = " and ".join(given) or "none of them"
            raise ValueError(f"expected centre_nm, table or curves, one of them, but got {came}")
        if (self.response == "tabulated") != (self.curves is not None):
            raise ValueError("response = 'tabulated' and curves go together: give both or neither")
        widths = [n for n in ("fwhm_nm", "half_width_nm") if getattr(self, n) is not None]
        if self.centre_nm is None:
            if beside := [*widths, *(["name"] if self.name else [])]:
                raise ValueError(f"expected no {beside[0]} beside {given[0]}, which has its own")
            return self
        if len(widths) != 1:
            came = "both" if widths else "none"
            raise ValueError(f"expected fwhm_nm or half_width_nm, one of them, but got {came}")
        for what in ("name", *widths, "ground_sample_distance_m"):
            values = getattr(self, what)
            if values is not None and len(values) != len(self.centre_nm):
                raise ValueError(
                    f"expected one {what} for each of {len(self.centre_nm)} bands, but got "
                    f"{len(values)}"
                )
        return self


class PointSpreadTable(Strict):
    """Blur of the optics."""

    kind: Literal["gaussian", "box"]
    """Form of the blur."""
    width_pixels: NonNegative | tuple[NonNegative, NonNegative] = in_unit("pixels", several=True)
    """Width of the blur, or [across, along]: full width at half maximum of a Gaussian that comes on
    top of the pixel's own footprint; whole width of a box [pixels of the sensor, however wide those
    of an image are]."""


class RadiometricNoiseTable(Strict):
    """Noise of the radiance L as a spectrometer's maker states it: |a sqrt(b + L) + c|."""

    kind: Literal["radiometric"]
    """From a table of coefficients."""
    table: Annotated[Path, NamedFile("a table of noise coefficients")]
    """CSV with wavelength_nm, a, b, c; a path from this file's folder."""
    radiance_unit: RadianceUnit
    """Unit of the radiance in the table."""
    integrations: float = in_unit("-", default=1, gt=0, le=1e6)
    """Frames that one pixel averages [-]."""


class CameraNoiseTable(Strict):
    """Noise of a camera: shot noise, read noise and quantisation."""

    kind: Literal["camera"]
    """From the numbers of a data sheet."""
    saturation_radiance: Positive | list[Positive] = in_unit("W m-2 sr-1 um-1", several=True)
    """Radiance that fills a pixel, of all bands or each [W m-2 sr-1 um-1]."""
    full_well_electrons: Positive | list[Positive] = in_unit("-", several=True)
    """Electrons of a full pixel, of all bands or each [-]."""
    read_noise_electrons: NonNegative | list[NonNegative] = in_unit("electrons", several=True)
    """Standard deviation of the reading, of all bands or each [electrons]."""
    bits: int = Field(ge=1, le=32)
    """Bits of a number [-]."""


Share = Annotated[float, Field(ge=0, le=1, allow_inf_nan=False)]


class GainsTable(Strict):
    """What the gains of the bands may be off by after one way of calibration."""

    gain_sd: Share | list[Share] = in_unit("-", several=True)
    """Standard deviation of the factor by which the reflectance of a band may be off: one of all
    bands, or one a band [-]."""
    gain_shared: float = in_unit("-", ge=0, le=1)
    """Share of its variance that all bands have in common, as by light and exposure [-]."""


_ERRORS = "Errors gain_sd and gain_shared, each of 0 to 1"


class CalibrationErrorsTable(Strict):
    """Errors of reflectance for each way in which images of the sensor are calibrated."""

    usual: WayOfCalibration
    """The way where a user states none."""
    panels: GainsTable | None = Field(
        default=None, description=f"{_ERRORS}, with a panel seen before or after."
    )
    light_sensor: GainsTable | None = Field(
        default=None, description=f"{_ERRORS}, with the sensor of downwelling light alone."
    )
    empirical_line: GainsTable | None = Field(
        default=None, description=f"{_ERRORS}, with several targets in the image."
    )
    product: GainsTable | None = Field(
        default=None, description=f"{_ERRORS}, of reflectance as the provider computes it."
    )

    @model_validator(mode="after")
    def _usual_is_given(self) -> "CalibrationErrorsTable":
        if getattr(self, self.usual) is None:
            raise ValueError(f"expected a table {self.usual}, which is the usual way, beside it")
        return self


class InstrumentFile(Strict):
    """What the file of any instrument says of it."""

    name: str = Field(min_length=1)
    """Short name."""
    description: str = ""
    """Description of the instrument, in a sentence."""
    source: str = Field(min_length=1)
    """Where the numbers come from."""
    licence: str = ""
    """Terms of the numbers, where there are any."""


class SensorFile(InstrumentFile):
    """A sensor file: one sensor, its bands, lines of sight, blur and noise."""

    geometry: FrameGeometryTable | PushbroomGeometryTable | OrthographicGeometryTable = Field(
        discriminator="kind"
    )
    """A table of lines of sight."""
    bands: BandsTable
    calibration: CalibrationErrorsTable | None = None
    psf: PointSpreadTable | None = None
    noise: RadiometricNoiseTable | CameraNoiseTable | None = Field(
        default=None, discriminator="kind"
    )
    """A table of noise."""
