"""`fynjax bioscape validate` from tables to a report, and plots that share one shape."""

import json
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pandas as pd
import pytest
import xarray as xr

from fynjax.app.assembly._build import build_plot
from fynjax.app.cli import main
from fynjax.app.compare import PlotSpectraPair
from fynjax.app.io.plot import read_plot
from fynjax.app.jobs import Run
from fynjax.diversity import VARIETY, diversity_indices
from fynjax.sensors import BandSet
from fynjax.studies.bioscape import read_bioscape, write_plot_files
from fynjax.studies.bioscape._scenes import (
    ACCURACY,
    PlotSpectrum,
    Resolution,
    _build,
    build_scenes,
    slots_of,
)
from fynjax.studies.bioscape._spectra import Spectrometer
from fynjax.studies.bioscape._validate import species_covers, used_bands, validate_plots
from fynjax.studies.bioscape._validate_files import ValidatePlotsResult, write_report
from tests.studies.test_bioscape import FILES

CENTRES = (500.0, 670.0, 780.0, 860.0, 1240.0, 1400.0, 1650.0, 1700.0, 2150.0, 2200.0, 2300.0)
COARSE = Resolution(2.0, 0.25)


def write_tables(folder: Path, measured: bool = True) -> None:
    """The small tables of `tests.studies.test_bioscape`, with spectra of plot A1."""
    folder.mkdir(exist_ok=True)
    for name, text in FILES.items():
        (folder / name).write_text(text)
    (folder / "waves.csv").write_text("centre\n" + "".join(f"{c}\n" for c in CENTRES))
    if not measured:
        (folder / "VegCenters.csv").unlink()
        return
    bands = ",".join(f"Band_{i + 1}" for i in range(len(CENTRES)))
    rows = [
        ",".join(["A1", "", "18.4", "-34.2", f"2023-11-09 1{hour}:31:24+00:00"]
                 + [f"{0.1 + 0.01 * i + 0.02 * hour:.4f}" for i in range(len(CENTRES))])
        for hour in (1, 2)
    ]  # fmt: skip
    table = "\n".join([f"BScpPID,QltyFlg,X,Y,start_time,{bands}", *rows])
    (folder / "VegCenters.csv").write_text(table + "\n")


@pytest.fixture(scope="module")
def result(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, ValidatePlotsResult]:
    folder = tmp_path_factory.mktemp("tables")
    write_tables(folder)
    output = tmp_path_factory.mktemp("output")
    return output, validate_plots(folder, output, resolution=COARSE)


def test_bands_in_water_windows_and_at_the_edges_are_left_out() -> None:
    centre = np.array([377.0, 405.0, 420.0, 1400.0, 1500.0, 2440.0, 2470.0])
    found = used_bands(Spectrometer(centre, np.full(7, 6.0)))
    np.testing.assert_array_equal(centre[found], [420.0, 1500.0, 2440.0])


def test_plots_of_other_species_get_one_shape_and_keep_their_plants(tmp_path: Path) -> None:
    write_tables(tmp_path / "tables")
    files = []
    for plot in read_bioscape(tmp_path / "tables"):
        write_plot_files(plot, tmp_path / plot.name)
        files.append(read_plot(tmp_path / plot.name / "plot.toml"))
    slots = slots_of(files)
    assert slots == ("broad_leaved", "deadwood", "rounded_shrub", "tussock", "upright_ericoid")
    scenes = build_scenes(files, COARSE, [0, 0])
    shapes = [[leaf.shape for leaf in (m.planting.part, m.planting.foot)] for m, _ in scenes]
    assert shapes[0] == shapes[1]
    assert scenes[0][0].grid == scenes[1][0].grid
    for file, (model, parameters) in zip(files, scenes):
        alone, same = _build(file, slots, COARSE, 0, room=1.0, softness=0.0)
        expected = np.asarray(alone.area_density(same))
        found = np.asarray(model.area_density(parameters))
        layers = expected.shape[1]
        np.testing.assert_allclose(found[:, :layers], expected, rtol=1e-4, atol=1e-5)
        assert np.all(found[:, layers:] == 0)
        names = [f for f in slots if f != "deadwood"]  # classes: leaves of these, wood, flowers
        grown = {s.growth_form for s in file.species}
        for form, area in zip(names, found.sum(axis=(1, 2, 3))):
            assert (area > 0) == (form in grown)


@pytest.mark.study
def test_a_plot_looks_as_it_does_when_rendered_alone(
    tmp_path: Path, result: tuple[Path, ValidatePlotsResult]
) -> None:
    from fynjax.radiation import directional_reflectance, solve_light

    output, _ = result
    file = read_plot(output / "plots" / "A1" / "plot.toml")
    file = file.replace(size_m=(2.0, 2.0), voxel_m=0.25, structure_m="even", softness=0.0)
    bands = BandSet(("a", "b"), (670.0, 860.0), (5.8, 5.8))
    seen = []
    for seed in range(6):
        model, parameters = build_plot(file, seed=seed)
        light = solve_light(model.voxels(parameters, bands), ACCURACY)
        seen.append(directional_reflectance(light, jnp.zeros(1), jnp.zeros(1))[0])
    spectra = xr.load_dataset(output / "spectra.nc").set_index(band="wavelength")
    ours = spectra["simulated"].sel(plot="A1", band=[670.0, 860.0]).to_numpy()
    # Other plantings differ by chance alone.
    mean, sd = np.mean(seen, axis=0), np.std(seen, axis=0, ddof=1)
    assert np.all(np.abs(ours - mean) < 4.0 * sd)


