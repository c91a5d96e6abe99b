"""`fynjax bioscape learn`: a population comes back from the spectra of its plots."""

import json
from pathlib import Path
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

from fynjax._core.errors import InputError
from fynjax.app.io.plot import NO_PRIOR, LearnedPrior, read_plot, read_prior
from fynjax.inversion import SpectrumView
from fynjax.scene import LEAF_FIELDS, PlotParameters, Scene
from fynjax.studies.bioscape import _learn, learn, read_bioscape, run_bioscape, write_plot_files
from fynjax.studies.bioscape._assumed import ASSUMED_POPULATION
from fynjax.studies.bioscape._inversion import plot_data, prior_space
from fynjax.studies.bioscape._population import (
    MEANS,
    PER_PLOT,
    PopulationForward,
    effect_matrix,
    hyperprior,
    population_space,
)
from fynjax.studies.bioscape._scenes import slots_of, slotted_parameters
from tests.helpers import stand_in
from tests.io.test_prior import prior_file
from tests.studies.test_bioscape import TRAITS
from tests.studies.test_bioscape_validate import CENTRES, write_tables

PLOTS = 16
BANDS = tuple(sorted({*CENTRES, 450.0, 550.0, 610.0} - {1400.0}))
_RANDOM = np.random.default_rng(11)
SLOPE = np.vstack([_RANDOM.normal(0.0, 0.12, (len(BANDS), len(PER_PLOT))), np.zeros(len(PER_PLOT))])
LEVEL = np.append(np.log(np.linspace(0.08, 0.25, len(BANDS))), 0.4)
# A truth as is assumed beforehand: what growth forms are off by goes together.
_ASSUMED = hyperprior(np.array(BANDS)).covariance[:-1, :-1]
MU = np.append(0.7 * _RANDOM.multivariate_normal(np.zeros(len(PER_PLOT)), _ASSUMED), [0.1])
EFFECT_SD, ERROR_SD = 0.4, 0.02
NO_VIEW = stand_in(SpectrumView)


class LinearForward(PopulationForward):
    """Linear in the whitened parameters, without light."""

    def __call__(self, values, scene, parameters):
        return LEVEL + SLOPE @ population_space().whitened(values)

    def linearised(self, space, u, scene, parameters):
        return LEVEL + SLOPE @ u, jnp.asarray(SLOPE)


def write_population(folder: Path) -> None:
    """Tables of plots that differ in dead cover, with spectra of the truth above."""
    random = np.random.default_rng(4)
    folder.mkdir()
    (folder / "TraitLibrary.csv").write_text(TRAITS)
    dead = np.linspace(5, 40, PLOTS)
    cover = ["Plot,PercentBareSoil,PercentBareRock,PercentDeadVegetation,PercentLiveVegetation"]
    species = ["Plot,GenusSpecies,Genus,Family,PercentCoverAlive"]
    spectra = [
        "BScpPID,QltyFlg,X,Y,start_time," + ",".join(f"Band_{i + 1}" for i in range(len(BANDS)))
    ]
    effects = random.normal(0.0, EFFECT_SD, (PLOTS, effect_matrix().shape[1]))
    for i in range(PLOTS):
        cover.append(f"P{i},{50 - dead[i]},0,{dead[i]},50")
        species.append(f"P{i},Protea repens,Protea,Proteaceae,50")
        u = MU[:-1] + effect_matrix() @ effects[i]
        log = LEVEL[:-1] + SLOPE[:-1] @ u + random.normal(0.0, ERROR_SD, len(BANDS))
        values = ",".join(f"{v:.8f}" for v in np.exp(log))
        spectra.append(f"P{i},,18.4,-34.2,2023-11-09 10:31:24+00:00,{values}")
    (folder / "CoverData.csv").write_text("\n".join(cover) + "\n")
    (folder / "VegData.csv").write_text("\n".join(species) + "\n")
    (folder / "VegCenters.csv").write_text("\n".join(spectra) + "\n")
    (folder / "waves.csv").write_text("centre\n" + "".join(f"{c}\n" for c in BANDS))


