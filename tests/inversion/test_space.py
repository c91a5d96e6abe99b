"""Parameter spaces: the transform, its inverse and its slope; priors and bounds."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

from fynjax._core.errors import InputError
from fynjax.inversion import ParameterSpace
from fynjax.inversion._space import _correlation, make_space, match_names
from fynjax.scene import LEAF_FIELDS
from fynjax.scene._parameters import OF_A_PLOT


@pytest.fixture
def space():
    return make_space(
        {"species.Erica.cover": 0.2, "ground.moisture": 0.5, "species.Erica.leaf.water": 0.02},
        {"species.Erica.cover": 0.25, "ground.moisture": 0.5, "species.Erica.leaf.water": 0.3},
    )


def test_the_median_of_the_prior_is_the_origin(space):
    np.testing.assert_allclose(space.physical(jnp.zeros(3)), [0.2, 0.5, 0.02], rtol=1e-9)
    np.testing.assert_allclose(space.prior_sd, [0.05, 0.25, 0.006], rtol=1e-9)
    assert space.distribution == ("logit-normal", "logit-normal", "lognormal")


def test_the_transform_inverts_and_stays_inside_its_bounds(space):
    u = jnp.array([-1.3, 0.4, 2.2])
    np.testing.assert_allclose(space.whitened(space.physical(u)), u, rtol=1e-9)
    far = np.asarray(space.physical(jnp.array([-30.0, 30.0, 30.0])))
    assert np.all((far >= np.asarray(space.lower)) & (far <= (1 + 1e-12) * np.asarray(space.upper)))


def test_slope_is_the_derivative(space):
    u = jnp.array([-1.3, 0.4, 2.2])
    jacobian = jax.jacfwd(space.physical)(u)
    np.testing.assert_allclose(jnp.diagonal(jacobian), space.slope(u), rtol=1e-12)


KINDS = {
    "lognormal": (0.0, 10.0, 0.4, 0.15),
    "logit-normal": (0.0, 1.0, 0.1, 0.06),
    "normal": (-1.0, np.inf, 3.0, 1.0),
}


def one(kind, lower, upper, prior, sd, **other):
    limits = ([value] for value in (lower, upper, prior, sd))
    return ParameterSpace((kind,), *limits, distribution=kind, **other)


@pytest.mark.parametrize("kind", KINDS)
def test_a_prior_has_its_distribution_with_the_stated_median_and_standard_deviation(kind):
    """Against scipy's own distributions, drawn."""
    low, high, median, sd = KINDS[kind]
    stated = one(kind, *KINDS[kind])
    normal = np.random.default_rng(3).normal(size=200_000)
    drawn = np.asarray(jax.vmap(stated.physical)(jnp.asarray(normal[:, None])))[:, 0]
    assert np.median(drawn) == pytest.approx(median, rel=5e-3)
    assert drawn.std() == pytest.approx(sd, rel=1e-2)
    assert np.all((drawn > low) & (drawn < high))
    z = {"lognormal": np.log, "logit-normal": lambda x: np.log(x / (1 - x)), "normal": np.array}
    assert stats.kstest(stats.zscore(z[kind](drawn)), "norm").statistic < 0.003


def test_a_lognormal_prior_has_the_width_of_its_closed_form():
    """(sd / median)^2 = (w - 1) w with w = exp(width^2)."""
    wide = one("lognormal", 0.0, np.inf, 2.0, 2.0 * np.sqrt(np.e * (np.e - 1.0)))
    np.testing.assert_allclose([wide.width[0], wide.location[0]], [1.0, np.log(2.0)], rtol=1e-10)


