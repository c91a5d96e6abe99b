"""From an image to a probability map of where plants stand: what `fynjax pattern` does."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from fynjax._core.errors import InputError
from fynjax._core.progress import NullProgress, Progress
from fynjax.canopy import (
    Greenness,
    VegetationPattern,
    choose_greenness,
    vegetation_pattern,
)
from fynjax.io.raster import BandStack, read_band_stack, write_probability_map
from fynjax.report.figures import pattern_figure, save_figure


def pattern(
    paths: Sequence[str | Path],
    output: str | Path,
    *,
    clusters: int = 3,
    bands: Sequence[str] | None = None,
    greenness: str = "auto",
    greenness_weight: float = 1.0,
    levels: Sequence[int] | None = None,
    pixel: float | None = None,
    align: bool = True,
    seed: int = 0,
    progress: Progress | None = None,
) -> dict[str, Any]:
    """Write `map.tif` and `pattern.png` of an image into the folder `output`.

    **Arguments:** `paths`, `bands`, `pixel` and `align` as `read_band_stack` has them; `greenness`
    is the index of `choose_greenness`; `clusters`, `greenness_weight`, `levels` and `seed` as
    `vegetation_pattern` has them.

    **Returns:** the summary: headline, files, the map's frame, the clusters.

    **Raises:** what these functions raise.
    """
    progress = NullProgress() if progress is None else progress
    output = Path(output)
    with progress.stage("Read the image"):
        stack = read_band_stack(paths, bands=bands, pixel_m=pixel, align=align, progress=progress)
    try:
        green = choose_greenness(stack.names, stack.wavelengths, index=greenness)
        with progress.stage("Cluster the pixels"):
            pattern = vegetation_pattern(
                stack.values,
                green,
                mask=stack.mask,
                clusters=clusters,
                levels=levels,
                greenness_weight=greenness_weight,
                seed=seed,
            )
    except InputError as error:
        raise InputError(str(error), file=paths[0]) from error
    masked = int((~stack.mask).sum())
    with progress.stage("Write"):
        write_probability_map(
            output / "map.tif",
            pattern.grey,
            stack.transform,
            crs=stack.crs,
            nodata=pattern.nodata if masked else None,
            tags={
                "quantity": "chance of a plant to stand here, 255 is 1",
                "clusters": clusters,
                "greenness": green.formula,
                "greenness_weight": greenness_weight,
                "levels": list(pattern.levels),
                "seed": seed,
            },
        )
        save_figure(pattern_figure(stack, pattern, green), output / "pattern.png")
    return _summary(stack, pattern, green, greenness_weight, masked)


def _summary(
    stack: BandStack, pattern: VegetationPattern, green: Greenness, weight: float, masked: int
) -> dict[str, Any]:
    rows, columns = stack.mask.shape
    t = stack.transform
    told = "; ".join(
        f"{100 * share:.0f} % at {level} ({green.name} {value:.3g})"
        for share, level, value in zip(
            pattern.share, pattern.levels, pattern.greenness, strict=True
        )
    )
    headline = [
        f"{columns * t.a:g} m x {rows * -t.e:g} m in pixels of {t.a:g} m, "
        f"{len(stack.names)} bands: {stack.known_as}.",
        f"Clusters by {green.name} = {green.formula}: {told}.",
    ]
    if masked:
        headline.append(
            f"{masked} of {stack.mask.size} pixels have no data; a plot must not reach them."
        )
    alignment = None
    if stack.alignment is not None:
        worst = max(band.residual for band in stack.alignment)
        headline.append(
            f"Bands aligned on the first; tiles still miss it by {worst:.1f} pixels at most, in "
            "the median of a band."
        )
        alignment = [
            {"shift_px": band.shift, "residual_px": band.residual, "match": band.match}
            for band in stack.alignment
        ]
    west, north = t.c, t.f
    return {
        "headline": headline,
        "files": {
            "map.tif": "probability map, 0 to 255, for `probability_map` of a plot file",
            "pattern.png": "the image, the map and the clusters' spectra",
        },
        "map": {
            "bounds_m": [west, north + rows * t.e, west + columns * t.a, north],
            "pixel_m": [t.a, -t.e],
            "crs": stack.crs,
            "masked_pixels": masked,
            "nodata": pattern.nodata if masked else None,
        },
        "bands": [
            {"name": name, "wavelength_nm": wave}
            for name, wave in zip(stack.names, stack.wavelengths, strict=True)
        ],
        "greenness": {"name": green.name, "formula": green.formula, "weight": weight},
        "clusters": [
            {
                "level": level,
                "share": pattern.share[k],
                "greenness": pattern.greenness[k],
                "mean_spectrum": pattern.spectrum[k],
                "standard_deviation": pattern.spread[k],
            }
            for k, level in enumerate(pattern.levels)
        ],
        "inertia": pattern.inertia,
        "alignment": alignment,
    }


# -- the picture ----------------------------------------------------------------------------
