"""The page of a calibration: which figures and tables it shows, and its headline."""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
from jaxtyping import Float
from scipy.special import ndtri

from fynjax.app.assembly import RealImage, Twin
from fynjax.app.io.plot import Place
from fynjax.app.jobs._calibration_tables import (
    ReferenceImage,
    camera_table,
    largest_errors,
    seen_images,
    sensor_misfit,
    sensor_table,
)
from fynjax.app.jobs._render import SHOWN_INDICES, image_views, index_images, write_image
from fynjax.app.jobs._run import Run, peak_memory_mib
from fynjax.app.report import figures
from fynjax.app.report.pages import Page, Part, Picture, Section, Table, Views, sensor_section
from fynjax.inversion import Calibration, Data, FitStatus, ImageView, stand_sentence
from fynjax.metrics import without_view
from fynjax.sensors import BandSet


def agreement_sentences(
    name: str, data: Data, statistics: pd.DataFrame, reference: ReferenceImage
) -> list[str]:
    """Sentences on how well the data of each sensor are met before and after."""
    lines = []
    if any(map(is_image, data.parts)):
        published = list(reference.error_percent.values())
        for what, error in largest_errors(statistics).iterrows():
            beside = ""
            if published and what == "a band mean":
                low, high = min(published), max(published)
                beside = f" (the paper's own simulation: {low:.1f} to {high:.1f} %)"
            lines.append(
                f"largest error of {what} {error['before']:.1f} % before, "
                f"{error['after']:.1f} % after{beside}, {error['with_gain']:.1f} % with the "
                f"camera's gains as estimated, {error['with_error']:.1f} % with what the model is "
                "estimated to be off by too."
            )
        if lines:
            lines[0] = f"{name}, expected over plantings: {lines[0]}"
            lines[1:] = map(_capitalised, lines[1:])
    for part in data.parts:
        if not is_image(part):
            lines.append(sensor_misfit(part, sensor_table(part, statistics)))
    return lines


def is_image(data: Data) -> bool:
    """Whether data are statistics of a drone's image."""
    return data.source is not None and data.source.kind == "image"


def parameter_sentences(result: Calibration) -> list[str]:
    """Sentences on the parameters that the data constrain, and on the ends of the searches."""
    constrained, ends = result.fit.well_constrained(), result.ends
    lines = [
        f"The data at least halve the error of {len(constrained)} of {len(result.fit.names)} "
        "parameters" + (f": {', '.join(constrained)}." if constrained else ".")
    ]
    moved = np.asarray(result.fit.moved, float)
    far = [f"{n} by {m:+.1f}" for n, m in zip(result.fit.names, moved) if abs(m) > _FAR]
    if far:
        lines.append(
            f"{len(far)} of {len(moved)} lie outside the middle 90 % of their priors, in standard "
            f"deviations of the prior: {', '.join(far)}."
        )
    if len(ends.objective) > 1:
        minima = f"{ends.minima} minima" if ends.minima > 1 else "one minimum"
        lines.append(
            f"{len(ends.objective)} starts ended in {minima}, objectives "
            f"{ends.objective.min():.4g} to {ends.objective.max():.4g}, up to "
            f"{ends.apart.max():.2g} posterior sd apart; the best is kept."
        )
    lines.append(misfit_sentence(result))
    return [*lines, *result.gain_sentences(), result.fit.explanation]


_FAR = float(ndtri(0.95))
"""Distance from the centre of a prior beyond which lies a tenth of it [standard deviations]."""


def status_words(result: Calibration) -> str:
    """'ok', or why the fit is to be doubted and what to do."""
    doubts, fit = result.doubts(), result.fit
    if not fit.converged:
        rounds = bool(fit.status == FitStatus.max_rounds)
        key = "rounds (rounds" if rounds else "steps (max_iterations"
        doubts.append(
            f"not converged: {fit.explanation} Allow more {key} in the plot file), free fewer "
            "parameters, or take the estimate with doubt."
        )
    return " ".join(doubts) or "ok"


