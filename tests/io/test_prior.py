"""Prior files: what is written is read, and a plot can be left out."""

from pathlib import Path

import numpy as np
import pytest

from fynjax._core.errors import InputError
from fynjax.app.io.plot import (
    BY_FORM,
    DEFAULT_PRIOR,
    LEAFY_FORMS,
    PRIOR_PARAMETERS,
    SHIPPED_PRIORS,
    LeftOutPlot,
    PriorError,
    PriorFile,
    PriorParameter,
    example_folder,
    read_plot,
    read_prior,
    with_prior,
    write_prior,
)
from fynjax.canopy import FORMS
from fynjax.leaf import structure_from_dry_matter
from fynjax.scene import PARAMETERS, USUAL_LEAF
from fynjax.studies.fynbos_2006 import init


def prior_file(*, lacking: str = "", **changes) -> PriorFile:
    """A population of three plots, of which A1 is left out of another; `lacking` a growth form."""
    rows = [
        PriorParameter(name=n, mean=0.4, mean_sd=0.03, plot_sd=0.04, assumed=0.5, assumed_sd=0.1)
        for n in PRIOR_PARAMETERS
        if not lacking or not n.endswith(f".{lacking}")
    ]
    fields = {
        "title": 'Plots of "fynbos"', "licence": "CC-BY-4.0", "sources": ["tables.csv"],
        "made_with": "fynjax 1", "plots": 3, "parameters": rows,
        "error": PriorError(
            wavelength_nm=[500.0, 700.0, 2000.0], sd=[0.3, 0.2, 0.1],
            correlation=[[1.0, 0.5, 0.0], [0.5, 1.0, -0.2], [0.0, -0.2, 1.0]],
        ),
        "mean_correlation": np.where(np.eye(len(rows)), 1.0, 0.5).tolist(),
        "left_out": [
            LeftOutPlot(plot="A1", means=[0.3] * len(rows)),
        ],
    }  # fmt: skip
    return PriorFile(**(fields | changes))


@pytest.fixture
def prior(tmp_path: Path):
    write_prior(tmp_path / "prior.toml", prior_file())
    return read_prior(tmp_path / "prior.toml")


def test_what_is_written_is_read(prior) -> None:
    assert prior.file == prior_file()
    assert read_prior("none") is None
    assert prior.sd("structure") == pytest.approx(0.05)
    assert prior.sd("structure", elsewhere=True) == pytest.approx(np.sqrt(0.03**2 + 2 * 0.04**2))


def test_draws_have_the_spread_elsewhere_and_move_growth_forms_together(prior) -> None:
    """Of small spreads, where logit and logarithm are straight."""
    drawn = prior.draws(20000, seed=3)
    for name, values in drawn.items():
        assert values.mean() == pytest.approx(0.4, abs=0.02), name
        assert values.std() == pytest.approx(prior.sd(name, elsewhere=True), rel=0.06), name
    one, two, other = (
        drawn[name] for name in ("dead_fraction.tussock", "dead_fraction.climber", "chlorophyll")
    )
    # Half of the variance of means, 9 of 41, is shared by all; that of plots within a kind.
    for values, correlation in ((two, (32 + 4.5) / 41), (other, 4.5 / 41)):
        assert np.corrcoef(one, values)[0, 1] == pytest.approx(correlation, abs=0.04)


def test_a_plot_learned_from_has_the_values_of_the_others(prior) -> None:
    assert prior.knows("A1")
    assert not prior.knows("B2")
    assert set(prior.values("A1").values()) == {0.3}
    assert set(prior.values("B2").values()) == {0.4}


