"""Style files that QGIS takes by itself with a raster beside them."""

from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float

from fynjax.app.io.text import write_text

_SHOWN_NM = {"blue": 475.0, "green": 560.0, "red": 660.0, "nir": 860.0}
_FAR_NM = 45.0
"""A band further from it is not taken for a colour [nm]."""
_RAMP = ("#440154", "#3b528b", "#21918c", "#5ec962", "#fde725")
"""Viridis at five equal steps (van der Walt and Smith 2015), legible to colour-blind readers."""
_PIXELS = 512
"""Rows and columns that a stretch is taken from, at most."""


def colour_bands(
    wavelength: Float[np.ndarray, " band"], good: Bool[np.ndarray, " band"]
) -> dict[str, int]:
    """Place of the good band nearest to blue, green, red and near infrared; only of those near it.

    **Arguments:** `wavelength` of the bands [nm], NaN where unknown; `good`, those to be used.
    """
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
    from fynjax.app.io.raster._reader import open_raster  # late: a dry run reads no raster

    with open_raster(path, "a raster") as raster:
        data = raster.dataset
        near = colour_bands(raster.wavelengths, raster.good)
        chosen = [near[name] for name in ("nir", "red", "green") if name in near]
        if len(chosen) < 3:
            chosen = [0, 1, 2] if data.count >= 3 else [0]
        size = min(data.height, _PIXELS), min(data.width, _PIXELS)
        limits = [_stretch(data.read(b + 1, out_shape=size, masked=True)) for b in chosen]
    renderer = _colours(chosen, limits) if len(chosen) == 3 else _ramp(*limits[0])
    style = Path(path).with_suffix(".qml")
    write_text(style, _STYLE.format(renderer=renderer))
    return style


_STYLE = """\
<qgis version="3.22" styleCategories="Symbology">
  <pipe>
    <rasterrenderer opacity="1" alphaBand="-1" nodataColor="" {renderer}
    </rasterrenderer>
  </pipe>
</qgis>
"""
_STRETCH = """
      <{colour}ContrastEnhancement>
        <minValue>{low:.6g}</minValue>
        <maxValue>{high:.6g}</maxValue>
        <algorithm>StretchToMinimumMaximum</algorithm>
      </{colour}ContrastEnhancement>"""
_SHADER = """
      <rastershader>
        <colorrampshader colorRampType="INTERPOLATED" classificationMode="1" clip="0"
         minimumValue="{low:.6g}" maximumValue="{high:.6g}">{items}
        </colorrampshader>
      </rastershader>"""
_ITEM = """
          <item value="{value:.6g}" label="{value:.3g}" color="{colour}" alpha="255"/>"""


def _colours(bands: list[int], limits: list[tuple[float, float]]) -> str:
    """Three bands as red, green and blue, each stretched between its limits."""
    colours = ("red", "green", "blue")
    places = " ".join(f'{c}Band="{band + 1}"' for c, band in zip(colours, bands, strict=True))
    stretches = (
        _STRETCH.format(colour=colour, low=low, high=high)
        for colour, (low, high) in zip(colours, limits, strict=True)
    )
    return f'type="multibandcolor" {places}>{"".join(stretches)}'


def _ramp(low: float, high: float) -> str:
    """The first band as a ramp of colours between its limits."""
    steps = zip(np.linspace(low, high, len(_RAMP)).tolist(), _RAMP, strict=True)
    items = "".join(_ITEM.format(value=value, colour=colour) for value, colour in steps)
    ends = f'classificationMin="{low:.6g}" classificationMax="{high:.6g}"'
    shader = _SHADER.format(low=low, high=high, items=items)
    return f'type="singlebandpseudocolor" band="1" {ends}>{shader}'


def _stretch(values: np.ma.MaskedArray) -> tuple[float, float]:
    known = values.compressed()
    known = known[np.isfinite(known)]
    if known.size == 0:
        return 0.0, 1.0
    low, high = np.quantile(known, [0.02, 0.98]).tolist()
    return low, high if high > low else low + 1.0
