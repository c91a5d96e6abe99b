"""The job of `fynjax init --example fynbos`: the 2006 plot as commented files, or as it may be at
another age."""

import re
import shutil
from pathlib import Path

from fynjax._core.errors import InputError
from fynjax._core.precision import double_precision
from fynjax.app.io.plot import (
    DEFAULT_PRIOR,
    example_folder,
    read_prior,
    state_population,
    without_population,
)
from fynjax.app.io.text import staged_folder
from fynjax.app.jobs import InitResult, check_nothing_there
from fynjax.studies.fynbos_2006._recovery import SURVEY_YEAR, ground_after_fire, table_after_fire

FILES = {
    "plot.toml": "the plot, its light and sensor, and what to calibrate",
    "species.csv": "taxon, crown diameter, cover, height",
    "leaves.csv": "leaf chemistry by taxon, or measured spectra",
    "statistics.csv": "what the drone measured, as numbers",
    "README.txt": "what to do with them",
}
PUBLISHED = 2006
"""Year of the last fire of the published plot."""
ASSUMED = (
    "only the plot burnt in 2006 is published: sizes, covers and ground of another year are "
    "assumptions about recovery after fire, not measurements"
)


@double_precision
def init(
    folder: str | Path, *, burnt: int = PUBLISHED, prior: str | Path = DEFAULT_PRIOR, seed: int = 0
) -> InitResult:
    """Write the fynbos plot of the article, commented, into `folder`; it runs as it is.

    **Arguments:**

    - `folder`: where to write the plot file and its tables, made if missing.
    - `burnt`: year of the plot's last fire. 2006 is the published plot; other years rest on
      assumptions about recovery, which the files state.
    - `prior`: learned population (`read_prior`) of which the files state leaf area, dead tissue and
      the brightness of dead tissue, each with its spread in another region, and of which leaves
      have the factors; of growth forms that it lacks, what they assume themselves. "none" takes
      nothing that was learned: plants are those of shrublands at large, with wide priors, and
      leaves have no factors.
    - `seed`: seed of every random number of the plot.

    **Returns:** `InitResult`, with the files that were written.

    **Raises:** `InputError` where a file would be overwritten, for a year out of range, and as
    `read_prior`.
    """
    folder, learned = Path(folder), read_prior(prior)
    # Statistics of the published plot's image are no target for another.
    files = {k: v for k, v in FILES.items() if burnt == PUBLISHED or k != "statistics.csv"}
    check_nothing_there(folder, files)
    with staged_folder(folder) as staged:
        for name in files:
            shutil.copyfile(example_folder() / name, staged / name)
        plot = staged / "plot.toml"
        text = plot.read_text(encoding="utf-8")
        text = re.sub(r"(?m)^seed = 0 ", f"seed = {seed} ", text)
        if burnt != PUBLISHED:
            text = _at_another_age(burnt, text, staged)
        assumed = [] if burnt == PUBLISHED else [ASSUMED]
        if learned is None:
            text = without_population(text, staged)
        else:
            text, unlearned = state_population(learned, text, staged)
            assumed += unlearned
        plot.write_text(text, encoding="utf-8")
    headline = [f"Assumed: {text}." for text in assumed]
    return InitResult(
        output=str(folder), seed=seed, headline=headline, files=files, warnings=assumed
    )


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