def twin_sentence(
    result: Calibration, known: Twin, stand: pd.DataFrame, parameters: pd.DataFrame
) -> str:
    """Share of a twin's truth in the 90 % intervals, of tables with a column `truth`, in words."""

    def inside(table: pd.DataFrame) -> str:
        within = table["truth"].between(table["q05"], table["q95"])
        return f"{within.sum()} of {len(table)}"

    text = (
        "A twin, whose truth was drawn from the prior, planted with a seed of its own and measured "
        f"with errors: of the truth {inside(parameters)} parameters and {inside(stand)} numbers of "
        "the stand lie in their 90 % intervals"
    )
    if known.gain is None or result.gain is None or result.gain_sd is None:
        return f"{text}."
    apart = np.abs(np.log(known.gain / result.gain))
    within = np.sum(apart <= ndtri(0.95) * result.gain_sd)
    gains = ", ".join(f"{gain:.3f}" for gain in known.gain)
    return f"{text}, and {within} of {len(apart)} gains of the camera, which were {gains}."


def doubt_first(result: Calibration, text: str) -> str:
    """A page's lead: before anything else, why the fit is to be doubted."""
    status = status_words(result)
    return text if status == "ok" else f"{_capitalised(status)} {text}"


def misfit_sentence(result: Calibration) -> str:
    """Whether model and prior explain the data."""
    names, count, probability = len(result.data.names), result.degrees, result.probability
    of = "statistics" if count == names else f"directions of {names} statistics"
    shown = f"p = {probability:.2g}" if probability >= 1e-3 else "p < 0.001"
    return f"{result.misfit_sentence()} (Chi-square {result.misfit:.0f} for {count} {of}, {shown}.)"


def _capitalised(text: str) -> str:
    return text[0].upper() + text[1:]


def calibration_page(
    run: Run,
    name: str,
    result: Calibration,
    tables: tuple[pd.DataFrame, pd.DataFrame, pd.DataFrame],
    reference: ReferenceImage,
    lead: Sequence[str],
    record: Mapping[str, str | int],
) -> Page:
    """The page. `tables` are those of the stand, of the parameters and of the statistics; `lead`
    are the first sentences."""
    stand, parameters, statistics = tables
    memory = peak_memory_mib()
    keys = {
        "steps of the search": str(int(result.fit.steps)),
        "wall time": f"{run.total():.0f} s",
        "peak memory": f"{memory / 1024:.1f} GiB",
    }
    if result.image_before is not None:
        largest = largest_errors(statistics).iterrows()
        keys = {
            f"largest error of {what}, before → after": pair_of_errors(e["before"], e["after"])
            for what, e in largest
        } | keys
    said = [*_goal_sentences(statistics, reference), *([reference.start] * bool(reference.start))]
    sections = [Section("", [" ".join(said)])] if said else []
    for part, view in zip(result.problem.measured.parts, result.views, strict=True):
        if isinstance(view, ImageView):
            sections += _image_sections(part, view, result, statistics, reference)
        else:
            sections.append(sensor_section(part, sensor_table(part, statistics)))
    for view in result.views:
        if isinstance(view, ImageView):
            camera = camera_table(result, statistics, view)
            title = _titled("The camera", view)
            sections.append(Section(title, [_camera_sentence(camera), Table(camera, _CAMERA)]))
    sections += [
        Section("", [Table(statistics, _STATISTICS, folded=True)]),
        parameter_section(result, stand, parameters),
        search_section(run, result, memory),
    ]
    first = doubt_first(result, " ".join(lead))
    title = f"Calibration: {name}"
    return Page("calibrate", title, first, sections, keys, record, *_answer(result, lead))


def _answer(result: Calibration, lead: Sequence[str]) -> tuple[str, str]:
    """The result in a line, before beside after, and whether it may be trusted."""
    status = status_words(result)
    trust = misfit_sentence(result) if status == "ok" else _capitalised(status)
    return next((said for said in lead if " before" in said), lead[0]), trust


def _titled(title: str, view: ImageView) -> str:
    return f"{title}, {view.view}" if view.view else title


def write_results(
    run: Run,
    place: Place,
    result: Calibration,
    tables: tuple[pd.DataFrame, pd.DataFrame, pd.DataFrame],
    record: Mapping[str, str | int],
    words: tuple[str, str],
) -> None:
    """Write the tables of `calibration_page`, and of each drone the images before and after, where
    the plot lies; `words` are for what the statistics are of, and for where the plot before is
    from."""
    stand, parameters, statistics = tables
    each, source = words
    run.table("stand.csv", stand, "prior and estimate of the whole stand")
    run.table("parameters.csv", parameters, "prior, estimate, sd of every parameter")
    run.table("statistics.csv", statistics, f"{each}, real and simulated")
    for when, what in (("before", f"of the {source}"), ("after", "after calibration")):
        for view, image in seen_images(result, when):
            camera, file = view.camera, f"image_{when}{f'_{view.view}' if view.view else ''}.tif"
            if result.blocks is not None:
                pixel = camera.pixel * result.blocks.size
                camera = dataclasses.replace(camera, pixel=pixel)
            path = run.path(file, f"image {what}, GeoTIFF")
            write_image(path, image, place, camera, record)


