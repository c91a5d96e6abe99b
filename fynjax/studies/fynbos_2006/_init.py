"""The job of `fynjax init`: the 2006 plot as commented files, or as it may be at another age."""

import re
import shutil
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Literal

from fynjax._core.errors import InputError
from fynjax._core.precision import double_precision
from fynjax.io.plot import (
    BY_FORM,
    DEFAULT_PRIOR,
    LEAFY_FORMS,
    LearnedPrior,
    example_folder,
    leaf_factors,
    read_prior,
)
from fynjax.io.text import staged_folder
from fynjax.jobs import JobResult
from fynjax.studies.fynbos_2006._recovery import (
    SURVEY_YEAR,
    ground_after_fire,
    table_after_fire,
)

FILES = {
    "plot.toml": "the plot, its light and sensor, and what to calibrate",
    "species.csv": "taxon, crown diameter, cover, height",
    "leaves.csv": "leaf chemistry by taxon, or measured spectra",
    "statistics.csv": "what the drone measured, as numbers",
    "README.txt": "what to do with them",
}
PUBLISHED = 2006
ASSUMED = (
    "only the plot burnt in 2006 is published: sizes, covers and ground of another year are "
    "assumptions about recovery after fire, not measurements"
)


class InitResult(JobResult):
    """Result of `init`: the files that were written."""

    command: Literal["init"] = "init"


@double_precision
def init(
    folder: str | Path,
    *,
    burnt: int = PUBLISHED,
    prior: str | Path = DEFAULT_PRIOR,
    seed: int = 0,
) -> InitResult:
    """Write a commented example plot into `folder`; it runs as it is.

    **Arguments:**

    - `folder`: where to write the plot file and its tables, made if missing.
    - `burnt`: year of the plot's last fire. 2006 is the published plot; other years rest on
      assumptions about recovery, which the files state.
    - `prior`: learned population (`read_prior`) of which the files state leaf area, dead tissue and
      the brightness of dead tissue, each with its spread in another region, and of which leaves
      have the factors; of growth forms that it lacks, what they assume themselves. "none" states
      nothing: growth forms have their defaults, with wide priors.
    - `seed`: seed of every random number of the plot.

    **Returns:** `InitResult`, with the files that were written.

    **Raises:** `InputError` where a file would be overwritten, for a year out of range, and as
    `read_prior`.
    """
    folder, learned = Path(folder), read_prior(prior)
    # Statistics of the published plot's image are no target for another.
    files = {k: v for k, v in FILES.items() if burnt == PUBLISHED or k != "statistics.csv"}
    there = [name for name in files if (folder / name).exists()]
    if there:
        raise InputError(
            f"expected a folder without {there[0]!r}; `init` overwrites nothing. Name another.",
            file=folder,
        )
    with staged_folder(folder) as staged:
        for name in files:
            shutil.copyfile(example_folder() / name, staged / name)
        plot = staged / "plot.toml"
        text = plot.read_text(encoding="utf-8")
        text = re.sub(r"(?m)^seed = 0 ", f"seed = {seed} ", text)
        if burnt != PUBLISHED:
            text = _at_another_age(burnt, text, staged)
        assumed = [] if burnt == PUBLISHED else [ASSUMED]
        if learned is not None:
            text, unlearned = _with_population(learned, text, staged)
            assumed += unlearned
        plot.write_text(text, encoding="utf-8")
    headline = [f"Assumed: {text}." for text in assumed]
    return InitResult(
        output=str(folder), seed=seed, headline=headline, files=files, warnings=assumed
    )


def _with_population(prior: LearnedPrior, text: str, folder: Path) -> tuple[str, list[str]]:
    """The plot file with means and spreads of a population, and what to say of growth forms that
    it lacks; the tables of the plot get theirs."""
    values = prior.values()
    source = f"prior {prior.path.name}: {prior.file.title}"
    notes = (
        "# Leaf area, dead tissue, clumping: means of the growth forms, learned from spectra",
        f"# ({source}).",
    )

    def of_form(name: str) -> Callable[[dict[str, str]], str]:
        return lambda row: (
            f"{values[key]:.3g}" if (key := f"{name}.{row['growth_form']}") in values else ""
        )

    rows = _rewrite(folder / "species.csv", notes, {name: of_form(name) for name in BY_FORM})
    shipped = read_prior(DEFAULT_PRIOR)
    assert shipped is not None
    if prior.file != shipped.file:
        known, new = leaf_factors(shipped.values()), leaf_factors(values)

        def of_leaf(name: str) -> Callable[[dict[str, str]], str]:
            return lambda row: (
                f"{float(row[name]) * new[name] / known[name]:.3g}" if row[name] else ""
            )

        _rewrite(
            folder / "leaves.csv",
            (f"# Here times the factors of another prior instead ({source}).",),
            {name: of_leaf(name) for name in known},
        )
    priors = [
        "# Leaf area, dead tissue, clumping: spread between plots and regions, error of the mean",
        f"# ({source}).",
    ]
    for row in rows:
        for kind in BY_FORM:
            if row["growth_form"] in LEAFY_FORMS:
                key = f"{kind}.{row['growth_form']}"
                relative = prior.sd(key, elsewhere=True) / values[key]
                priors.append(f'"species.{row["taxon"]}.{kind}" = {relative:.2f}')
    wood, spread = values["wood_brightness"], prior.sd("wood_brightness", elsewhere=True)
    priors.append(f'"ground.wood_brightness" = {spread / wood:.2f}')
    text = re.sub("# wood_brightness = [0-9.]+", f"wood_brightness = {wood:.2f} ", text)
    text = re.sub(r'(?m)^"\*\.(leaf_area_index|shoot_clumping)" = .*\n', "", text)
    text = text.replace(
        "not measured here, and how densely they stand was guessed", "not measured here"
    )
    text = text.replace("[calibration.priors]\n", "\n".join(["[calibration.priors]", *priors, ""]))
    return text, prior.unlearned(row["growth_form"] for row in rows)


