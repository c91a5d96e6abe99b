"""The job of `fynjax article`: every number of the article beside those of the shipped plot."""

from dataclasses import replace
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import pandas as pd
from pydantic import Field

from fynjax._core.arguments import Seed
from fynjax._core.dry_run import begin_work
from fynjax._core.errors import InputError
from fynjax._core.precision import double_precision
from fynjax.app.assembly import build_plot
from fynjax.app.io.plot import Plot, example_folder, read_plot
from fynjax.app.jobs import JobResult, Rows, Run
from fynjax.app.report import figures
from fynjax.app.report.pages import Page, Picture, Section, Table
from fynjax.metrics import BANDS
from fynjax.studies.fynbos_2006._article import article_tables
from fynjax.studies.fynbos_2006._demo import demo

_WHO = {
    "dirsig": "DIRSIG (paper)",
    "uncalibrated": "uncalibrated",
    "calibrated": "calibrated",
    "calibrated_with_gains": "with gains",
    "uncalibrated_measured": "uncalibrated, as measured",
    "calibrated_measured": "calibrated, as measured",
}
_CALIBRATED = (
    "The calibration has seen ten numbers of the drone's image (means of the four bands, of NDVI, "
    "GNDVI, SR and GCI, spreads of NDVI and GNDVI) and none of the spectrometer or of the LiDAR, "
    "unless it was made with them. 'Calibrated' is the plot itself; 'with gains' is its image "
    "times the gains that the calibration estimated for the bands of the camera."
)


class ArticleResult(JobResult):
    """Result of `article`."""

    command: Literal["article"] = "article"
    nearest: Rows
    """How often each simulation is nearest to the real number, by table."""


@double_precision
def article(
    output: str | Path,
    *,
    calibration: str | Path | None = None,
    size: float | tuple[float, float] = 10.0,
    pixel: Annotated[float, Field(ge=0.005)] = 0.025,
    channels: Annotated[int, Field(ge=10)] = 425,
    chain: bool = False,
    seed: Seed = 0,
    checkpoint: Path | None = None,
) -> ArticleResult:
    """Every number of the article beside those of its plot, before and after calibration.

    Looks at the 2006 plot with the drone's camera, AVIRIS-NG and two LiDAR systems, and puts what
    the article prints as real, what its DIRSIG made of it and fynjax's numbers side by side, each
    with its definition. An interrupted run goes on when the same command is given again.

    **Arguments:**

    - `output`: folder of the results, made if missing.
    - `calibration`: folder of the results of `fynjax demo`, or of another calibration of the same
      plot; left out, the demo is run first, into the folder `demo` of the results.
    - `size`: edge of the plot that is looked at, or its two [m], such as 5,10 and 5 of the
      article's relevés; the article's 10 by default.
    - `pixel`: pixel of the drone's image [m].
    - `channels`: about so many of AVIRIS-NG's 425 channels are simulated.
    - `chain`: also the images as instruments measure them: through air, with noise, the drone's by
      the empirical line of two panels.
    - `seed`: seed of everything random.
    - `checkpoint`: folder that keeps every step, from which an interrupted run goes on; none by
      default.

    **Returns:** `ArticleResult`. Writes `article.csv`, the columns of which `article_tables` has,
    figures and a page.

    **Raises:** `InputError` for a folder without a calibration of the plot.
    """
    plot = read_plot(example_folder() / "plot.toml").replace(size_m=_sides(size))
    run = Run(output, seed=seed, plot=plot)
    with run.stage("Build the plot", "build"):
        before = build_plot(plot, seed=seed)[1]
        if calibration is not None:
            calibration = Path(calibration)
            scene, after = build_plot(_calibrated(plot, calibration), seed=seed)
    begin_work({"article.csv": "a row for each number", "report.html": ""})
    if calibration is None:
        calibration = run.folder / "demo"
        with run.timed("calibrate"):
            files = demo(calibration, seed=seed, checkpoint=checkpoint).files
        run.files |= {f"demo/{name}": what for name, what in files.items()}
        scene, after = build_plot(_calibrated(plot, calibration), seed=seed)
    gains = _gains(calibration)
    with run.timed("observe"):
        scene = replace(scene, parameters=before)
        table = article_tables(
            scene, after, gains=gains, pixel=pixel, channels=channels, chain=chain, seed=seed
        )
    judged = table[table["nearest"] != ""]
    nearest = judged.groupby("table")["nearest"].value_counts().unstack(fill_value=0)
    columns = [name for name in _WHO if name in table]
    nearest = nearest.reindex(columns=columns, fill_value=0).reset_index()
    headline = _headline(table)
    run.table(
        "article.csv", table, "every number: real, DIRSIG's and fynjax's, and which is nearest"
    )
    lead = f"{' '.join(headline)} {_CALIBRATED}"
    counts = Table(nearest, "How many numbers each is nearest in.", headers=_WHO)
    inputs = [*plot.inputs, calibration / "parameters.csv"]
    sections = [Section("", [counts, *_pictures(table)]), *_tables(table)]
    run.page(Page("article", "The article's numbers", lead, sections, record=run.record(inputs)))
    return run.result(ArticleResult, headline=headline, nearest=nearest)