def _image_sections(
    data: Data,
    view: ImageView,
    result: Calibration,
    statistics: pd.DataFrame,
    reference: ReferenceImage,
) -> list[Section]:
    camera = view.camera
    real = None if data.source is None else data.source.image
    bands, pixel = camera.sensor.bands, camera.pixel
    simulated = {
        when.capitalize(): next(one for own, one in seen_images(result, when) if own is view)
        for when in ("before", "after")
    }
    if view.view:  # of this view alone, under plain names
        statistics = statistics[statistics["statistic"].isin(view.statistic_names)]
        statistics = statistics.assign(statistic=statistics["statistic"].map(without_view))
    if real is None:
        said = (
            "Of the measured image only statistics are known here, so that no picture of it stands "
            "beside the simulated ones."
        )
        views = image_views(simulated, bands, pixel)
    else:
        rows, columns = camera.shape
        said = real_sentence(real, (columns * pixel, rows * pixel))
        images = {"Real": _in_bands(real.values, real, bands), **simulated}
        pixels = {"Real": real.pixel, **dict.fromkeys(simulated, pixel)}
        views = image_views(images, bands, pixels, "Real")
    against = [
        *error_pictures(statistics, reference),
        *_distributions(real, simulated, bands, statistics),
    ]
    if view.view:  # files of several views lie beside each other
        views = Views({title: _of_view(one, view) for title, one in views.pictures.items()})
        against = [_of_view(one, view) for one in against]
    return [
        Section(_titled("The image", view), [said, _one_planting(statistics), views]),
        Section(_titled("Against the real image", view), against),
    ]


def _of_view(picture: Picture, view: ImageView) -> Picture:
    return dataclasses.replace(picture, file=f"{view.view}_{picture.file}")


def pixel_page(
    run: Run,
    name: str,
    result: Calibration,
    tables: tuple[pd.DataFrame, pd.DataFrame, pd.DataFrame],
    lead: Sequence[str],
    record: Mapping[str, str | int],
) -> Page:
    """The page of a calibration pixel by pixel, with `tables` and `lead` as of
    `calibration_page`."""
    stand, parameters, bands = tables
    camera, blocks = result.camera, result.blocks
    assert camera is not None
    assert blocks is not None
    return Page(
        "calibrate",
        f"Calibration: {name}",
        doubt_first(result, " ".join(lead)),
        [
            Section("The image", _pixel_pictures(result, camera.pixel * blocks.size)),
            Section("", [Table(bands, "Every band.", folded=True)]),
            parameter_section(result, stand, parameters),
            search_section(run, result, peak_memory_mib()),
        ],
        {
            "relative error, before → after": pair_of_errors(*block_errors(result)[:2]),
            "wall time": f"{run.total():.0f} s",
        },
        record,
        *_answer(result, lead),
    )


def block_errors(result: Calibration) -> list[float]:
    """Relative errors of the compared blocks before, after, and with gains and the model's error
    [%]."""
    blocks = result.blocks
    assert blocks is not None
    mean = np.nanmean(blocks.measured, axis=(1, 2), keepdims=True)
    return [
        100.0 * float(np.sqrt(np.nanmean(((image - blocks.measured) / mean) ** 2)))
        for image in (blocks.before, blocks.after, blocks.with_error)
    ]


def _pixel_pictures(result: Calibration, pixel: float) -> list[Part]:
    camera, blocks = result.camera, result.blocks
    assert camera is not None
    assert blocks is not None
    bands = camera.sensor.bands
    images = {
        "Measured": blocks.measured,
        "Before": blocks.before,
        "After": blocks.after,
        "With gains and error": blocks.with_error,
    }
    order = np.argsort(bands.centre)
    off = {title: images[title] - blocks.measured for title in list(images)[1:]}
    residuals = {title: np.asarray(each)[order] for title, each in off.items()}
    return [
        "All with one stretch, that of the measured image, and one scale of length. What is "
        "compared is the last, times the camera's gains and the model's error as estimated.",
        image_views(images, bands, pixel, "Measured"),
        "Plants stand where they were mapped, so that each pixel of the simulation has its partner "
        "in the measured image, and their difference says what is off where.",
        Picture(
            "residual.png",
            figures.residual_maps(residuals, [bands.names[k] for k in order], pixel_m=pixel),
            "simulated less measured, before, after, and with gains and the model's error",
            "Simulated less measured, in each band with one scale.",
        ),
    ]


