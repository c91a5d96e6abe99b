"""What field tables and spectra of plots say of each other, without a model of plants.

    python -m tests.benchmarks.plots_regression

Regressions from the tables of the BioSCape plots to the logarithm of their spectra, each plot left
out, beside the scores of `fynjax bioscape validate`: what a model that is as good as these could
reach from the same tables. Ridge regression with its penalty by leaving out, one PLS component, a
random forest; from covers, growth forms, leaf mass and water, and all of them. The best of many is
better by chance. And the other way round: partial least squares from spectra to covers, beside
`fynjax bioscape calibrate`.
"""

from collections.abc import Sequence

import numpy as np
from sklearn.cross_decomposition import PLSRegression
from sklearn.ensemble import RandomForestRegressor
from sklearn.linear_model import RidgeCV

from fynjax.app.compare import PlotSpectraPair, agreement_table, mean_agreement
from fynjax.studies.bioscape._inversion_compare import field_values
from fynjax.studies.bioscape._spectra import read_spectrometer
from fynjax.studies.bioscape._validate import used_bands
from tests.benchmarks._measure import bioscape_plots, options

COVERS = ("live_cover", "dead_cover", "bare_cover")
LEAVES = ("leaf_mass_per_area", "water_content")
FORMS = ("upright_ericoid", "rounded_shrub", "tussock", "broad_leaved")
METHODS = {
    "ridge": lambda: RidgeCV(np.logspace(-1, 4, 21)),
    "PLS": lambda: PLSRegression(1),
    "forest": lambda: RandomForestRegressor(200, min_samples_leaf=3, random_state=0),
}
SHOWN_NM = (860.0, 1650.0)


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the table."""
    tiny = options(__doc__).parse_args(arguments).tiny
    folder, plots, measured = bioscape_plots()
    spectrometer = read_spectrometer(folder)
    keep = used_bands(spectrometer)
    wavelength = np.asarray(spectrometer.centre)[keep]
    flights = tuple(measured[p.name].reflectance[:, keep] for p in plots)
    real = np.stack([f.mean(axis=0) for f in flights])
    field = field_values(plots).value
    forms = [
        [sum(s.cover for s in p.species if s.shape.growth_form == f) for f in FORMS] for p in plots
    ]
    tables = {
        "covers": np.stack([np.asarray(field[name], float) for name in COVERS], axis=1),
        "growth forms": np.array(forms),
        "leaves": np.array([[p.weighted_mean(name) for name in LEAVES] for p in plots], float),
    }
    tables["covers, growth forms"] = np.hstack([tables["covers"], tables["growth forms"]])
    tables["all"] = np.hstack([tables["covers, growth forms"], tables["leaves"]])
    everyone = np.arange(len(plots))
    for name, table in list(tables.items())[: 1 if tiny else None]:
        table = np.where(np.isfinite(table), table, np.nanmean(table, axis=0))
        for method, make in list(METHODS.items())[: 2 if tiny else None]:
            expected = np.empty_like(real)
            for plot in everyone:
                others = everyone != plot
                middle, scale = table[others].mean(axis=0), table[others].std(axis=0) + 1e-9
                known = ((table - middle) / scale).clip(-3.0, 3.0)
                logs = np.log(real[others])
                model = make().fit(known[others], logs - logs.mean(axis=0))
                expected[plot] = np.exp(
                    logs.mean(axis=0) + model.predict(known[plot : plot + 1])[0]
                )
            pair = PlotSpectraPair(tuple(p.name for p in plots), wavelength, expected, flights)
            scores = mean_agreement(agreement_table(pair)).set_index(["predictor", "region"])
            model, others = (scores.loc[(who, "full")] for who in ("model", "mean of other plots"))
            at = [np.argmin(np.abs(wavelength - nm)) for nm in SHOWN_NM]
            r = [np.corrcoef(expected[:, i], real[:, i])[0, 1] for i in at]
            print(
                f"{name:22s}{method:8s}{model['spectral_angle']:5.1f} degrees, RMSE "
                f"{model['rmse']:.4f}, skill {model['skill']:5.2f}; r at 860, 1650 nm "
                f"{r[0]:5.2f} {r[1]:5.2f}",
                flush=True,
            )
    print(f"mean of the other plots: {others['spectral_angle']:.1f}, {others['rmse']:.4f}")
    logs = np.log(real)
    spectra = {
        "reflectance": real,
        "its logarithm": logs,
        "that less its mean": logs - logs.mean(axis=1, keepdims=True),
    }
    for name in COVERS:
        cover = np.asarray(field[name], float)
        mean = (cover.sum() - cover) / (len(cover) - 1)
        print(f"{name} [%]: RMSE of the mean of the others {np.std(mean - cover):.1f}; PLS from")
        for kind, values in spectra.items():
            found = []
            for components in range(1, 3 if tiny else 6):
                estimate = np.empty_like(cover)
                for plot in everyone:
                    others = everyone != plot
                    model = PLSRegression(components).fit(values[others], cover[others])
                    estimate[plot] = np.ravel(model.predict(values[plot : plot + 1]))[0]
                rmse = np.sqrt(np.mean((estimate - cover) ** 2))
                found.append(f"{rmse:.1f} (r {np.corrcoef(estimate, cover)[0, 1]:.2f})")
            print(f"  {kind}, from 1 component on: {', '.join(found)}")


if __name__ == "__main__":
    main()