def test_errors_between_wavelengths_are_no_smaller_than_at_them(prior) -> None:
    wavelength = np.array([400.0, 500.0, 600.0, 700.0, 1000.0, 2000.0, 2400.0])
    covariance = prior.model_error.covariance(wavelength)
    np.testing.assert_allclose(
        np.sqrt(np.diagonal(covariance)), np.interp(wavelength, [500, 700, 2000], [0.3, 0.2, 0.1])
    )
    assert covariance[1, 3] == pytest.approx(0.5 * 0.3 * 0.2)
    assert np.linalg.eigvalsh(covariance)[0] > -1e-12


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('name = "structure"', 'name = "structures"', "structure"),
        ("mean = 0.4", "mean = 1.4", r"dead_fraction\.\w+ inside 0 to 1"),
        ("means = [0.3, ", "means = [", "A1"),
        ("wavelength_nm = [500", "wavelength_nm = [900", "rising"),
        ("    [1, 0.5, 0],", "    [1, 0.9, 0],", "symmetric correlation of the error"),
        ("    [1, 0.5, 0],", "    [4, 0.5, 0],", "ones on its diagonal"),
        ("    [0.5, 1, 0.5,", "    [0.5, 2, 0.5,", "correlation of the means"),
        ("    [0.5, 1, 0.5,", "    [1, 0.5,", f"{len(PRIOR_PARAMETERS)} correlations of the means"),
        ("mean_sd = 0.03\nplot_sd = 0.04", "mean_sd = 0\nplot_sd = 0", r"dead_fraction\.\w+ above"),
        ('name = "structure"', 'name = "chlorophyll"', "structure"),
        ("sd = [0.3, 0.2, 0.1]", "sd = [0.3, 0.2]", "3 standard deviations"),
        ("plots = 3", "plots = 0", "plots"),
    ],
)
def test_a_damaged_file_names_what_is_wrong(tmp_path: Path, old: str, new: str, words: str) -> None:
    path = tmp_path / "prior.toml"
    write_prior(path, prior_file())
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))
    with pytest.raises(InputError, match=words):
        read_prior(path)


def test_of_a_form_that_a_prior_lacks_its_own_assumptions_are_taken_and_said(tmp_path) -> None:
    write_prior(tmp_path / "prior.toml", prior_file(lacking="tussock"))
    prior = read_prior(tmp_path / "prior.toml")
    assert set(prior.forms) == set(LEAFY_FORMS) - {"tussock"}
    own = FORMS["tussock"].prior
    for plot in ("A1", "B2"):
        values = prior.values(plot)
        assert set(values) == set(PRIOR_PARAMETERS)
        assert values["leaf_area_index.tussock"] == own.leaf_area_index[0]
        assert values["leaf_area_index.climber"] == (0.3 if plot == "A1" else 0.4)
    for elsewhere in (False, True):
        assert prior.sd("dead_fraction.tussock", elsewhere=elsewhere) == own.dead_fraction[1]
    assert "dead_fraction.tussock" not in prior.draws(3)
    (said,) = prior.unlearned(["deadwood", "tussock", "climber", "tussock"])
    assert said.startswith("prior.toml has no growth form tussock")

    plot = read_plot(example_folder() / "plot.toml")
    with pytest.warns(UserWarning, match="no growth form tussock"):
        taken = with_prior(plot, tmp_path / "prior.toml")
    restio = next(s for s in taken.species if s.growth_form == "tussock")
    assert restio.shoot_clumping == own.shoot_clumping[0]
    relative = own.dead_fraction[1] / own.dead_fraction[0]
    name = f"species.{restio.taxon}.dead_fraction"
    assert taken.calibration.relative_sd(name) == pytest.approx(relative)

    made = init(tmp_path / "plot", prior=tmp_path / "prior.toml")
    assert made.warnings == [said]
    rows = (tmp_path / "plot" / "species.csv").read_text("utf-8")
    assert f",{own.leaf_area_index[0]:g}," in next(r for r in rows.split() if ",tussock," in r)
    (said,) = init(tmp_path / "shipped").warnings  # of the plot's one climber
    assert said.startswith("fynbos_2023.toml has no growth form climber")


def test_a_prior_with_a_part_of_a_form_is_refused(tmp_path: Path) -> None:
    rows = [p for p in prior_file().parameters if p.name != "dead_fraction.tussock"]
    with pytest.raises(ValueError, match=r"'dead_fraction\.tussock' is missing"):
        prior_file(parameters=rows)


def test_a_mistyped_parameter_is_named_with_the_nearest(tmp_path: Path) -> None:
    rows = list(prior_file().parameters)
    wrong = [p.model_copy(update={"name": p.name.replace("tussock", "tusock")}) for p in rows]
    with pytest.raises(ValueError, match=r"'\w+\.tusock'\. Did you mean '\w+\.tussock'\?"):
        prior_file(parameters=wrong)
    with pytest.raises(ValueError, match=r"'dead_fraction\.\w+' is 2 times there"):
        prior_file(parameters=[*rows, next(p for p in rows if p.name.startswith("dead_"))])