def _goal_sentences(statistics: pd.DataFrame, reference: ReferenceImage) -> list[str]:
    """What a calibration aims at, and whether it was reached with the camera's gains."""
    if not reference.goals:
        return []
    error = largest_errors(statistics)["with_gain"]
    each = [
        f"{what} within {goal:g} % ({'reached' if error[what] <= goal else 'missed'})"
        for what, goal in reference.goals.items()
    ]
    return [f"Aimed at, with the camera's gains: {', '.join(each)}."]


def pair_of_errors(before: float, after: float) -> str:
    """Two errors [%] on one line."""
    return f"{before:.1f}\N{NO-BREAK SPACE}→\N{NO-BREAK SPACE}{after:.1f}\N{NO-BREAK SPACE}%"


def real_sentence(real: RealImage, plot: tuple[float, float]) -> str:
    """How the real image is shown beside those of a plot, whose width and height [m] are given."""
    said = [
        "All with one stretch and one scale of length: that of the real image, so that what is "
        "darker or brighter than it looks so."
    ]
    whole, of = (" x ".join(f"{edge:.4g}" for edge in size) for size in (real.size, plot))
    apart = np.subtract(real.size, plot) / real.pixel
    if np.any(apart > 1.0):
        said.append(
            f"Of the real image, {whole} m, the middle is shown, no larger than the plot, {of} m; "
            "its statistics are of all of it."
        )
    elif np.any(apart < -1.0):
        said.append(
            f"The real image, {whole} m, is smaller than the plot, {of} m, and shown in its middle."
        )
    if real.block > 1:
        said.append(f"Of it means of {real.block} x {real.block} pixels are shown.")
    return " ".join(said)


def _in_bands(
    values: Float[np.ndarray, "_own y x"], real: RealImage, bands: BandSet
) -> Float[np.ndarray, "band y x"]:
    """Pixels of the real image in the camera's bands; NaN in those that it lacks."""
    empty = np.full(values.shape[1:], np.nan)
    own = dict(zip(real.bands, values, strict=True))
    return np.stack([own.get(name, empty) for name in bands.names])


def error_pictures(statistics: pd.DataFrame, reference: ReferenceImage) -> list[Picture]:
    """Bars of the errors of means and of spreads, before, after, with gains and of `reference`;
    none without either."""
    columns = {
        "before": "before", "after": "after", "with gains": "with_gain",
        "with gains and model's error": "with_error",
    }  # fmt: skip
    if reference.simulated:
        columns["DIRSIG (paper)"] = "reference"
    panels: dict[str, dict[str, dict[Any, float]]] = {}
    for title, kind in (("Means", ".mean"), ("Standard deviations between pixels", ".std")):
        rows = statistics[statistics["statistic"].str.endswith(kind)]
        rows = rows.set_index(rows["statistic"].str.removesuffix(kind))
        if len(rows):
            panels[title] = {
                who: {str(k): float(v) for k, v in rows[f"{column}_error_percent"].items()}
                for who, column in columns.items()
            }
    caption = (
        "Relative errors, before, after, after as the camera with its estimated gains measures it, "
        "and with what the model is estimated to be off by too. What was fitted is expected over "
        "plantings; other bars are of the image."
    )
    if not panels:
        return []
    return [
        Picture("errors.png", figures.error_bars(panels), "errors of means and spreads", caption)
    ]


def _distributions(
    real: RealImage | None,
    simulated: Mapping[str, np.ndarray],
    bands: BandSet,
    statistics: pd.DataFrame,
) -> list[Picture]:
    """Histograms of the bands, and of indices, over the pixels of images."""
    value = dict(zip(statistics["statistic"], statistics["real"]))

    def targets(names: Sequence[str]) -> dict[str, tuple[float, float]]:
        return {
            name: (value[f"{name}.mean"], value.get(f"{name}.std", float("nan")))
            for name in names
            if f"{name}.mean" in value
        }

    pixels = {title.lower(): image for title, image in simulated.items()}
    if real is not None:
        pixels = {"real": _in_bands(real.pixels[..., None], real, bands), **pixels}
    order = np.argsort(bands.centre)
    of_bands = {who: {bands.names[k]: image[k] for k in order} for who, image in pixels.items()}
    shown = tuple(targets(SHOWN_INDICES)) or SHOWN_INDICES
    of_indices = {who: index_images(image, bands, shown) for who, image in pixels.items()}
    return [
        Picture(
            "bands.png",
            figures.pixel_histograms(of_bands, targets(bands.names), what="Reflectance [-]"),
            "histograms of bands",
            f"Bands over the pixels. {_NO_DIFFERENCE}",
        ),
        Picture(
            "indices.png",
            figures.pixel_histograms(of_indices, targets(shown)),
            "histograms of indices",
            "Indices over the pixels of the same images.",
        ),
    ]


