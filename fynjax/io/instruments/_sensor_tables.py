"""A sensor file and its tables, as pydantic models."""

from pathlib import Path
from typing import Annotated, ClassVar, Literal

from pydantic import Field, model_validator

from fynjax.io.text import NamedFile, Slip, Strict, number, numbers

RadianceUnit = Literal[
    "W m-2 sr-1 um-1", "mW m-2 sr-1 nm-1", "uW cm-2 sr-1 nm-1", "W m-2 sr-1 nm-1"
]
"""The units of `fynjax.sensors.RADIANCE_UNITS`, as a type."""
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

    name: str | None = Field(default=None, description="Name; left out: band_1, band_2, ...")
    centre_nm: float = number("Centre wavelength", "nm", ge=200, le=15000)
    fwhm_nm: float | None = number(
        "Full width at half maximum", "nm", default=None, ge=0.2, le=2000
    )
    half_width_nm: float | None = number(
        "From the centre to half maximum; in place of fwhm_nm", "nm", default=None, ge=0.1, le=1000
    )
    ground_sample_distance_m: float | None = number(
        "Pixel of this band on the ground", "m", default=None, gt=0, le=100000
    )

    @model_validator(mode="after")
    def _one_width(self) -> "BandRow":
        if (self.fwhm_nm is None) == (self.half_width_nm is None):
            raise ValueError("expected fwhm_nm or half_width_nm, one of them, in each row")
        return self


class CurveRow(Strict):
    """One point of a table of response curves; the rows of a band follow each other."""

    slips: ClassVar[dict[str, Slip]] = _SPECTRAL_SLIPS

    band: str = Field(description="Name of the band.", min_length=1)
    wavelength_nm: float = number("Wavelength", "nm", ge=200, le=15000)
    response: float = number("Relative response, of any scale", "-", ge=0)


class NoiseRow(Strict):
    """One row of a table of noise coefficients: |a sqrt(b + L) + c|."""

    slips: ClassVar[dict[str, Slip]] = _SPECTRAL_SLIPS

    wavelength_nm: float = number("Wavelength", "nm", ge=200, le=15000)
    a: float = number("Photon noise", "square root of radiance")
    b: float = number("Dark signal as radiance", "radiance")
    c: float = number("Constant part", "radiance")


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
    altitude_m: float = number("Usual height above the ground", "m", gt=0, le=1e6)
    focal_length_mm: float = number("Focal length", "mm", ge=0.1, le=1e4)
    pixel_pitch_um: float = number("Distance between pixels on the array", "um", ge=0.1, le=1000)
    columns: int = Field(description="Pixels across [-].", ge=1, le=100000)
    tilt_deg: float = number(
        "Angle of the optical axis from straight down, towards the heading",
        "degree",
        default=0.0,
        gt=-90,
        lt=90,
    )
    heading_deg: float = number(
        "Direction of the image's upper edge, clockwise from north",
        "degree",
        default=0.0,
        ge=-360,
        le=360,
    )
    ground_sample_distance_m: float | None = number(
        "Pixel on the ground that the source states, from altitude_m: that of images; left out, "
        "from the optics, whose lines of sight it has in any case",
        "m",
        default=None,
        gt=0,
        le=100000,
    )


class FrameGeometryTable(CameraGeometryTable):
    """Lines of sight of a pinhole camera."""

    kind: Literal["frame"] = Field(description="A pinhole camera.")
    rows: int = Field(description="Pixels along [-].", ge=1, le=100000)


class PushbroomGeometryTable(CameraGeometryTable):
    """Lines of sight of a pushbroom: one line of pixels that a flight sweeps on."""

    kind: Literal["pushbroom"] = Field(description="One line that a flight sweeps on.")


class OrthographicGeometryTable(Strict):
    """Parallel lines of sight and equal pixels, such as of a satellite product."""

    kind: Literal["orthographic"] = Field(description="Parallel lines of sight.")
    pixel_m: float = number("Pixel on the ground", "m", gt=0, le=100000)
    view_zenith_deg: float = number(
        "Angle between the vertical and the direction to the sensor",
        "degree",
        default=0.0,
        ge=0,
        lt=90,
    )
    view_azimuth_deg: float = number(
        "Direction from the ground to the sensor, clockwise from north",
        "degree",
        default=0.0,
        ge=-360,
        le=360,
    )


Centre = Annotated[float, Field(ge=200, le=15000, allow_inf_nan=False)]
Width = Annotated[float, Field(ge=0.1, le=2000, allow_inf_nan=False)]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NonNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]


