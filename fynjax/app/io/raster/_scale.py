"""Whether numbers are reflectance factors, or reflectance in another scale."""

from pathlib import Path

from fynjax._core.errors import InputError

RELATIVE_TAG = "reflectance_scale"
"""Tag of an image whose reflectance is right only up to a factor that all bands share; its text
says so."""
LARGEST_REFLECTANCE = 1.5
"""Beyond, the brightest band's median is in another scale: percent, ten thousandths, counts."""
_DARKEST = 0.01
"""Below, no ground is so dark in its brightest band: open water is, and the deepest shade."""


def check_reflectance(brightest: float, path: Path, *, eight_bits: bool = False) -> None:
    """Refuse values that are no reflectance factors; no scale is guessed.

    **Arguments:**

    - `brightest`: median of the brightest band [-].
    - `path`: of the image or spectra, for errors.
    - `eight_bits`: whether the file holds numbers of 0 to 255.

    **Raises:** `InputError` with the likely scale and how to state it.
    """
    if _DARKEST <= brightest <= LARGEST_REFLECTANCE:
        return
    if brightest < _DARKEST:
        hint = (
            ": no ground is so dark. Was it divided twice, by 10000 or 32768, or is the panel's or "
            "the light sensor's value missing? Make it anew with its radiometric calibration"
        )
    elif eight_bits:
        hint = (
            ", in 8 bits. Numbers of 0 to 255 are mostly a picture's brightness, which is no "
            "reflectance: export reflectance from the program that made the mosaic. If 255 is a "
            f"reflectance of 1, state it: {_remedy(path, 255)}"
        )
    elif brightest <= 100.0:
        hint = f". Is it in percent? Then state it: {_remedy(path, 100)}"
    else:
        hint = (
            f". Is it in integers of 0 to 10000? Then state it: {_remedy(path, 10000)}. Times "
            f"32768, as Metashape and MicaSense write it? {_remedy(path, 32768)}. {_without(path)}"
            "Raw counts of a camera, or radiance, are none: make reflectance of them first (fynjax "
            "reflectance)"
        )
    raise InputError(
        "expected reflectance as a fraction, but the median of the brightest band is "
        f"{brightest:g}{hint}",
        file=path,
    )


def _without(path: Path) -> str:
    """Line of Python that writes a scale of 0.0001 into a GeoTIFF, for users without GDAL's command
    line tools; empty of other files."""
    if path.suffix.lower() not in (".tif", ".tiff"):
        return ""
    opened = f"d = rasterio.open({path.name!r}, 'r+'); d.scales = [0.0001] * d.count; d.close()"
    return f"Without GDAL's tools, for 0 to 10000, in Python: import rasterio; {opened}. "


def _remedy(path: Path, divisor: int) -> str:
    """How the scale of a file is stated."""
    if path.suffix.lower() in (".tif", ".tiff"):
        return f"gdal_edit.py -scale {1 / divisor:.6g} {path.name}"
    return f"reflectance scale factor = {divisor} in an ENVI header, or divide first"
