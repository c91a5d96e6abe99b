"""The numbers of a run, as tables and as the data of its run file."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pandas as pd
import xarray as xr

from fynjax.app.io.raster import image_array
from fynjax.app.jobs._render import plant_counts
from fynjax.inversion import BandView, Calibration, Data, ImageView
from fynjax.metrics import VEGETATION_INDICES, image_statistics, without_view
from fynjax.metrics.structure import STRUCTURE_METRICS
from fynjax.scene import PARAMETERS, Scene, named_values, parameter_kind

_statistics = eqx.filter_jit(image_statistics)


def offered_stand(stand: pd.DataFrame, calibration: Calibration) -> pd.DataFrame:
    """The table of the stand with the values to use: those of the estimate, or where it is worse
    than the field table those of the prior."""
    worse = calibration.worse
    offered = stand["prior"] if worse else stand["estimate"]
    return stand.assign(offered=offered, worse_than_table=worse)


@dataclass(frozen=True)
class ReferenceImage:
    """Further knowledge of the real image, and another simulation of it."""

    real: Mapping[str, float] = field(default_factory=dict)
    """Statistics of the real image that were not fitted, or were, by name."""
    simulated: Mapping[str, float] = field(default_factory=dict)
    """Statistics of another simulation of the same plot, by name."""
    error_percent: Mapping[str, float] = field(default_factory=dict)
    """Relative errors of that other simulation where only these are known, without sign [%]."""
    goals: Mapping[str, float] = field(default_factory=dict)
    """Errors that the calibration aims at, by row of `largest_errors` [%]."""
    start: str = ""
    """Why the field table is as far off as it is, in a sentence."""


def statistic_table(calibration: Calibration, reference: ReferenceImage) -> pd.DataFrame:
    """Every statistic: real, simulated before and after, and another simulation's value.

    What was fitted is expected over plantings, and after also over what is unknown of the
    parameters; the reference's statistics that were not are those
    of the image of the scene's own plants. `image_after` has all of that image at the estimate, not
    multiplied by the camera's gains.
    """
    data = calibration.fit.data
    extra = tuple(name for name in reference.real if name not in data.names)
    names = (*data.names, *extra)
    real = np.concatenate([np.asarray(data.value), [reference.real[n] for n in extra]])
    table = pd.DataFrame(
        {
            "statistic": names,
            "fitted": [name in data.names for name in names],
            "real": real,
            "target_sd": np.concatenate([np.asarray(data.sd), np.full(len(extra), np.nan)]),
        }
    )
    for when in ("before", "after"):
        found: dict[str, float] = {}
        for view, image in seen_images(calibration, when):
            own, camera = (*view.names, *(extra if not view.view else ())), view.camera
            of_image = _statistics(
                jnp.asarray(image), own, camera.seen, pixel=camera.pixel, bands=camera.sensor.bands
            )
            under = (*view.statistic_names, *own[len(view.names) :])
            found |= dict(zip(under, map(float, of_image), strict=True))
        fitted = np.asarray(getattr(calibration, f"statistics_{when}"), float)
        expected = found | dict(zip(data.names, fitted, strict=True))
        table[when] = [expected.get(name, np.nan) for name in names]
    if found:
        table["image_after"] = table["statistic"].map(found)
    for when in ("with_gain", "with_error"):
        values = np.asarray(getattr(calibration, f"statistics_{when}"), float)
        table[when] = [*values, *np.full(len(extra), np.nan)]
    table["reference"] = [reference.simulated.get(n, np.nan) for n in names]
    for column in ("before", "after", "with_gain", "with_error", "reference"):
        table[f"{column}_error_percent"] = 100.0 * (table[column] - real) / np.abs(real)
    known = table["statistic"].map(reference.error_percent)
    table["reference_error_percent"] = table["reference_error_percent"].fillna(known)
    return table


def seen_images(calibration: Calibration, when: str) -> list[tuple[ImageView, np.ndarray]]:
    """Views of drones with the image of each, "before" or "after"."""
    views = [view for view in calibration.views if isinstance(view, BandView)]
    images = getattr(calibration, f"images_{when}")
    pairs = zip(views, images, strict=True)
    return [(view, np.asarray(one)) for view, one in pairs if isinstance(view, ImageView)]


def band_table(fit: Calibration) -> pd.DataFrame:
    """Mean of each band over the compared blocks, and the root mean square of their errors."""
    blocks, camera = fit.blocks, fit.camera
    assert blocks is not None
    assert camera is not None
    real = blocks.measured
    images = {"before": blocks.before, "after": blocks.after, "with_error": blocks.with_error}
    compared = {name: np.where(np.isfinite(real), image, np.nan) for name, image in images.items()}
    compared = {"real": real, **compared}
    table = {name: np.nanmean(image, axis=(1, 2)) for name, image in compared.items()}
    for name in images:
        error = (compared[name] - real) ** 2
        table[f"{name}_rmse"] = np.sqrt(np.nanmean(error, axis=(1, 2)))
    names = [f"{band}.mean" for band in camera.sensor.bands.names]
    return pd.DataFrame({"statistic": names, "fitted": True, **table})


def camera_table(
    calibration: Calibration, statistics: pd.DataFrame, view: ImageView
) -> pd.DataFrame:
    """Gains of a drone's camera, and what they say of each band's error.

    **Arguments:** `calibration`; `statistics`, of `statistic_table`; `view` of the camera.

    **Returns:** a row for each band: its estimated gain, that is what a simulated band is to be
    multiplied by to be as the camera has it, standard deviations after and before the data; what a
    simulation without error would be off by from the camera's mean; the factor by which reality is
    off from the model, beside the gain, and its standard deviation; and what simulations before and
    after are off by, and another one's.
    """
    with_bands = [one for one in calibration.views if isinstance(one, BandView)]
    place = next(i for i, one in enumerate(with_bands) if one is view)
    gain, gain_sd = calibration.gains[place], calibration.gains_sd[place]
    bands = view.camera.sensor.bands.names
    table = pd.DataFrame(
        {
            "band": bands,
            "gain": gain,
            "sd": gain * gain_sd,
            "exact_error_percent": 100.0 / gain - 100.0,
        }
    )
    number = next(i for i, v in enumerate(calibration.views, 1) if v is view)
    model = calibration.factors().set_index("sensor").loc[[number]]
    table.insert(3, "prior_sd", model["gain_prior_sd"].to_numpy())  # with what views drift by
    table["model_error"] = model["model_error"].to_numpy()
    table["model_error_sd"] = (model["model_error"] * model["model_error_sd"]).to_numpy()
    errors = statistics.set_index("statistic").filter(regex="_error_percent$")
    before = f"{view.view}." if view.view else ""
    means = errors.reindex([f"{before}{band}.mean" for band in bands]).reset_index(drop=True)
    order = np.argsort(view.camera.sensor.bands.centre)
    return pd.concat([table, means], axis=1).iloc[order].reset_index(drop=True)


def largest_errors(statistics: pd.DataFrame) -> pd.DataFrame:
    """Largest error of the fitted means of bands and of indices [%], before and after, with the
    camera's gains, and with the model's error too.

    Rows are "a band mean" and "a fitted index mean"; one of which nothing was fitted is left out,
    and where neither was there is one row, "a statistic of the image".
    """
    fitted = statistics[statistics["fitted"]]
    layer, kind = (fitted["statistic"].map(without_view).str.split(".").str[k] for k in (0, 1))
    is_mean, is_index = kind == "mean", layer.isin(VEGETATION_INDICES)
    parts = {
        "a band mean": fitted[is_mean & ~is_index],
        "a fitted index mean": fitted[is_mean & is_index],
    }
    if not is_mean.any():
        parts = {"a statistic of the image": fitted[~layer.isin(["spectrum", "lidar"])]}
    rows = {
        what: [part[f"{when}_error_percent"].abs().max() for when in _WHEN]
        for what, part in parts.items()
        if len(part)
    }
    return pd.DataFrame.from_dict(rows, orient="index", columns=_WHEN)


_WHEN = ["before", "after", "with_gain", "with_error"]
_COLUMNS = ["real", "target_sd", "before", "after"]


def sensor_table(data: Data, statistics: pd.DataFrame) -> pd.DataFrame:
    """The statistics of one sensor: real with its error, and simulated before and after."""
    rows = statistics.set_index("statistic").loc[list(data.names), _COLUMNS].reset_index()
    if data.source is not None and data.source.bands is not None:
        rows.insert(0, "wavelength_nm", data.source.bands.centre)
    else:
        metrics = [without_view(name).split(".", 1)[1] for name in rows["statistic"]]
        rows.insert(0, "metric", metrics)
        rows.insert(1, "unit", [STRUCTURE_METRICS.get(name, "-") for name in metrics])
    return rows.drop(columns="statistic")


def sensor_misfit(data: Data, table: pd.DataFrame) -> str:
    """Misfit of a spectrum or a cloud before and after, in a sentence."""
    source = data.source
    assert source is not None
    error = table[["before", "after"]].sub(table["real"], axis=0)
    if source.bands is not None:
        rmse = np.sqrt((error**2).mean())
        return f"RMSE of the spectrum {rmse['before']:.3f} before, {rmse['after']:.3f} after."
    what = "a structure metric" if source.kind == "structure" else "a number of the spectrum"
    largest = error.abs().div(table["target_sd"], axis=0).max()
    return (
        f"Largest deviation of {what} {largest['before']:.1f} of its standard "
        f"deviations before, {largest['after']:.1f} after."
    )


def _images(result: Calibration) -> dict[str, xr.DataArray]:
    """Simulated images before and after, of each drone."""
    return {
        f"{f'{view.view}_' if view.view else ''}reflectance_{when}": image_array(
            image,
            list(view.bands.names),
            list(view.bands.centre),
            pixel_m=view.camera.pixel,
            long_name=f"simulated reflectance factor {when} calibration",
        )
        for when in ("before", "after")
        for view, image in seen_images(result, when)
    }


def calibration_dataset(scene: Scene, result: Calibration) -> xr.Dataset:
    """Images, ends of the searches, parameters, statistics and plants, for the run file."""
    fit, ends = result.fit, result.ends
    every = named_values(result.after, scene.taxa)
    numbers = {
        "objective": ("start", ends.objective, "objective at its end"),
        "apart": ("start", ends.apart, "from the best end, posterior sd"),
        "prior": ("parameter", fit.space.prior, "prior, in parameter_unit"),
        "prior_sd": ("parameter", fit.space.prior_sd, "prior sd, in parameter_unit"),
        "estimate": ("parameter", fit.estimate, "estimate, in parameter_unit"),
        "estimate_sd": ("parameter", fit.sd, "posterior sd, in parameter_unit"),
        "constrained": ("parameter", fit.constrained, "1 - posterior/prior variance"),
        "target": ("statistic", fit.data.value, "statistic of the real image"),
        "target_sd": ("statistic", fit.data.sd, "its standard deviation"),
        "simulated_before": ("statistic", result.statistics_before, "before calibration"),
        "simulated_after": ("statistic", result.statistics_after, "after calibration"),
        "all_parameters": (
            "any_parameter",
            [float(value) for value in every.values()],
            "all parameters after calibration, own units",
        ),
    }
    plants = np.asarray(scene.counts(result.after))
    what = "mean number of plants on the plot that the covers ask for"
    units = [PARAMETERS[parameter_kind(name)].unit for name in fit.names]
    starts = np.arange(1, len(ends.objective) + 1)
    return xr.Dataset(
        {
            **_images(result),
            **{
                name: (axis, np.asarray(values, float), {"long_name": words, "units": "1"})
                for name, (axis, values, words) in numbers.items()
            },
            "plants": plant_counts(scene, plants, what),
        },
        coords={
            "start": ("start", starts, {"long_name": "number of the search", "units": "1"}),
            "parameter": ("parameter", list(fit.names), {"long_name": "free parameter"}),
            "parameter_unit": ("parameter", units, {"long_name": "its unit"}),
            "statistic": ("statistic", list(fit.data.names), {"long_name": "statistic"}),
            "any_parameter": ("any_parameter", list(every), {"long_name": "parameter"}),
        },
    )