def test_the_shipped_prior_was_learned_before_cushions_and_columns() -> None:
    prior = read_prior(DEFAULT_PRIOR)
    assert not {"cushion", "column"} & set(prior.forms)
    assert len(prior.unlearned(["cushion", "column", *prior.forms])) == 2


def test_the_defaults_are_those_of_the_shipped_prior() -> None:
    """Of growth forms and dead tissue to their digits (of forms that it lacks those are what they
    assume); of the usual leaf as `pigments` and traits
    of a plot without measured ones, times the factors."""
    learned = read_prior(DEFAULT_PRIOR)
    assert learned is not None
    mean = learned.values()
    for form in set(LEAFY_FORMS) - set(learned.forms):
        for kind in BY_FORM:
            assert getattr(FORMS[form], kind) == mean[f"{kind}.{form}"], (form, kind)
    for form in learned.forms:
        usual = FORMS[form]
        assert usual.leaf_area_index == round(mean[f"leaf_area_index.{form}"], 1), form
        assert usual.dead_fraction == round(mean[f"dead_fraction.{form}"], 2), form
        assert usual.shoot_clumping == round(mean[f"shoot_clumping.{form}"], 2), form
    assert PARAMETERS["wood_brightness"].default == round(mean["wood_brightness"], 2)
    dry = 0.02  # g cm-2
    leaf = {
        "chlorophyll": 60.0 * mean["chlorophyll"],
        "carotenoids": 12.0 * mean["chlorophyll"],
        "dry_matter": dry * mean["leaf_mass_per_area"],
        "water": dry * 0.52 / 0.48 * mean["leaf_mass_per_area"] * mean["water_per_dry_matter"],
    }
    assert {n: getattr(USUAL_LEAF, n) for n in leaf} == pytest.approx(leaf, rel=0.02)
    assert USUAL_LEAF.structure == pytest.approx(
        structure_from_dry_matter(dry) * mean["structure"], rel=0.02
    )


def test_a_name_that_is_not_shipped_is_refused() -> None:
    with pytest.raises(InputError, match="fynbos_2023"):
        read_prior("fynbos")


def test_a_plot_takes_what_its_files_leave_open(tmp_path: Path) -> None:
    write_prior(tmp_path / "prior.toml", prior_file())
    plot = read_plot(example_folder() / "plot.toml")
    first, *others = plot.species
    stated = plot.replace(species=(first.replace(dead_fraction=0.1), *others))
    priors = {"species.*.leaf_area_index": 0.7}
    stated = stated.replace(calibration=plot.calibration.replace(priors=priors))
    taken = with_prior(stated, tmp_path / "prior.toml")
    wood = stated.replace(ground=stated.ground.replace(wood_brightness=1.3))
    assert with_prior(wood, tmp_path / "prior.toml").ground.wood_brightness == 1.3
    own = with_prior(stated.replace(dead_tissue=tmp_path / "dead.csv"), tmp_path / "prior.toml")
    assert own.ground.wood_brightness is None
    assert taken.species[0].dead_fraction == 0.1
    assert taken.species[0].leaf_area_index == 0.4
    assert taken.ground.wood_brightness == 0.4
    assert taken.inputs[-1] == tmp_path / "prior.toml"
    wood = next(s for s in taken.species if s.growth_form == "deadwood")
    assert wood.leaf_area_index is None
    named = f"species.{others[0].taxon}."
    spread = np.sqrt(0.03**2 + 2 * 0.04**2) / 0.4  # in another region
    assert taken.calibration.relative_sd(named + "dead_fraction") == pytest.approx(spread)
    assert taken.calibration.relative_sd(named + "leaf_area_index") == 0.7
    assert taken.calibration.relative_sd(f"species.{first.taxon}.dead_fraction") is None
    assert with_prior(plot, "none") is plot


@pytest.mark.parametrize("name", SHIPPED_PRIORS)
def test_every_shipped_prior_is_read(name):
    assert read_prior(name) is not None
