"""Numbers of a whole stand: against areas by another way, differences, and a normal posterior."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from fynjax.inversion import (
    Data,
    Functional,
    fit,
    free_space,
    stand_functionals,
    stand_sentence,
    stand_table,
    stand_values,
)
from fynjax.inversion._functionals import STAND_FUNCTIONALS
from fynjax.scene import stand_area, with_values
from tests.scene.plots import TAXA, small_parameters, small_plot


@pytest.fixture(scope="module")
def plot():
    return small_plot(extent=(2.0, 2.0)), small_parameters()


def test_they_are_those_of_the_areas_of_organs(plot):
    """Counted by `stand_area` over the area elements instead of over crowns."""
    scene, parameters = plot
    areas = stand_area(scene, parameters)
    found = {name: float(value) for name, value in stand_values(scene, parameters).items()}
    assert found.keys() == stand_functionals(scene).keys()
    assert found["green_leaf_area"] == pytest.approx(areas.leaf.sum(), rel=1e-4)
    share = areas.dead.sum() / (areas.leaf + areas.dead).sum()
    assert found["dead_share"] == pytest.approx(share, rel=1e-4)
    chlorophyll = np.asarray(parameters.leaf.chlorophyll) @ areas.leaf  # ug cm-2 m2 m-2
    assert found["canopy_chlorophyll"] == pytest.approx(1e-6 * 1e4 * chlorophyll, rel=1e-4)
    every = np.asarray(scene.visible_crowns(parameters)) / 4.0
    assert found["crown_cover"] == pytest.approx(every.sum(), rel=1e-4)
    assert found["dead_area"] == pytest.approx(areas.dead.sum(), rel=1e-4)
    water = np.asarray(parameters.leaf.water) @ areas.leaf  # g cm-2 of leaf, m2 m-2
    assert found["canopy_water"] == pytest.approx(1e4 * water, rel=1e-4)
    mass = np.asarray(parameters.leaf.dry_matter) @ areas.leaf
    assert found["leaf_mass"] == pytest.approx(1e4 * mass, rel=1e-4)
    owner = np.asarray(scene.planting.species)
    tall = np.asarray(parameters.species.height)[owner] * np.asarray(scene.planting.stature)
    assert found["canopy_height"] == pytest.approx(np.average(tall, weights=every), rel=1e-4)
    for form in set(scene.forms):
        mine = [scene.forms[one] == form for one in owner]
        assert found[f"cover.{form}"] == pytest.approx(every[mine].sum(), rel=1e-4)


def test_their_slopes_are_those_of_the_expected_stand(plot):
    """By cover, of plants that fade: the number of plants is as the cover."""
    scene, parameters = plot
    scene = dataclasses.replace(scene.expected(), dtype="float64")
    name = f"species.{TAXA[0]}.cover"

    def leaf_area(cover):
        changed = with_values(parameters, TAXA, {name: cover})
        return STAND_FUNCTIONALS["green_leaf_area"].value(scene, changed)

    at = jnp.asarray(parameters.species.cover[0], float)
    difference = (leaf_area(at * 1.02) - leaf_area(at * 0.98)) / (0.04 * at)
    assert float(jax.grad(leaf_area)(at)) == pytest.approx(float(difference), rel=0.02)


def test_an_unplanted_plot_has_none(plot):
    scene, parameters = plot
    bare = dataclasses.replace(
        parameters,
        species=dataclasses.replace(parameters.species, leaf_area_index=jnp.zeros(len(TAXA))),
    )
    for functional in STAND_FUNCTIONALS.values():
        assert np.isfinite(float(functional.value(scene, bare)))
    for functional in stand_functionals(scene).values():
        slope = jax.grad(lambda p, of=functional: of.value(scene, p))(bare)
        assert all(np.isfinite(np.asarray(leaf)).all() for leaf in jax.tree.leaves(slope))


def test_what_data_say_of_the_stand_is_more_than_of_any_parameter(plot):
    """Data of the leaf area alone: its posterior is the datum's, and no single parameter is known.
    The interval is that of a normal of the datum's error."""
    scene, parameters = plot
    space = free_space(scene, parameters, ["*.leaf_area_index", "*.dead_fraction"], lambda _: 0.3)
    functional = STAND_FUNCTIONALS["green_leaf_area"]

    def predict(values, scene):
        plot = with_values(parameters, TAXA, dict(zip(space.names, values, strict=True)))
        return functional.value(scene, plot)[None]

    usual = float(functional.value(scene.expected(), parameters))
    data = Data(("leaf area",), jnp.array([1.2 * usual]), jnp.array([0.02 * usual]))
    found = fit(predict, data, space, context=(scene.expected(),), max_steps=60)
    table = stand_table(scene, parameters, found).set_index("name")
    row = table.loc["green_leaf_area"]
    assert row.estimate == pytest.approx(1.2 * usual, rel=0.02)
    assert row.q95 - row.q05 == pytest.approx(2 * 1.645 * 0.02 * usual, rel=0.1)
    assert row.constrained > 0.95
    assert np.max(np.asarray(found.constrained)) < row.constrained - 0.2
    assert f"green leaf area {row.estimate:.3g} [" in stand_sentence(table.reset_index())
    own = {"twice": Functional("twice the leaf area", "m", lambda *a: 2.0 * functional.value(*a))}
    double = stand_table(scene, parameters, found, functionals={**STAND_FUNCTIONALS, **own})
    assert list(double["name"]) == [*STAND_FUNCTIONALS, "twice"]
    numbers = ["prior", "prior_q05", "prior_q95", "estimate", "q05", "q95"]
    double = double.set_index("name").loc["twice"]
    np.testing.assert_allclose(double[numbers].astype(float), 2.0 * row[numbers].astype(float))
    assert double.constrained == pytest.approx(row.constrained)
    forms = [f"cover.{form}" for form in dict.fromkeys(scene.forms)]
    assert list(table.index) == [*STAND_FUNCTIONALS, *forms]
    alone = stand_table(scene, parameters, found, functionals=own)
    assert f"twice the leaf area {double.estimate:.3g} [" in stand_sentence(alone, own)
    assert stand_sentence(alone).startswith(f"The stand: twice {double.estimate:.3g} [")
    ends = np.stack([np.asarray(found.whitened), np.zeros(len(space.names))])
    drawn = stand_table(scene, parameters, found, draws=np.repeat(ends, [90, 10], axis=0))
    of_draws = drawn.set_index("name").loc["green_leaf_area"]
    assert of_draws.estimate == pytest.approx(row.estimate, rel=1e-6)
    assert of_draws.q05 == pytest.approx(usual, rel=1e-3)
    assert of_draws.q95 == pytest.approx(row.estimate, rel=1e-6)
    np.testing.assert_allclose(drawn["prior"], table["prior"])


