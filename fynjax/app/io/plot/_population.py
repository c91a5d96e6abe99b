"""What a population of plots says of a plot, written into its files."""

import csv
import glob
import io
import json
import re
from collections.abc import Callable, Sequence
from pathlib import Path

from fynjax.app.io.plot._prior import (
    BY_FORM,
    DEFAULT_PRIOR,
    LEAFY_FORMS,
    LearnedPrior,
    leaf_factors,
    read_prior,
)


def state_population(prior: LearnedPrior, text: str, folder: Path) -> tuple[str, list[str]]:
    """The text of a plot file with means and spreads of a population, and what to say of growth
    forms that it lacks; the tables of the plot get theirs.

    **Arguments:**

    - `prior`: the population.
    - `text`: of the plot file, as `fynjax init` writes it.
    - `folder`: that holds its species table, `species.csv`, and, if it has one, its leaf table,
      `leaves.csv`. Leaf area, dead tissue and clumping of the first become the population's; the
      second is times its factors over those of the shipped prior.
    """
    values = prior.values()
    source = f"prior {prior.path.name}: {prior.file.title}"
    notes = (
        "# Leaf area, dead tissue, clumping: means of the growth forms, learned from spectra",
        f"# ({source}).",
    )

    def of_form(name: str) -> Callable[[dict[str, str]], str]:
        return lambda row: (
            row.get(name)
            or (f"{values[key]:.3g}" if (key := f"{name}.{row['growth_form']}") in values else "")
        )

    rows = rewrite_columns(folder / "species.csv", notes, {name: of_form(name) for name in BY_FORM})
    shipped = read_prior(DEFAULT_PRIOR)
    assert shipped is not None
    if prior.file != shipped.file and (folder / "leaves.csv").is_file():
        known, new = leaf_factors(shipped.values()), leaf_factors(values)

        def of_leaf(name: str) -> Callable[[dict[str, str]], str]:
            return lambda row: (
                f"{float(row[name]) * new[name] / known[name]:.3g}" if row[name] else ""
            )

        rewrite_columns(
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
                name = f"species.{glob.escape(row['taxon'])}.{kind}"
                priors.append(f"{json.dumps(name, ensure_ascii=False)} = {relative:.2f}")
    wood, spread = values["wood_brightness"], prior.sd("wood_brightness", elsewhere=True)
    priors.append(f'"ground.wood_brightness" = {spread / wood:.2f}')
    text = re.sub("# wood_brightness = [0-9.]+", f"wood_brightness = {wood:.2f} ", text)
    text = re.sub(r'(?m)^"\*\.(leaf_area_index|shoot_clumping)" = .*\n', "", text)
    text = text.replace(
        "not measured here, and how densely they stand was guessed", "not measured here"
    )
    text = text.replace("[calibration.priors]\n", "\n".join(["[calibration.priors]", *priors, ""]))
    return text, prior.unlearned(row["growth_form"] for row in rows)


def rewrite_columns(
    path: Path, notes: Sequence[str], columns: dict[str, Callable[[dict[str, str]], str]]
) -> list[dict[str, str]]:
    """Columns of a table computed from its rows, added at the end where it has none of the name,
    with notes above the header; its rows as they were."""
    lines = path.read_text(encoding="utf-8").splitlines()
    start = next(i for i, line in enumerate(lines) if not line.startswith("#"))
    rows = list(csv.DictReader(lines[start:]))
    names = [*rows[0], *(name for name in columns if name not in rows[0])]
    text = io.StringIO()
    writer = csv.DictWriter(text, names, lineterminator="\n")
    writer.writeheader()
    writer.writerows({**row, **{name: of(row) for name, of in columns.items()}} for row in rows)
    head = "".join(f"{line}\n" for line in (*lines[:start], *notes))
    path.write_text(head + text.getvalue(), encoding="utf-8")
    return rows


def without_population(text: str, folder: Path) -> str:
    """The text of a plot file of the example without what the shipped prior learned: plants of
    shrublands at large, and leaves without its factors.

    **Arguments:** `text`, `folder`: as of `state_population`.
    """
    shipped = read_prior(DEFAULT_PRIOR)
    assert shipped is not None
    known = leaf_factors(shipped.values())

    def of_leaf(name: str) -> Callable[[dict[str, str]], str]:
        return lambda row: f"{float(row[name]) / known[name]:.3g}" if row[name] else ""

    note = "# Here without these factors: no prior was to be taken."
    rewrite_columns(folder / "leaves.csv", (note,), {name: of_leaf(name) for name in known})
    note = (
        "# Here without the shipped prior: left out, they are those of shrublands at large "
        '(plants = "generic").'
    )
    rewrite_columns(folder / "species.csv", (note,), {})
    return text.replace('plants = "fynbos" ', 'plants = "generic"')