def test_a_bound_cuts_a_prior_as_scipy_cuts_a_normal_one():
    own = one("normal", 0.0, 5.0, 1.5, 1.0)
    cuts = np.asarray(own.cut)[:, 0]
    truth = stats.truncnorm(*cuts, loc=float(own.location[0]), scale=float(own.width[0]))
    np.testing.assert_allclose(truth.std(), 1.0, rtol=1e-6)
    np.testing.assert_allclose(
        np.asarray(own.quantiles(0.01, 0.5, 0.99))[:, 0], truth.ppf([0.01, 0.5, 0.99]), rtol=1e-9
    )
    values, density = own.density()
    np.testing.assert_allclose(density[:, 0], truth.pdf(np.asarray(values[:, 0])), rtol=1e-9)


@pytest.mark.parametrize("upper", [1.0, 10.0])
def test_the_derivative_of_a_cut_prior_is_that_of_differences(upper):
    """Of both halves, with the cut near and far."""
    space = one("lognormal", 0.01, upper, 0.4, 0.15)
    for u in (-2.3, -0.4, 0.6, 2.1):
        ends = [float(space.physical(jnp.array([u + step]))[0]) for step in (-1e-5, 1e-5)]
        found = jax.grad(lambda u: space.physical(u)[0])(jnp.array([u]))[0]
        assert float(found) == pytest.approx((ends[1] - ends[0]) / 2e-5, rel=1e-6)


@pytest.mark.parametrize("kind", KINDS)
def test_far_out_a_value_is_inside_and_its_density_finite(kind):
    space = one(kind, *KINDS[kind])
    for u in (-60.0, -30.0, 30.0, 60.0):
        (value,), (rate,) = space.physical(jnp.array([u])), space.log_slope(jnp.array([u]))
        assert float(space.lower[0]) - 1e-6 <= float(value) <= float(space.upper[0]) + 1e-6
        assert np.isfinite(float(rate))
        assert np.isfinite(jax.grad(lambda u: space.physical(u)[0])(jnp.array([u]))[0])


def test_the_spread_of_a_normal_coordinate_is_exact():
    """Of a lognormal value about a shifted middle: exp(m + s^2 / 2) sqrt(exp(s^2) - 1)."""
    space = one("lognormal", 0.0, np.inf, 2.0, 1.0)
    middle, sd = float(space.location[0] + 0.7 * space.width[0]), 0.5 * float(space.width[0])
    expected = np.exp(middle + sd**2 / 2.0) * np.sqrt(np.expm1(sd**2))
    found = space.spread(jnp.array([0.7]), jnp.array([0.5]))
    np.testing.assert_allclose(found, [expected], rtol=1e-6)


def test_a_width_may_be_stated_instead_and_gives_the_standard_deviation():
    stated = one("lognormal", *KINDS["lognormal"])
    width = ParameterSpace(
        ("a",), [0.0], [10.0], [0.4], width=stated.width, distribution="lognormal"
    )
    np.testing.assert_allclose(width.prior_sd, [0.15], rtol=1e-9)
    with pytest.raises(InputError, match="either"):
        ParameterSpace(("a",), [0.0], [10.0], [0.4])


def test_widths_that_are_no_widths_are_refused():
    for width in (-1.0, 0.0, np.nan):
        with pytest.raises(InputError, match="positive width"):
            ParameterSpace(("a",), [0.0], [1.0], [0.5], width=[width])


@pytest.mark.parametrize(
    ("kind", "stated"),
    [
        ("logit-normal", (0.0, 1.0, 0.001, 0.05)),
        ("lognormal", (0.0, np.inf, 1.0, 20.0)),
        ("normal", (0.0, np.inf, 1.0, 1.35)),
    ],
)
def test_wide_priors_have_their_standard_deviation_too(kind, stated):
    space = one(kind, *stated)
    u = np.linspace(-8.5, 8.5, 20001)
    weight = np.exp(-0.5 * u**2) / np.exp(-0.5 * u**2).sum()
    values = np.asarray(jax.vmap(space.physical)(jnp.asarray(u[:, None])))[:, 0]
    mean = weight @ values
    assert np.sqrt(weight @ (values - mean) ** 2) == pytest.approx(stated[3], rel=1e-3)