@pytest.mark.study
def test_report_tables_and_spectra_belong_together(
    result: tuple[Path, ValidatePlotsResult],
) -> None:
    output, summary = result
    for name in (*summary.files, "plots/A1/plot.toml", "plots/B2/sources.csv"):
        assert (output / name).stat().st_size > 0
    spectra = xr.load_dataset(output / "spectra.nc")
    assert spectra.sizes == {"plot": 2, "band": 10}
    assert float(spectra["measured"].sel(plot="A1")[0]) == pytest.approx(0.13)
    assert np.isnan(spectra["measured"].sel(plot="B2")).all()
    simulated = spectra["simulated"].to_numpy()
    assert np.all((simulated > 0.005) & (simulated < 0.7))
    error = np.sqrt(np.mean((simulated[0] - spectra["measured"].sel(plot="A1")) ** 2))
    row = next(r for r in summary.by_plot if r["plot"] == "A1")
    assert row["rmse"] == pytest.approx(float(error), rel=1e-5)
    assert summary.measured == ["A1"]
    assert "B2" in summary.warnings[0]
    page = (output / "report.html").read_text()
    assert "Where the model is off" in page
    assert "fitted to a measured spectrum" in page


@pytest.mark.study
def test_without_measured_spectra_plots_are_simulated_and_it_is_said(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_tables(tmp_path / "tables", measured=False)
    with pytest.raises(SystemExit) as ended:
        main(["bioscape", "validate", str(tmp_path / "tables"), "--output", str(tmp_path / "out"),
              "--size", "2", "--voxel", "0.25", "--plot", "B2", "--json"])  # fmt: skip
    assert ended.value.code == 0
    summary = json.loads(capsys.readouterr().out)
    assert summary["measured"] == []
    assert "nothing to compare" in (tmp_path / "out" / "report.html").read_text()
    assert "assumed" in (tmp_path / "out" / "plots.csv").read_text()


def test_covers_of_species_add_up_by_plot(tmp_path: Path) -> None:
    write_tables(tmp_path / "tables")
    plots = read_bioscape(tmp_path / "tables")
    cover = species_covers(plots)
    taxa = sorted({s.taxon for plot in plots for s in plot.species})
    assert cover.shape == (2, len(taxa))
    for plot, row in zip(plots, cover):
        assert row.sum() == pytest.approx(plot.listed_cover)
        for species in plot.species:
            assert row[taxa.index(species.taxon)] == pytest.approx(species.cover)


def test_the_diversity_of_five_plots_and_more_is_reported(tmp_path: Path) -> None:
    random = np.random.default_rng(0)
    wave = np.array([500.0, 670.0, 780.0, 860.0, 1240.0, 1650.0, 2200.0])
    names = tuple("ABCDEFG")
    simulated = random.uniform(0.1, 0.5, (7, 7))
    flights = tuple(random.uniform(0.1, 0.5, (3, 7)) for _ in names[:-1])
    pair = PlotSpectraPair(names, wave, simulated, (*flights, np.zeros((0, 7))))  # one unmeasured
    about = pd.DataFrame({"plot": names})
    cover = random.uniform(size=(7, 4))
    variety = {name: random.uniform(size=7) for name in VARIETY}
    spectra = [
        PlotSpectrum(one, np.array(0.1), np.array(own), np.array(0.01 * k))
        for k, (one, *own) in enumerate(zip(simulated, *variety.values(), strict=True))
    ]
    run = Run(tmp_path)
    found = write_report(run, pair, about, COARSE, [], cover=cover, spectra=spectra, warnings=[])
    assert found.largest_residual == pytest.approx(0.06)
    table = pd.read_csv(tmp_path / "diversity.csv")
    assert len(table) == len(found.diversity) == 2 * (5 * 12 + 1)
    row = table.query("source == 'simulated' and diversity == 'shannon' and metric == 'rao'")
    shannon = diversity_indices(cover[:6])["shannon"]
    expected = np.corrcoef(variety["rao"][:6], shannon)[0, 1]
    assert row["value"].item() == pytest.approx(expected, rel=1e-5)
    page = (tmp_path / "report.html").read_text()
    assert "follow the diversity of the species" in page
    assert "coefficient of variation" in page


def test_missing_tables_and_bad_options_end_with_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for arguments, told in (
        ([str(tmp_path)], "CoverData.csv"),
        ([str(tmp_path / "none")], "folder"),
        ([str(tmp_path), "--voxel", "0.3"], "--voxel"),
    ):
        with pytest.raises(SystemExit) as ended:
            main(["bioscape", "validate", *arguments, "--output", str(tmp_path / "out")])
        assert ended.value.code == 2
        error = capsys.readouterr().err
        assert told in error
        assert error.count("\n") == 1
    assert not (tmp_path / "out").exists()