def _sides(size: float | tuple[float, float]) -> tuple[float, float]:
    """Both edges of the plot [m]."""
    wide, deep = np.broadcast_to(size, 2).tolist()
    if not min(wide, deep) >= 1.0:
        raise InputError(f"expected a `size` of at least 1 m, but got {min(wide, deep):g} m")
    return wide, deep


def _calibrated(plot: Plot, folder: Path) -> Plot:
    """The plot with the parameters that a calibration left in a folder."""
    path = folder / "parameters.csv"
    if not path.is_file():
        raise InputError(
            "expected the folder of the results of `fynjax demo` or `fynjax calibrate`, with a "
            "parameters.csv",
            file=folder,
        )
    return plot.replace(parameters=path)


def _gains(folder: Path) -> list[float] | None:
    """Gains of the drone's bands that a calibration estimated, by its statistics: expected means
    with and without them differ by the gain less 1 times the image's mean. None without these."""
    path = folder / "statistics.csv"
    if not path.is_file():
        return None
    means = [f"{band}.mean" for band in BANDS]
    rows = pd.read_csv(path).set_index("statistic").reindex(means)
    if not {"after", "with_gain", "image_after"} <= {*rows.columns}:
        return None
    gains = 1.0 + (rows["with_gain"] - rows["after"]) / rows["image_after"]
    return None if gains.isna().any() else gains.tolist()


def _headline(table: pd.DataFrame) -> list[str]:
    """In how many numbers each is nearer than DIRSIG, one against one."""
    judged = table[table["nearest"] != ""]
    parts = {
        "Means and spreads of the drone's image": judged["table"].isin(["figure 9", "table 4"]),
        "Spectrometer, mean at 2100 to 2450 nm": judged["table"] == "table 5",
        "LiDAR, gaps by two systems and two ways to count": judged["table"] == "section 4.4",
    }
    lines = []
    for what, chosen in parts.items():
        size = judged[chosen].filter(like="_off_percent").abs()
        nearer = [
            f"{who} {(size[f'{name}_off_percent'] < size['dirsig_off_percent']).sum()}"
            for name, who in _WHO.items()
            if name != "dirsig" and f"{name}_off_percent" in size.dropna(axis=1, how="all")
        ]
        lines.append(f"{what}, {len(size)}: nearer than DIRSIG are {', '.join(nearer)}.")
    return lines


def _pictures(table: pd.DataFrame) -> list[Picture]:
    """Pictures of errors: means, spreads, and numbers of the other sensors."""
    of_drone = table["table"].isin(["figure 9", "table 4"])
    judged, spread = table["nearest"] != "", table["quantity"].str.endswith(".std")
    others = table["quantity"].str.contains("reflectance|gap_fraction")
    parts = {
        "means": (of_drone & judged & ~spread, "Means of bands and indices of the drone's image."),
        "spreads": (of_drone & judged & spread, "Standard deviations of indices over that image."),
        "others": (others, "Spectrometer and LiDAR; by DIRSIG what is printed."),
    }
    pictures = []
    for name, (chosen, caption) in parts.items():
        rows = table[chosen].set_index(table["quantity"][chosen].str.removesuffix(".mean"))
        off = {who: rows.get(f"{k}_off_percent") for k, who in _WHO.items()}
        known = {
            who: dict(zip(rows.index, values))
            for who, values in off.items()
            if values is not None and values.notna().any()
        }
        pictures.append(
            Picture(f"{name}.png", figures.error_bars({"": known}), f"error of {name}", caption)
        )
    return pictures


def _tables(table: pd.DataFrame) -> list[Section]:
    """The numbers, a section for each table of the article; what states the input and what cannot
    be compared is folded."""
    headers = {**_WHO, "definition": "how it is defined", "dirsig_off_percent": "DIRSIG, off"}
    table = table.replace({"nearest": _WHO})
    sections = []
    for name, rows in table.groupby("table", sort=False):
        unlike = rows["dirsig"].isna() & rows["dirsig_off_percent"].notna()
        drop = [c for c in table.columns if c.endswith("_off_percent")]
        drop = [c for c in drop if c != "dirsig_off_percent" or not unlike.any()]
        rows = rows.drop(columns=["table", *drop])
        ours = rows["uncalibrated"].notna()
        inputs = str(name) in ("table 1", "table 2", "table 3")
        parts = [
            Table(
                part.replace("", None).dropna(axis=1, how="all"),
                caption,
                headers=headers,
                folded=folded,
            )
            for part, caption, folded in (
                (rows[ours], f"{ours.sum()} numbers.", inputs),
                (rows[~ours], f"{(~ours).sum()} that need data which are not published.", True),
            )
            if len(part)
        ]
        sections.append(Section(str(name).capitalize(), parts))
    return sections