def test_more_than_any_distribution_between_the_bounds_is_refused():
    with pytest.raises(InputError, match=r"at most 0\.499"):
        one("logit-normal", 0.0, 1.0, 0.5, 0.6)


def test_at_a_bound_is_what_lies_nearer_than_the_prior_does():
    space = one("logit-normal", 0.0, 1.0, 0.001, 0.0005)
    assert not space.at_bound(jnp.array([0.0005]))[0]
    assert space.at_bound(jnp.array([0.00004]))[0]
    endless = one("lognormal", 0.0, np.inf, 100.0, 80.0)
    assert not endless.at_bound(jnp.array([3.0]))[0]
    assert endless.at_bound(jnp.array([0.05]))[0]


def modes(space, stretch=1.0):
    """Number of maxima of each prior's density over the parameter's own values, its width in z
    stretched."""
    u = jnp.linspace(-8.0, 8.0, 8001)
    counts = []
    for i in range(len(space.names)):
        at = jnp.zeros((u.size, len(space.names))).at[:, i].set(stretch * u)
        slope = jax.vmap(space.slope)(at)[:, i]
        rise = np.diff(np.asarray(-0.5 * u**2 - jnp.log(slope)))
        counts.append(int(((rise[:-1] > 0) & (rise[1:] <= 0)).sum()))
    return counts


@pytest.mark.parametrize(
    ("name", "value", "centre"),
    [
        ("ground.moisture", 0.0, 0.02),
        ("a.fill", 1.0, 0.99),
        ("a.fill", 1.0 - 1e-7, 0.99),
        ("a.fill", 0.995, 0.99),
        ("a.fill", 0.9, 0.9),
        ("a.leaf.structure", 0.8, 0.84),
        ("ground.litter_fraction", 0.9, 0.9),
    ],
)
def test_a_prior_that_its_bounds_do_not_hold_is_fitted_to_one_mode_and_named(name, value, centre):
    with pytest.warns(UserWarning, match=rf"{name} from .* to "):
        space = make_space({name: value}, {name: 0.4})
    np.testing.assert_allclose(space.prior, [centre], rtol=1e-6)
    assert modes(space) == [1]
    assert modes(space, 1.02) == [2]  # the widest


@pytest.mark.parametrize(
    ("name", "value", "sd", "centre"),
    [("a.leaf.anthocyanins", 0.0, 0.5, 0.8), ("a.leaf_area_index", 18.0, 0.5, 18.0)],
)
def test_an_amount_at_its_bound_keeps_most_of_its_prior(name, value, sd, centre):
    with pytest.warns(UserWarning, match=rf"{name} from .* to "):
        space = make_space({name: value}, {name: sd})
    np.testing.assert_allclose(space.prior, [centre], rtol=1e-6)
    low, high = np.asarray(space.cut)[:, 0]
    assert min(-low, high) >= 1.35


def test_a_prior_that_its_bounds_hold_stays():
    """Also where it is near a bound: char of 1 % of the ground is known to a third of that. Covers
    and diameters are bounded by what is physical, however few plants stand ready."""
    values = {"ground.char_fraction": 0.01, "a.fill": 0.7, "a.cover": 0.9, "b.cover": 0.15}
    sds = {"ground.char_fraction": 0.3, "a.fill": 0.2, "a.cover": 0.1, "b.cover": 0.5}
    space = make_space(values, sds)
    np.testing.assert_allclose(space.prior, [0.01, 0.7, 0.9, 0.15], rtol=1e-9)
    np.testing.assert_allclose(space.prior_sd, [0.003, 0.14, 0.09, 0.075], rtol=1e-9)
    np.testing.assert_allclose(space.upper, 1.0)
    assert modes(space) == [1, 1, 1, 1]


