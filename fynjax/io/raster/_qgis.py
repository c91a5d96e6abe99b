"""Style files that QGIS takes by itself with a raster beside them."""

from collections.abc import Mapping
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
from jaxtyping import Bool, Float

from fynjax.io.raster._reader import open_raster
from fynjax.io.text import write_text

_SHOWN_NM = {"blue": 475.0, "green": 560.0, "red": 660.0, "nir": 860.0}
_FAR_NM = 45.0
"""A band further from it is not taken for a colour [nm]."""
_RAMP = ("#440154", "#3b528b", "#21918c", "#5ec962", "#fde725")
"""Viridis at five equal steps (van der Walt and Smith 2015), legible to colour-blind readers."""
_PIXELS = 512
"""Rows and columns that a stretch is taken from, at most."""


def colour_bands(
    wavelength: Float[np.ndarray, " band"] | None, good: Bool[np.ndarray, " band"]
) -> dict[str, int]:
    """Place of the good band nearest to blue, green, red and near infrared; only of those near it.

    **Arguments:** `wavelength` of the bands [nm], NaN where unknown; `good`, those to be used.
    """
    if wavelength is None:
        return {}
    places = np.flatnonzero(good & np.isfinite(wavelength))
    bands = {}
    for name, wanted in _SHOWN_NM.items():
        away = np.abs(wavelength[places] - wanted)
        if away.size and away.min() <= _FAR_NM:
            bands[name] = int(places[away.argmin()])
    return bands


def write_qgis_style(path: str | Path) -> Path:
    """Write the style of a raster as `NAME.qml` beside it, which QGIS takes when it opens it.

    Near infrared, red and green are shown as red, green and blue where the bands are known, else
    three bands in their order; fewer bands as a ramp of the first. Stretched from the 2 to the 98 %
    quantile.

    **Arguments:** `path` of the raster, as `open_raster` takes it.

    **Returns:** the style file.

    **Raises:** `InputError` as `open_raster`.
    """
    with open_raster(path, "a raster") as raster:
        data = raster.dataset
        near = colour_bands(raster.wavelengths, raster.good)
        chosen = [near[name] for name in ("nir", "red", "green") if name in near]
        if len(chosen) < 3:
            chosen = [0, 1, 2] if data.count >= 3 else [0]
        size = min(data.height, _PIXELS), min(data.width, _PIXELS)
        limits = [_stretch(data.read(b + 1, out_shape=size, masked=True)) for b in chosen]
    root = ElementTree.Element("qgis", version="3.22", styleCategories="Symbology")
    pipe = ElementTree.SubElement(root, "pipe")
    if len(chosen) == 3:
        _colours(pipe, chosen, limits)
    else:
        _ramp(pipe, *limits[0])
    ElementTree.indent(root)
    style = Path(path).with_suffix(".qml")
    write_text(style, ElementTree.tostring(root, encoding="unicode") + "\n")
    return style


def _stretch(values: np.ma.MaskedArray) -> tuple[float, float]:
    known = values.compressed()
    known = known[np.isfinite(known)]
    if known.size == 0:
        return 0.0, 1.0
    low, high = np.quantile(known, [0.02, 0.98]).tolist()
    return low, high if high > low else low + 1.0


def _colours(
    pipe: ElementTree.Element, bands: list[int], limits: list[tuple[float, float]]
) -> None:
    shown = dict(zip(("red", "green", "blue"), zip(bands, limits)))
    places = {f"{colour}Band": str(band + 1) for colour, (band, _) in shown.items()}
    renderer = _renderer(pipe, {"type": "multibandcolor", **places})
    for colour, (_, (low, high)) in shown.items():
        stretch = ElementTree.SubElement(renderer, f"{colour}ContrastEnhancement")
        for tag, text in (
            ("minValue", f"{low:.6g}"),
            ("maxValue", f"{high:.6g}"),
            ("algorithm", "StretchToMinimumMaximum"),
        ):
            ElementTree.SubElement(stretch, tag).text = text


def _ramp(pipe: ElementTree.Element, low: float, high: float) -> None:
    ends = {"classificationMin": f"{low:.6g}", "classificationMax": f"{high:.6g}"}
    renderer = _renderer(pipe, {"type": "singlebandpseudocolor", "band": "1", **ends})
    shader = ElementTree.SubElement(
        ElementTree.SubElement(renderer, "rastershader"),
        "colorrampshader",
        colorRampType="INTERPOLATED",
        classificationMode="1",
        clip="0",
        minimumValue=f"{low:.6g}",
        maximumValue=f"{high:.6g}",
    )
    for value, colour in zip(np.linspace(low, high, len(_RAMP)).tolist(), _RAMP, strict=True):
        ElementTree.SubElement(
            shader, "item", value=f"{value:.6g}", label=f"{value:.3g}", color=colour, alpha="255"
        )


def _renderer(pipe: ElementTree.Element, attributes: Mapping[str, str]) -> ElementTree.Element:
    return ElementTree.SubElement(
        pipe, "rasterrenderer", {"opacity": "1", "alphaBand": "-1", "nodataColor": "", **attributes}
    )