_NO_DIFFERENCE = (
    "No picture of the difference is shown: where each plant stands is chance, so a pixel of the "
    "simulation has no partner in the real image, and their difference would be of who stands "
    "where. What can be compared is how often each reflectance occurs, and the means."
)


_STATISTICS = (
    "Every statistic. Those that were fitted are expected over plantings, `after` and `with_gain` "
    "also over what is unknown of the parameters; others are those of the image."
)


_CAMERA = (
    "Bands of the camera: a simulated band times its gain is what the camera has. A simulation "
    "without error would be off by `exact error` from the real image; beside it what others are."
)


def _camera_sentence(camera: pd.DataFrame) -> str:
    """The part of each band's error that is the camera's own, and its certainty, in words."""
    off = camera["exact_error_percent"]
    unsure = (camera["gain"] - 1.0).abs() < 2.0 * camera["sd"]
    of = [
        f"{figures.words(band)} {error:+.0f} %"
        + (" (within the error of the gain)" if open_ else "")
        for band, error, open_ in zip(camera["band"], off, unsure, strict=True)
    ]
    return (
        "By the estimated gains even an exact simulation of these plants would be off from the "
        f"real image: {', '.join(of)}. What a simulation is off by beyond that is its own."
    )


def _one_planting(statistics: pd.DataFrame) -> str:
    """Words below the images, with their distance from the expectations of the tables."""
    means = statistics[statistics["fitted"] & statistics["statistic"].str.endswith(".mean")]
    apart = (means["image_after"] / means["after"] - 1.0).abs().max()
    return (
        "The same plants with the parameters before and at the estimate, without gains of the "
        "camera. Headline, tables and bars have what is expected over other plantings, and after "
        "calibration over what is unknown of the parameters: "
        f"their means differ from those of the image after by up to {100.0 * apart:.0f} %."
    )


def parameter_section(
    result: Calibration, stand: pd.DataFrame, parameters: pd.DataFrame
) -> Section:
    """Prior and estimate of the stand, and of every parameter."""
    directions = "; ".join(
        ", ".join(f"{name} {weight:+.2f}" for name, weight in direction.items())
        for direction in result.fit.weakly_constrained_directions()
    )
    return Section(
        "The stand and its parameters",
        [
            stand_sentence(stand),
            Table(stand, "The stand, before and after."),
            " ".join(parameter_sentences(result)),
            Picture(
                "parameters.png",
                figures.parameter_plot(parameters),
                "prior and estimate of every parameter",
                "Prior and estimate, each with its 90 % interval.",
            ),
            Picture(
                "constraint.png",
                figures.constraint_plot(parameters),
                "share of the prior variance that the data removed",
            ),
            f"Weakly constrained combinations of parameters (largest members): {directions}.",
            Table(parameters, "Every parameter.", folded=True),
        ],
    )


def search_section(run: Run, result: Calibration, memory: float) -> Section:
    """Objective after each step, ends and times of the search; `memory` at its peak [MiB]."""
    fit = result.fit
    convergence = figures.convergence_plot(fit.loss, fit.gradient_norm, rounds=fit.rounds)
    parts: list[Part] = [
        Picture(
            "convergence.png",
            convergence,
            "objective after each step",
            "The objective after each step. Errors are estimated anew where a round begins: "
            "objectives of different rounds do not compare.",
        )
    ]
    ends = result.ends
    if len(ends.objective) > 1:
        draws = [f"draw {i}" for i in range(1, len(ends.objective))]
        rows = {
            "start": ["prior's centre", *draws],
            "objective": ends.objective,
            "from the best end, posterior sd": ends.apart,
        }
        parts.append(Table(pd.DataFrame(rows), "Where each search ended."))
    parts.append(run.times(f"Wall time; peak memory {memory:.0f} MiB."))
    return Section("The search", parts)
