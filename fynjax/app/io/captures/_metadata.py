"""A raw picture of one band, whoever made the camera."""

from pathlib import Path

import numpy as np

from fynjax._core.errors import InputError, names_file
from fynjax.app.io.captures._band import RawBand, Stated
from fynjax.app.io.captures._dji import dji_band
from fynjax.app.io.captures._micasense import micasense_band
from fynjax.app.io.raster import open_raster


@names_file
def read_band(path: str | Path) -> RawBand:
    """Read a raw picture of one band: of a MicaSense camera, or of a DJI Mavic 3 Multispectral or
    Phantom 4 Multispectral (`SensorGain` or `BandFreq` in its XMP metadata).

    **Raises:** `InputError` for a file that cannot be read, is no picture of one band in whole
    numbers, has counts beyond its bit depth, or lacks metadata, which it names.
    """
    path = Path(path)
    with open_raster(path, "a raw picture of a multispectral camera") as file:
        picture = file.dataset
        if picture.count != 1 or picture.dtypes[0] not in ("uint8", "uint16"):
            raise InputError(
                "expected a raw picture of one band in counts (16 bits), but this has "
                f"{picture.count} of {picture.dtypes[0]}. Is it a product, or a preview?"
            )
        counts = file.stored_band(1)
        bits = int(picture.tags(1, ns="IMAGE_STRUCTURE").get("NBITS", counts.dtype.itemsize * 8))
        stated = Stated(file.xmp, {**picture.tags(), **picture.tags(ns="EXIF")})
    if bits < 12:
        raise InputError(f"expected counts of 12 or 16 bits, but this has {bits}. Is it a preview?")
    if int(counts.max()) >= 2**bits:
        raise InputError(
            f"expected counts below 2^{bits} = {2**bits}, but some are {int(counts.max())}. Was "
            "the file rewritten by another program?"
        )
    reader = dji_band if {"SensorGain", "BandFreq"} & set(stated.xmp) else micasense_band
    band = reader(path, counts.astype(np.uint16), bits, stated)
    if not 200.0 <= band.wavelength <= 2e4:
        slip = f" Micrometres? In nm this is {1000.0 * band.wavelength:g}."
        raise InputError(
            f"expected the centre of band {band.name!r} in nm, but got {band.wavelength:g}."
            + (slip if 0.2 <= band.wavelength <= 20.0 else "")
        )
    return band