def test_intervals_stay_within_what_a_number_can_be(plot):
    """Of a share below 1; of a difference, whose posterior is normal, on both sides of zero."""
    scene, parameters = plot
    space = free_space(scene, parameters, ["*.dead_fraction"], lambda _: 0.5)
    count = len(space.names)
    data = Data([f"d{i}" for i in range(count)], [0.95] * count, [0.3] * count)
    found = fit(lambda values: values, data, space)
    own = {
        "share": Functional("dead share", "-", lambda s, p: p.species.dead_fraction.mean()),
        "left": Functional("less than half", "m", lambda s, p: p.species.dead_fraction[0] - 0.5),
    }
    table = stand_table(scene, parameters, found, functionals=own).set_index("name")
    assert 0.0 < table.q05["share"] < table.estimate["share"] < table.q95["share"] < 1.0
    slope = np.asarray(jax.jacfwd(space.physical)(found.whitened)[0])
    sd = float(np.sqrt(slope @ np.asarray(found.covariance) @ slope))
    width = table.q95["left"] - table.q05["left"]
    assert width == pytest.approx(2 * 1.645 * sd, rel=1e-3)
    assert table.estimate["left"] == pytest.approx(float(found.estimate[0]) - 0.5)
    assert table.q05["left"] < table.estimate["left"] < table.q95["left"]


def test_a_fit_prints_what_it_found(plot):
    scene, parameters = plot
    space = free_space(scene, parameters, ["*.cover"], lambda _: 0.3)
    data = Data(("first cover",), jnp.array([0.35]), jnp.array([0.001]))
    found = fit(lambda values: values[:1], data, space)
    lines = str(found).splitlines()
    assert lines[0].startswith("Converged after ")
    assert lines[1] == f"Of {len(space.names)} free parameters 1 are known twice as well as before:"
    assert lines[2].strip().startswith(f"{space.names[0]} 35 [34.8")
    assert lines[2].endswith("] %")
    table = found.table().set_index("name")
    assert table.loc[space.names[0], "estimate"] == pytest.approx(35.0, rel=1e-3)
    assert table.loc[space.names[0], "unit"] == "%"
    drawn = found.draws(4000)
    np.testing.assert_allclose(drawn[:, 0].std(), found.sd[0], rtol=0.05)
    np.testing.assert_allclose(
        np.quantile(drawn, 0.95, axis=0), found.quantiles(0.95)[0], rtol=0.05
    )
