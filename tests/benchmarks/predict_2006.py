"""The plot burnt in 2006 as the shipped prior predicts it, without calibration: 90 % intervals of
its drone image's statistics, and what they are wide by.

    python -m tests.benchmarks.predict_2006 [--draws 1000]

The plot stands in another region than those that the prior was learned from, and its camera is
another sensor. What differs is therefore drawn: errors of the population's means, plots, regions
(`LearnedPrior.draws`), the model's error over wavelength, and the camera's gains. Statistics are
linear in the whitened parameters, by central differences over one standard deviation; gains act on
the image itself. Nothing here is fitted to the plot.
"""

from dataclasses import replace

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pandas as pd

from fynjax.app.assembly import build_plot, image_view
from fynjax.app.compare import consistent_targets
from fynjax.app.io.plot import BY_FORM, DEFAULT_PRIOR, leaf_factors, read_prior
from fynjax.metrics import BANDS, image_statistics
from tests.benchmarks._measure import example_plot, options

GAIN_SD = 0.075
"""Of a camera calibrated by its light sensor alone: 5 to 10 % a band, half of its variance common
to all bands."""
STATISTICS = (
    *(f"{band}.mean" for band in BANDS),
    *(f"{index}.{what}" for index in ("NDVI", "GNDVI", "NormG") for what in ("mean", "std")),
)
GAP = "ground seen"  # straight down; the article's share of gaps counts LiDAR returns, or cells


def main(arguments=None) -> None:
    """Print the table."""
    parser = options(__doc__)
    parser.add_argument("--draws", type=int, default=1000)
    given = parser.parse_args(arguments)
    count = 20 if given.tiny else given.draws
    plot, prior = example_plot(1.0 if given.tiny else 10.0, given.tiny), read_prior(DEFAULT_PRIOR)
    scene, parameters = build_plot(plot)
    view = image_view(plot, scene, parameters, STATISTICS)
    simulate = eqx.filter_jit(lambda v, s, p: (*v.observe(s, p), s.gap_fraction(p)))
    mean = prior.values()

    def at(values):
        """Image, and statistics with the gap. The plot's own leaves and soil are those of the
        population's means."""
        species, leaf, ground = parameters.species, parameters.leaf, parameters.ground
        of_form = {
            kind: jnp.array(
                [
                    values.get(f"{kind}.{form}", float(own))
                    for form, own in zip(scene.forms, getattr(species, kind))
                ]
            )
            for kind in BY_FORM
        }
        known = leaf_factors(mean)
        factors = {name: new / known[name] for name, new in leaf_factors(values).items()}
        soil = ground.brightness * values["soil_brightness"] / mean["soil_brightness"]
        moved = replace(
            parameters,
            species=replace(species, **of_form),
            leaf=eqx.tree_at(
                lambda l: [getattr(l, n) for n in factors],
                leaf,
                [getattr(leaf, n) * factor for n, factor in factors.items()],
            ),
            ground=replace(
                ground, brightness=soil, wood_brightness=jnp.asarray(values["wood_brightness"])
            ),
        )
        image, statistics, gap = simulate(view, scene, moved)
        return np.asarray(image), np.append(np.asarray(statistics), float(gap))

    drawn = prior.draws(count)  # of forms in no plot that it was learned from there are no errors
    names, draws = list(drawn), np.stack(list(drawn.values()), axis=1)
    image, base = at(mean)
    step = draws.std(axis=0)
    slope = []
    for i, name in enumerate(names):
        ends = [at({**mean, name: mean[name] + sign * step[i]})[1] for sign in (1.0, -1.0)]
        slope.append((ends[0] - ends[1]) / 2.0)
        print(f"{name}: a standard deviation moves the near infrared by {slope[-1][3]:+.4f}")
    random = np.random.default_rng(1)
    bands = np.asarray(view.camera.sensor.bands.centre)
    error = random.multivariate_normal(np.zeros(4), prior.model_error.covariance(bands), count)
    alone = np.sqrt(0.5) * GAIN_SD
    camera = random.normal(0.0, alone, (count, 4)) + random.normal(0.0, alone, (count, 1))
    by_parameters = base + ((draws - draws.mean(axis=0)) / step) @ np.stack(slope)
    columns = {
        "parameters": by_parameters,
        "with the model's error": _with_gains(image, base, by_parameters, error),
        "and the camera": _with_gains(image, base, by_parameters, error + camera),
    }
    real = {t.key: t.value for t in consistent_targets()} | {GAP: np.nan}
    rows = []
    for j, name in enumerate((*STATISTICS, GAP)):
        row = {"statistic": name, "real": real[name], "mean": base[j]}
        for what, values in columns.items():
            low, high = np.quantile(values[:, j], (0.05, 0.95))
            row[f"{what}: 5 %"], row[f"{what}: 95 %"] = low, high
            row[f"width {what}"] = (high - low) / abs(real[name])
        low, high = np.quantile(values[:, j], (0.05, 0.95))
        row["inside"] = bool(low <= real[name] <= high) if name in STATISTICS else ""
        rows.append(row)
    form = lambda v: f"{v:.4g}"  # noqa: E731
    print(pd.DataFrame(rows).to_string(index=False, float_format=form, na_rep=""))


def _with_gains(image, base, statistics, gains):
    """Statistics with the image's bands times exp(`gains`): bands follow, indices shift as those
    of the mean image do."""
    moved = statistics.copy()
    for k, gain in enumerate(gains):
        at = np.asarray(
            image_statistics(jnp.asarray(image * np.exp(gain)[:, None, None]), STATISTICS)
        )
        moved[k, :-1] += at - base[:-1]
        moved[k, :4] = statistics[k, :4] * np.exp(gain)
    return moved


if __name__ == "__main__":
    main()