def _rewrite(
    path: Path, notes: Sequence[str], columns: dict[str, Callable[[dict[str, str]], str]]
) -> list[dict[str, str]]:
    """Columns of a table computed from its rows, added at the end where it has none of the name,
    with notes above the header; its rows as they were."""
    lines = path.read_text(encoding="utf-8").splitlines()
    start = next(i for i, line in enumerate(lines) if not line.startswith("#"))
    header = lines[start].split(",")
    rows = [dict(zip(header, line.split(","), strict=True)) for line in lines[start + 1 :]]
    names = [*header, *(name for name in columns if name not in header)]
    table = [{**row, **{name: of(row) for name, of in columns.items()}} for row in rows]
    body = [",".join(names), *(",".join(row[name] for name in names) for row in table)]
    path.write_text("\n".join([*lines[:start], *notes, *body, ""]), encoding="utf-8")
    return rows


def _at_another_age(burnt: int, text: str, folder: Path) -> str:
    """The plot file of a plot that burnt in another year; writes its species table beside it."""
    age = SURVEY_YEAR - burnt
    try:
        table = table_after_fire(age)
    except InputError as error:
        raise InputError(
            f"`--burnt` must be a year from {SURVEY_YEAR - 40} to {SURVEY_YEAR - 1}, since plots "
            f"are as of {SURVEY_YEAR}, but is {burnt}"
        ) from error
    table["packing_percent"] = [0 if way == "dead" else 50 for way in table["after_fire"]]
    columns = ["taxon", "mean_diameter_cm", "cover_percent", "height_max_m", "growth_form"]
    rows = table[[*columns, "packing_percent"]].to_csv(
        index=False, float_format="%.3g", lineterminator="\n"
    )
    head = (
        f"# A plot burnt in {burnt}, {age} years old. ASSUMED, not measured: the table of the plot "
        "burnt\n# in 2006 with sizes and covers scaled by curves of recovery after fire\n"
        "# (fynjax.studies.fynbos_2006.table_after_fire). Packing is assumed as in 2006.\n"
    )
    (folder / "species.csv").write_text(head + rows, encoding="utf-8")
    guide = folder / "README.txt"
    lines = guide.read_text(encoding="utf-8").splitlines(keepends=True)
    readme = "".join(
        line for line in lines if "calibrate" not in line and not line.startswith("statistics.csv")
    )
    readme = readme.replace(
        "Sources: species.csv and statistics.csv hold facts from tables 1 and 4 of",
        f"ASSUMED: species.csv, litter and char in plot.toml are for an age of {age} years, by\n"
        "curves of recovery after fire; nobody measured them. They start from table 1 of",
    )
    guide.write_text(readme, encoding="utf-8")
    litter = float(re.search(r"(?m)^litter_fraction = ([0-9.]+)", text)[1])  # type: ignore[index]
    litter, char = ground_after_fire(age, litter)
    text = re.sub(
        r"^# A plot of fynbos that burnt in 2006, at Grootbos, South Africa. ",
        f"# A plot of fynbos as it may look {age} years after a fire of {burnt}. Only the plot\n"
        "# burnt in 2006 is published; species table, litter and char of this one are assumptions."
        "\n# ",
        text,
    )
    text = text.replace("burnt 2006", f"burnt {burnt} (assumed)")
    text = text.replace("#   fynjax calibrate plot.toml --target statistics.csv\n", "")
    text = re.sub(r"(?m)^litter_fraction = [0-9.]+ ", f"litter_fraction = {litter:.2f} ", text)
    return re.sub(r"(?m)^# char_fraction = [0-9.]+ ", f"char_fraction = {char:.2f} ", text)