def test_halfway_between_its_bounds_a_prior_has_one_mode_up_to_the_root_of_two():
    """There z has the standard deviation of the root of two."""
    with pytest.warns(UserWarning, match="ground.moisture from 0.5 "):
        space = make_space({"ground.moisture": 0.5}, {"ground.moisture": 1.0})
    np.testing.assert_allclose(space.width, np.sqrt(2), rtol=1e-6)


def test_the_warning_has_the_units_of_files():
    both = dict.fromkeys(("a.fill", "ground.moisture"), 0.3)
    with pytest.warns(UserWarning, match=r"a\.fill from 100 \(sd 30\) to 99 \(sd [\d.]+\) %; gr"):
        make_space({"a.fill": 1.0, "ground.moisture": 0.0}, both)


@pytest.mark.parametrize(
    ("name", "value", "bound"),
    [("a.leaf.structure", 5.4, "5"), ("a.leaf.water", 0.3, "0.2"), ("a.cover", -0.1, "0")],
)
def test_a_prior_outside_its_bounds_is_refused_and_both_are_named(name, value, bound):
    with pytest.raises(InputError, match=rf"{name} .*\b{bound}\b.* got {value}"):
        make_space({name: value}, {name: 0.3})


def test_a_thick_leaf_is_a_prior_as_it_was_fitted():
    space = make_space({"a.leaf.structure": 3.8}, {"a.leaf.structure": 0.15})
    assert float(space.prior[0]) == pytest.approx(3.8, rel=1e-6)


@pytest.mark.parametrize(
    ("prior", "sd", "text"), [(2.0, 0.1, "inside its bounds"), (0.5, 0.0, "positive width")]
)
def test_impossible_priors_are_refused(prior, sd, text):
    with pytest.raises(InputError, match=text):
        ParameterSpace(("a.cover",), jnp.zeros(1), jnp.ones(1), jnp.array([prior]), jnp.array([sd]))


def test_unknown_kinds_and_patterns_are_refused():
    with pytest.raises(InputError, match="cannot be free"):
        make_space({"light.sun_azimuth": 10.0}, {"light.sun_azimuth": 0.1})
    with pytest.raises(InputError, match=r"no parameter is called 'species.Eirca"):
        match_names(["species.Erica.cover"], ["species.Eirca.*"])
    names = ["species.Erica.cover", "ground.moisture"]
    assert match_names(names, ["*.cover"]) == ["species.Erica.cover"]


def test_the_prior_of_dead_tissue_is_as_wide_whatever_its_value():
    """Its record states an absolute standard deviation; one over the value, if asked for, is."""
    names = [f"{letter}.dead_fraction" for letter in "abcd"]
    values = dict(zip(names, (0.45, 0.40, 0.30, 0.25), strict=True))
    space = make_space(values, dict.fromkeys(names))
    np.testing.assert_allclose(space.prior, list(values.values()))
    np.testing.assert_allclose(space.prior_sd, 0.25)  # one mode each: none is narrowed
    relative = make_space(values, dict.fromkeys(names, 0.1))
    np.testing.assert_allclose(relative.prior_sd, 0.1 * relative.prior)
    with pytest.warns(UserWarning, match=r"a\.dead_fraction from 0 "):
        green = make_space({"a.dead_fraction": 0.0}, {"a.dead_fraction": None})
    assert 0 < float(green.prior[0]) < 0.05


# -- traits that hang together --------------------------------------------------------------


@pytest.fixture
def together():
    """Two traits that species of a plot share in part, and their covers, which they do not."""
    names = [f"species.{taxon}.{kind}" for kind in KEPT for taxon in ("Erica", "Restio")]
    values = dict(zip(names, (0.2, 0.1, 3.0, 2.0, 50.0, 40.0), strict=True))
    return make_space(values, dict.fromkeys(names))


KEPT = ("cover", "leaf_area_index", "leaf.chlorophyll")