@pytest.fixture
def linear(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """The commands's steps without light; counts the simulations."""
    monkeypatch.setattr(_learn, "PopulationForward", LinearForward)
    monkeypatch.setattr(_learn, "spectrum_view", lambda *a: NO_VIEW)
    stand = stand_in(Scene), stand_in(PlotParameters)
    monkeypatch.setattr(_learn, "build_scenes", lambda files, *a: [stand] * len(files))
    done: list[int] = []
    for name in ("plot_statistics", "differentiate"):
        part = getattr(_learn, name)
        monkeypatch.setattr(_learn, name, lambda *a, part=part: (done.append(1), part(*a))[1])
    return done


def test_the_population_comes_back_and_a_stopped_run_goes_on(
    tmp_path: Path, linear: list[int]
) -> None:
    write_population(tmp_path / "tables")
    settings = {"checkpoint": tmp_path / "kept", "title": "Synthetic", "licence": "CC0"}
    result = learn([tmp_path / "tables"], tmp_path / "out", **settings)
    steps = PLOTS * (2 * _learn.PASSES + 1)
    assert len(linear) == steps
    prior = read_prior(tmp_path / "out" / "prior.toml")
    space = population_space()
    learned = prior.file.parameters
    assert prior.forms == ("broad_leaved",)  # no other stands in a plot
    own = [PER_PLOT.index(p.name) for p in learned]
    values = np.array(space.prior)
    values[own] = [p.mean for p in learned]
    mean = np.asarray(space.whitened(jnp.asarray(values)))
    slope = np.asarray(space.slope(jnp.asarray(mean)))[own]
    mean = mean[own]
    sd = np.array([p.mean_sd for p in learned]) / slope
    # Thirteen bands hold fewer means than there are: the rest keep their assumed spread.
    np.testing.assert_array_less(np.abs(mean - MU[own]), 3.5 * sd)
    assert sd.max() < 0.9
    spread = np.array([p.plot_sd for p in learned]) / slope
    assert np.median(spread[spread > 0]) == pytest.approx(EFFECT_SD, rel=0.35)
    assert spread[own.index(PER_PLOT.index("structure"))] == 0.0
    # Worth ten plots, the assumed error of a tenth keeps a part of its say.
    floor = np.sqrt((10 * 0.1**2 + PLOTS * ERROR_SD**2) / (10 + PLOTS))
    assert np.median(prior.file.error.sd) == pytest.approx(floor, rel=0.35)
    score = {row["predictor"]: row for row in result.scores}
    assert score["learned, plot left out"]["rmse"] < 0.8 * score["as assumed"]["rmse"]
    summary = json.loads(result.model_dump_json())
    for name in summary["files"]:
        assert (tmp_path / "out" / name).stat().st_size > 0
    assert "Synthetic" in (tmp_path / "out" / "prior.toml").read_text()

    # What was kept is not done again, and ends the same.
    (tmp_path / "kept" / f"calibration.{steps - 1:04d}.npz").unlink()
    again = learn([tmp_path / "tables"], tmp_path / "again", **settings)
    assert len(linear) == steps + 1
    assert again.scores == result.scores
    with pytest.raises(InputError, match="another run"):
        learn([tmp_path / "tables"], tmp_path / "again", seed=1, **settings)


def test_errors_of_means_hang_together_as_those_of_the_same_names(
    tmp_path: Path, linear: list[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Growth forms that stand in no plot are left out of the file, with their correlations."""
    lessons, write = [], _learn.write_lesson
    monkeypatch.setattr(
        _learn, "write_lesson", lambda *a, **k: (lessons.append(a[1]), write(*a, **k))[1]
    )
    write_population(tmp_path / "tables")
    learn([tmp_path / "tables"], tmp_path / "out", checkpoint=tmp_path / "kept")
    covariance = lessons[0].population.covariance
    file = read_prior(tmp_path / "out" / "prior.toml").file
    at = [PER_PLOT.index(p.name) for p in file.parameters]
    for row, i in zip(file.mean_correlation, at, strict=True):
        for found, j in zip(row, at, strict=True):
            expected = covariance[i, j] / np.sqrt(covariance[i, i] * covariance[j, j])
            assert found == pytest.approx(expected, abs=1e-4)


def test_left_out_means_do_not_know_the_plot(tmp_path: Path, linear: list[int]) -> None:
    write_population(tmp_path / "tables")
    learn([tmp_path / "tables"], tmp_path / "one", checkpoint=tmp_path / "k1")
    spectra = tmp_path / "tables" / "VegCenters.csv"
    lines = spectra.read_text().splitlines()
    fields = lines[3].split(",")
    fields[5:] = [f"{2.0 * float(v):.8f}" for v in fields[5:]]
    spectra.write_text("\n".join([*lines[:3], ",".join(fields), *lines[4:]]) + "\n")
    learn([tmp_path / "tables"], tmp_path / "two", checkpoint=tmp_path / "k2")
    one, two = (read_prior(tmp_path / name / "prior.toml") for name in ("one", "two"))
    changed, other = ([p.values(name) for p in (one, two)] for name in ("P2", "P3"))
    # Iterations start where all plots end, and end within their tolerance.
    for name, value in changed[0].items():
        assert changed[1][name] == pytest.approx(value, rel=0.02), name
    moved = [abs(other[1][n] / v - 1.0) for n, v in other[0].items()]
    assert max(moved) > 0.03


def test_plots_that_cannot_teach_are_refused(tmp_path: Path) -> None:
    write_tables(tmp_path / "tables")
    with pytest.raises(InputError, match=r"4 plots.*got 1"):
        learn([tmp_path / "tables"], tmp_path / "out", checkpoint=tmp_path / "c")
    with pytest.raises(InputError, match="two folders"):
        learn([tmp_path / "tables"] * 2, tmp_path / "out", checkpoint=tmp_path / "c")


def test_the_population_assumed_leaves_a_plot_as_it_is(tmp_path: Path) -> None:
    parameters, slots, _ = tables_in_slots(tmp_path, None)
    forward = PopulationForward(NO_VIEW, slots)
    assert len(MEANS) == len(PER_PLOT) + 1
    same = forward.plot(population_space().prior, parameters)
    assert_same_plants(same, parameters, slots, rtol=1e-5)
    assert bool(eqx.tree_equal(same.ground, parameters.ground, rtol=1e-5))


def assert_same_plants(
    found: PlotParameters, expected: PlotParameters, slots: tuple[str, ...], *, rtol: float
) -> None:
    """Species and leaves are the same where plants with leaves grow; other slots are empty."""
    bears = np.array([form != "deadwood" for form in slots])
    grows = bears & (np.asarray(expected.species.cover) > 0)
    for part, names in {"species": vars(expected.species), "leaf": LEAF_FIELDS}.items():
        for name in names:
            one, two = (getattr(getattr(p, part), name) for p in (found, expected))
            if name in ("leaf_spread", "leaf_angle"):  # leaves are alike, as the form has them
                assert one is two is None
                continue
            np.testing.assert_allclose(one[grows], two[grows], rtol=rtol)


def test_plot_files_have_what_was_learned(tmp_path: Path) -> None:
    """A prior in the files of a plot is what the forward model of `learn` makes of its values."""
    plain, slots, plot = tables_in_slots(tmp_path, None)
    values = dict(zip(PER_PLOT, np.linspace(0.35, 0.75, len(PER_PLOT))))
    rows = [p.model_copy(update={"mean": values[p.name]}) for p in prior_file().parameters]
    file = prior_file(parameters=rows, left_out=[])
    learned, _, _ = tables_in_slots(tmp_path, file)
    at = LearnedPrior(Path("p.toml"), file).values(plot.name)
    expected = PopulationForward(NO_VIEW, slots).plot(
        jnp.array([at[name] for name in PER_PLOT]), plain
    )
    assert_same_plants(learned, expected, slots, rtol=1e-3)
    assert learned.ground.brightness == pytest.approx(float(expected.ground.brightness), rel=1e-3)
    assert learned.ground.wood_brightness == pytest.approx(at["wood_brightness"], rel=1e-3)
    sources = (tmp_path / plot.name / "sources.csv").read_text()
    assert "learned (p.toml)" in sources


def tables_in_slots(folder: Path, file: Any) -> tuple[PlotParameters, tuple[str, ...], Any]:
    """Parameters of plot A1 as its files have them, in slots of both plots."""
    prior = None if file is None else LearnedPrior(Path("p.toml"), file)
    write_tables(folder / "tables")
    read = read_bioscape(folder / "tables")
    files = []
    for plot in read:
        write_plot_files(plot, folder / plot.name, prior)
        files.append(read_plot(folder / plot.name / "plot.toml"))
    slots = slots_of(files)
    return slotted_parameters(files[0], slots), slots, read[0]


def test_bioscape_takes_a_prior_or_none(tmp_path: Path) -> None:
    write_tables(tmp_path / "tables")
    run_bioscape(tmp_path / "tables", tmp_path / "plain", prior=NO_PRIOR)
    plain = read_plot(tmp_path / "plain" / "A1" / "plot.toml")
    assert plain.species[0].dead_fraction == ASSUMED_POPULATION["dead_fraction.broad_leaved"]
    assert plain.ground.wood_brightness == 1.0


def test_an_inversion_starts_from_the_population(tmp_path: Path) -> None:
    """Spreads and soil of `prior_space`, and errors of `plot_data`, are the learned ones."""
    write_tables(tmp_path)
    plot = read_bioscape(tmp_path)[0]
    learned = LearnedPrior(Path("p.toml"), prior_file(left_out=[]))
    space = prior_space(plot, None, learned)
    # The learned spread is that of the logit between the bounds, over its slope at the median.
    slope = np.asarray(space.slope(np.zeros(len(space.names))))
    sd = dict(zip(space.names, slope))
    centre = dict(zip(space.names, np.asarray(space.prior)))
    assert centre["soil_brightness"] == pytest.approx(0.4)
    assert sd["soil_brightness"] == pytest.approx(0.05)
    assert centre["leaf_area_index"] == 1.0
    for name in ("leaf_area_index", "dead_fraction", "chlorophyll", "structure"):
        assert sd[name] == pytest.approx(0.05 / 0.4), name
    mean = np.array([0.1, 0.2])
    error = learned.model_error.covariance(np.array([500.0, 700.0]))
    data = plot_data(("a", "b"), np.stack([mean, mean]), None, error)
    np.testing.assert_allclose(np.asarray(data.sd) / mean, [0.3, 0.2], rtol=0.01)
    covariance = np.linalg.inv(np.asarray(data.whitener.T @ data.whitener))
    assert covariance[0, 1] / np.prod(data.sd) == pytest.approx(0.5, abs=0.01)