class BandsTable(Strict):
    """Spectral responses: lists in this table, a table of bands, or a table of curves."""

    slips: ClassVar[dict[str, Slip]] = _SPECTRAL_SLIPS

    response: Literal["gaussian", "box", "tabulated"] = Field(
        default="gaussian", description="Form of the response; 'tabulated' needs curves."
    )
    any_order: bool = Field(
        default=False,
        description="Whether the bands may stand in another order than that of wavelength.",
    )
    name: list[str] | None = Field(default=None, description="Names of the bands.", min_length=1)
    centre_nm: list[Centre] | None = numbers(
        "Centre wavelength of each band, from 200 to 15000", "nm", min_length=1
    )
    fwhm_nm: list[Width] | None = numbers(
        "Full width at half maximum of each band, or width of a box", "nm"
    )
    half_width_nm: list[Width] | None = numbers(
        "Half width at half maximum of each band, in place of fwhm_nm", "nm"
    )
    ground_sample_distance_m: list[Positive] | None = numbers(
        "Pixel of each band on the ground, where they differ", "m"
    )
    table: Annotated[Path, NamedFile("a table of bands")] | None = Field(
        default=None, description="Table of bands (CSV); a path from this file's folder."
    )
    curves: Annotated[Path, NamedFile("a table of response curves")] | None = Field(
        default=None, description="Table of curves (CSV); a path from this file's folder."
    )

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

    kind: Literal["gaussian", "box"] = Field(description="Form of the blur.")
    width_pixels: NonNegative | tuple[NonNegative, NonNegative] = Field(
        description="Width of the blur, or [across, along]: full width at half maximum of a "
        "Gaussian that comes on top of the pixel's own footprint; whole width of a box [pixels of "
        "the sensor, however wide those of an image are].",
        json_schema_extra={"unit": "pixels"},
    )


class RadiometricNoiseTable(Strict):
    """Noise of the radiance L as a spectrometer's maker states it: |a sqrt(b + L) + c|."""

    kind: Literal["radiometric"] = Field(description="From a table of coefficients.")
    table: Annotated[Path, NamedFile("a table of noise coefficients")] = Field(
        description="CSV with wavelength_nm, a, b, c; a path from this file's folder."
    )
    radiance_unit: RadianceUnit = Field(description="Unit of the radiance in the table.")
    integrations: float = number("Frames that one pixel averages", "-", default=1, gt=0, le=1e6)


class CameraNoiseTable(Strict):
    """Noise of a camera: shot noise, read noise and quantisation."""

    kind: Literal["camera"] = Field(description="From the numbers of a data sheet.")
    saturation_radiance: Positive | list[Positive] = numbers(
        "Radiance that fills a pixel, of all bands or each", "W m-2 sr-1 um-1", default=...
    )
    full_well_electrons: Positive | list[Positive] = numbers(
        "Electrons of a full pixel, of all bands or each", "-", default=...
    )
    read_noise_electrons: NonNegative | list[NonNegative] = numbers(
        "Standard deviation of the reading, of all bands or each", "electrons", default=...
    )
    bits: int = Field(description="Bits of a number [-].", ge=1, le=32)


Share = Annotated[float, Field(ge=0, le=1, allow_inf_nan=False)]


class GainsTable(Strict):
    """What the gains of the bands may be off by after one way of calibration."""

    gain_sd: Share | list[Share] = numbers(
        "Standard deviation of the factor by which the reflectance of a band may be off: one of "
        "all bands, or one a band",
        "-",
        default=...,
    )
    gain_shared: float = number(
        "Share of its variance that all bands have in common, as by light and exposure",
        "-",
        ge=0,
        le=1,
    )


_ERRORS = "Errors gain_sd and gain_shared, each of 0 to 1"


class CalibrationErrorsTable(Strict):
    """Errors of reflectance for each way in which images of the sensor are calibrated."""

    usual: WayOfCalibration = Field(description="The way where a user states none.")
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


class SensorFile(Strict):
    """A sensor file: one sensor, its bands, lines of sight, blur and noise."""

    name: str = Field(description="Short name.", min_length=1)
    description: str = Field(default="", description="What it is, in a sentence.")
    source: str = Field(description="Where the numbers come from.", min_length=1)
    licence: str = Field(default="", description="Terms of the numbers, where there are any.")
    geometry: FrameGeometryTable | PushbroomGeometryTable | OrthographicGeometryTable = Field(
        discriminator="kind", description="A table of lines of sight."
    )
    bands: BandsTable
    calibration: CalibrationErrorsTable | None = None
    psf: PointSpreadTable | None = None
    noise: RadiometricNoiseTable | CameraNoiseTable | None = Field(
        default=None, discriminator="kind", description="A table of noise."
    )