def test_priors_that_hang_together_keep_their_own_distribution(together):
    apart = ParameterSpace(
        together.names, together.lower, together.upper, together.prior,
        width=together.width, distribution=together.distribution,
    )  # fmt: skip
    np.testing.assert_allclose(together.quantiles(0.05, 0.9), apart.quantiles(0.05, 0.9))
    draws = np.random.default_rng(3).normal(size=(20000, 6))
    values = np.asarray(jax.vmap(together.physical)(draws))
    for i, share in enumerate((0.05, 0.9)):
        below = np.mean(values < np.asarray(together.quantiles(0.05, 0.9))[i], axis=0)
        np.testing.assert_allclose(below, share, atol=0.01)
    normal = np.asarray(jax.vmap(apart.whitened)(jnp.asarray(values)))
    expected = np.eye(6)
    for first, second in ((2, 3), (4, 5)):
        expected[first, second] = expected[second, first] = OF_A_PLOT
    np.testing.assert_allclose(np.corrcoef(normal.T), expected, atol=0.03)


def test_whitened_coordinates_of_shared_traits_are_their_inverse(together):
    u = jnp.array([-1.3, 0.4, 1.2, -0.5, 0.1, 2.0])
    np.testing.assert_allclose(together.whitened(together.physical(u)), u, atol=1e-9)
    jacobian = jax.jacfwd(together.physical)(u)
    volume = np.linalg.slogdet(np.asarray(jacobian))[1]
    constant = np.linalg.slogdet(np.asarray(together.mixing))[1]
    assert float(jnp.sum(together.log_slope(u))) + constant == pytest.approx(volume)


def test_the_variance_of_one_parameter_is_that_of_its_draws(together):
    root = np.random.default_rng(5).normal(size=(6, 6)) / 3.0
    covariance = root @ root.T
    draws = np.random.default_rng(6).multivariate_normal(np.zeros(6), covariance, 40000)
    own = np.asarray(jax.vmap(together.together)(draws)).var(axis=0)
    np.testing.assert_allclose(together.own_variance(jnp.asarray(covariance)), own, rtol=0.03)
    np.testing.assert_allclose(together.own_variance(jnp.eye(6)), 1.0)
    sd = jnp.sqrt(together.own_variance(jnp.asarray(covariance)))
    values = np.asarray(jax.vmap(together.physical)(draws))
    np.testing.assert_allclose(together.spread(jnp.zeros(6), sd), values.std(axis=0), rtol=0.05)


def test_a_correlation_that_is_none_is_refused():
    def made(correlation):
        unit = jnp.ones(2)
        return ParameterSpace(
            ("a", "b"), 0 * unit, 10 * unit, unit, 0.1 * unit, correlation=correlation
        )

    assert made([[1.0, 0.5], [0.5, 1.0]]).mixing is not None
    for bad, text in (
        ([[1.0, 0.5], [0.4, 1.0]], "symmetric"),
        ([[1.0, 1.0], [1.0, 1.0]], "positive definite"),
        ([[2.0, 0.0], [0.0, 2.0]], "ones on its diagonal"),
        ([[1.0]], "for 2 parameters"),
    ):
        with pytest.raises(InputError, match=text):
            made(bad)


def test_traits_of_leaves_and_shoots_hang_together_in_a_plot_and_sizes_do_not():
    """Half of what a prior of each is off by is common to the species of a plot (docs/model.md)."""
    shoots = ("leaf_area_index", "wood_area_index", "shoot_clumping", "dead_fraction")
    for kind in (*shoots, *(f"leaf.{trait}" for trait in LEAF_FIELDS)):
        matrix = _correlation([f"species.A.{kind}", "species.A.cover", f"species.B.{kind}"])
        expected = [[1.0, 0.0, 0.5], [0.0, 1.0, 0.0], [0.5, 0.0, 1.0]]
        np.testing.assert_array_equal(matrix, expected, err_msg=kind)
    for kind in ("cover", "diameter", "height"):
        assert _correlation([f"species.A.{kind}", f"species.B.{kind}"]) is None
