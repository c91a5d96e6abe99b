"""PROSPECT against the authors' output, exact limits, energy and finite differences."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import quad
from scipy.special import exp1

import fynjax as fx
from fynjax._core.errors import InputError
from fynjax.leaf import LeafParameters, prospect
from fynjax.leaf._prospect import (
    _stack,
    cylinder_transmissivity,
    interface_transmissivity,
    pile_and_slopes,
)
from fynjax.leaf._transmissivity import exponential_integral, layer_absorptance
from tests.helpers import assert_gradients

COLUMNS = {
    "structure": "n",
    "chlorophyll": "cab",
    "carotenoids": "car",
    "anthocyanins": "ant",
    "brown_pigments": "brown",
    "water": "ewt",
    "dry_matter": "lma",
    "proteins": "prot",
    "carbon_constituents": "cbc",
}
BANDS = np.array([400.0, 445.0, 550.0, 670.0, 705.5, 850.0, 1131.0, 1450.0, 1940.0, 2500.0])
CLEAR = {
    "chlorophyll": 0.0,
    "carotenoids": 0.0,
    "water": 0.0,
    "dry_matter": 0.0,
    "proteins": 0.0,
    "carbon_constituents": 0.0,
}


def both(parameters, wavelength=BANDS, **options):
    optics = prospect(parameters, wavelength, **options)
    return jnp.stack([optics.reflectance, optics.transmittance])


@pytest.mark.parametrize("version", ["D", "PRO"])
@pytest.mark.parametrize(("dtype", "tolerance"), [(np.float64, 1e-12), (np.float32, 2e-6)])
def test_agrees_with_the_authors_own_package(shared_data, version, dtype, tolerance):
    with np.load(shared_data / "leaf" / "reference_prospect_R.npz") as stored:
        reference = dict(stored)
    leaves = LeafParameters.many(
        **{name: reference[f"par_{key}"].astype(dtype) for name, key in COLUMNS.items()}
    )
    optics = jax.jit(jax.vmap(lambda leaf: prospect(leaf, version=version)))(leaves)
    assert optics.reflectance.dtype == optics.wavelength.dtype == dtype
    np.testing.assert_allclose(
        optics.reflectance, reference[f"refl_{version}"], rtol=0, atol=tolerance
    )
    np.testing.assert_allclose(
        optics.transmittance, reference[f"tran_{version}"], rtol=0, atol=tolerance
    )


def test_version_5_is_the_published_model_written_naively(shared_data):
    """The textbook formulas with SciPy's E1, straight from Jacquemoud & Baret 1990."""
    table = np.genfromtxt(
        shared_data / "leaf" / "prospect5_coefficients.csv.gz", delimiter=",", names=True
    )
    structure, index = 1.7, table["nr"]
    contents = {"cab": 35.0, "car": 9.0, "brown": 0.1, "ewt": 0.012, "lma": 0.007}
    k = sum(amount * table[name] for name, amount in contents.items()) / structure
    theta = (1 - k) * np.exp(-k) + k**2 * exp1(k)
    first, t12 = cone_average(40.0, index), cone_average(90.0, index)
    t21 = t12 / index**2
    r12, r21 = 1 - t12, 1 - t21
    bounce = 1 - (r21 * theta) ** 2
    layer = [(x * theta * t21 / bounce) for x in (first, t12)]
    r_first, r = 1 - first + r21 * theta * layer[0], r12 + r21 * theta * layer[1]
    t = layer[1]
    d = np.sqrt((1 + r + t) * (1 + r - t) * (1 - r + t) * (1 - r - t))
    a, b = (1 + r**2 - t**2 + d) / (2 * r), (1 - r**2 + t**2 + d) / (2 * t)
    power = b ** (structure - 1)
    r_sub = a * (power**2 - 1) / (a**2 * power**2 - 1)
    t_sub = power * (a**2 - 1) / (a**2 * power**2 - 1)
    optics = prospect(
        LeafParameters(
            structure=structure, chlorophyll=35.0, carotenoids=9.0, brown_pigments=0.1,
            water=0.012, dry_matter=0.007, anthocyanins=5.0,
        ),
        version="5",
    )  # fmt: skip
    expected_r = r_first + layer[0] * r_sub * t / (1 - r_sub * r)
    np.testing.assert_allclose(optics.reflectance, expected_r, rtol=0, atol=1e-8)
    np.testing.assert_allclose(
        optics.transmittance, layer[0] * t_sub / (1 - r_sub * r), rtol=0, atol=1e-8
    )


def cone_average(angle, index):
    """Fresnel's equations integrated over the cone with the weight sin(2 a), by quadrature."""

    def transmissivity(a, n):
        s, c = np.sin(a), np.cos(a)
        inside = np.sqrt(n**2 - s**2)
        perpendicular = ((c - inside) / (c + inside)) ** 2
        parallel = ((n**2 * c - inside) / (n**2 * c + inside)) ** 2
        return (1 - (perpendicular + parallel) / 2) * np.sin(2 * a)

    top = np.deg2rad(angle)
    nodes = np.linspace(index.min(), index.max(), 9)
    values = [
        quad(transmissivity, 0, top, args=(n,), epsabs=1e-13)[0] / np.sin(top) ** 2 for n in nodes
    ]
    return np.polynomial.Polynomial.fit(nodes, values, 8)(index)


@pytest.mark.parametrize("angle", [5.0, 40.0, 59.0, 89.9, 90.0])
def test_surface_transmissivity_is_the_average_of_fresnel(angle):
    index = np.array([1.25, 1.33, 1.4, 1.45, 1.52])
    np.testing.assert_allclose(
        interface_transmissivity(angle, index), cone_average(angle, index), rtol=0, atol=2e-10
    )
    slope = jax.grad(lambda a: interface_transmissivity(a, 1.4))(jnp.asarray(angle))
    h = 1e-4
    one_sided = angle == 90.0
    upper = angle if one_sided else angle + h
    difference = (
        interface_transmissivity(upper, 1.4) - interface_transmissivity(angle - h, 1.4)
    ) / (h if one_sided else 2 * h)
    assert abs(slope - difference) < 1e-4 * abs(difference) + 1e-7


def test_surface_of_a_cylinder_is_fresnel_over_its_width(shared_data):
    def lost(x, n):
        """Fresnel's law in the angles of incidence and refraction, at x of half the width."""
        a, b = np.arcsin(x), np.arcsin(x / n)
        across, along = np.sin(a - b) / np.sin(a + b), np.tan(a - b) / np.tan(a + b)
        return (across**2 + along**2) / 2

    for n in (1.3, 1.45, 1.52):
        exact = 1 - quad(lost, 1e-9, 1, args=(n,), epsabs=1e-10)[0]
        assert cylinder_transmissivity(np.array([n]))[0] == pytest.approx(exact, abs=1e-6)
    # Where a green needle is black within, what it reflects is its surface.
    with np.load(shared_data / "leaf" / "divittorio_needle_spectra.npz") as stored:
        real = np.median(stored["refl"][:, np.argmin(np.abs(stored["wl"] - 450.0))])
    needle, broad = (
        prospect(LeafParameters(chlorophyll=70.0, carotenoids=12.0), [450.0], leaf_shape=shape)
        for shape in ("needle", "broad")
    )
    assert float(needle.reflectance[0]) == pytest.approx(real, abs=0.006)
    assert float(broad.reflectance[0]) < real - 0.02
    with pytest.raises(ValueError, match="leaf_shape"):
        prospect(LeafParameters(), leaf_shape="round")


def test_layer_absorptance_and_its_derivatives_are_exact():
    k = np.concatenate([np.logspace(-14, 2.8, 20001), np.linspace(0.01, 3, 5001)])
    exact = -np.expm1(-k) + k * np.exp(-k) - k**2 * exp1(k)
    value = np.asarray(layer_absorptance(jnp.asarray(k)))
    assert np.abs(value - exact).max() < 1e-13
    assert np.abs(value / exact - 1.0)[k < 1e-2].max() < 1e-13
    slope = jax.vmap(jax.grad(layer_absorptance))(jnp.asarray(k))
    assert np.abs(slope - (2 * np.exp(-k) - 2 * k * exp1(k))).max() < 1e-13
    curvature = jax.vmap(jax.grad(jax.grad(layer_absorptance)))(jnp.asarray(k))
    np.testing.assert_allclose(curvature, -2 * exp1(k), rtol=1e-12, atol=2e-12)
    third = jax.grad(jax.grad(jax.grad(layer_absorptance)))(0.3)
    assert third == pytest.approx(2 * np.exp(-0.3) / 0.3, rel=1e-10)
    integral = exponential_integral(jnp.asarray(k))
    np.testing.assert_allclose(integral, exp1(k), rtol=1e-13, atol=1e-12)
    assert layer_absorptance(jnp.float32(0.5)).dtype == np.float32


def test_layer_absorptance_at_its_edges():
    edges = jnp.array([-1.0, 0.0, 1e-300, 700.0, 1e4, jnp.inf])
    assert np.array_equal(layer_absorptance(edges)[:2], [0.0, 0.0])
    np.testing.assert_allclose(layer_absorptance(edges)[3:], 1.0)
    assert jax.grad(layer_absorptance)(0.0) == 2.0
    assert jax.grad(jax.grad(layer_absorptance))(0.0) == pytest.approx(-2 * exp1(1e-30), abs=1e-6)
    for order_two in (0.0, 1e-300, 700.0, 1e5, np.inf):
        assert np.isfinite(jax.grad(jax.grad(layer_absorptance))(order_two))


@pytest.mark.parametrize(
    "version",
    ["D", pytest.param("5", marks=pytest.mark.study), pytest.param("PRO", marks=pytest.mark.slow)],
)
def test_gradients_equal_differences(version):
    leaf = LeafParameters(
        structure=1.8, chlorophyll=30.0, carotenoids=7.0, anthocyanins=2.0, brown_pigments=0.2,
        water=0.012, dry_matter=0.008, proteins=0.001, carbon_constituents=0.006,
    )  # fmt: skip
    leaf = jax.tree.map(lambda x: jnp.asarray(x, float), leaf)
    assert_gradients(jax.jit(lambda p: both(p, version=version)), leaf, rtol=2e-6)
    if version == "D":
        at_angle = jax.jit(lambda a: both(leaf, incidence_half_angle=a))
        assert_gradients(at_angle, jnp.asarray(40.0))


def test_many_leaves_are_computed_in_blocks_and_come_out_the_same():
    count = 230
    leaves = LeafParameters.many(
        structure=np.linspace(1.0, 3.0, count), chlorophyll=np.linspace(1.0, 90.0, count)
    )
    many = jax.jit(jax.vmap(both))
    at_once = jnp.concatenate([many(jax.tree.map(lambda x, i=i: x[i : i + 46], leaves))
                               for i in range(0, count, 46)])  # fmt: skip
    np.testing.assert_allclose(many(leaves), at_once, rtol=1e-12)
    pairs = jax.tree.map(lambda x: x.reshape(2, 115), leaves)
    np.testing.assert_allclose(
        jax.vmap(jax.vmap(both))(pairs).reshape(at_once.shape), at_once, rtol=1e-12
    )
    slope = jax.vmap(jax.grad(lambda leaf: both(leaf).sum()))(leaves).chlorophyll[200]
    alone = jax.grad(lambda leaf: both(leaf).sum())(jax.tree.map(lambda x: x[200], leaves))
    assert float(slope) == pytest.approx(float(alone.chlorophyll), rel=1e-10)
    if jax.default_backend() == "cpu":
        whole = jax.jit(jax.vmap(prospect)).lower(jax.tree.map(lambda x: jnp.repeat(x, 10), leaves))
        used = whole.compile().memory_analysis()
        assert used.temp_size_in_bytes < 0.8 * used.output_size_in_bytes


def test_incidence_angle_as_a_traced_array_gives_the_same_leaf():
    leaf = LeafParameters()
    np.testing.assert_allclose(
        both(leaf, incidence_half_angle=jnp.asarray(59.0)), both(leaf, incidence_half_angle=59.0),
        rtol=0, atol=1e-12,
    )  # fmt: skip


@pytest.mark.parametrize("structure", [1.0, 1.4, 2.0, 3.7])
def test_a_leaf_that_absorbs_nothing_is_a_pile_of_plates(structure):
    """Without absorption R + T = 1, and T of N - 1 equal plates is t / (t + (1 - t)(N - 1))."""
    index = 1.45
    first, t12 = (
        cone_average(40.0, np.array([index, 1.5]))[0],
        cone_average(90.0, np.array([index, 1.5]))[0],
    )
    t21 = t12 / index**2
    layer = [x * t21 / (1 - (1 - t21) ** 2) for x in (first, t12)]
    t, m = layer[1], structure - 1.0
    rest = t / (t + (1 - t) * m)
    expected = layer[0] * rest / (1 - (1 - rest) * (1 - t))

    @jax.jit
    def at(absorbed, n):
        return jnp.stack(
            _stack(absorbed, n, jnp.asarray(first), jnp.asarray(t12), jnp.asarray(index))[0]
        )

    reflectance, transmittance = at(jnp.asarray(0.0), jnp.asarray(structure))
    assert transmittance == pytest.approx(expected, abs=1e-14)
    assert reflectance + transmittance == pytest.approx(1.0, abs=1e-14)
    # The derivative at zero is the limit of the derivatives beside it, not just finite.
    for argument in (0, 1):
        edge = jax.jacfwd(at, argument)(jnp.asarray(0.0), jnp.asarray(structure))
        beside = jax.jacfwd(at, argument)(jnp.asarray(1e-9), jnp.asarray(structure))
        np.testing.assert_allclose(edge, beside, rtol=1e-6, atol=1e-9)
        slope = (
            at(jnp.asarray(1e-6), jnp.asarray(structure))
            - at(jnp.asarray(0.0), jnp.asarray(structure))
        ) / 1e-6
        if argument == 0:
            np.testing.assert_allclose(edge, slope, rtol=1e-4)
    reverse = jax.jacrev(at)(jnp.asarray(0.0), jnp.asarray(structure))
    np.testing.assert_allclose(reverse, jax.jacfwd(at)(jnp.asarray(0.0), jnp.asarray(structure)))


@pytest.mark.parametrize("structure", [1.0, 1.3, 2.5, 4.0])
def test_series_and_closed_form_are_stokes_in_extended_precision(structure):
    """Both branches of `_stack` against the textbook form in 64-bit-mantissa arithmetic."""
    absorbed = np.logspace(-7, -1, 2001)
    first, t12, index = 0.95, 0.9, 1.4
    layers = jnp.asarray(structure)
    surface = map(jnp.asarray, (first, t12, index))
    reflectance, transmittance = _stack(jnp.asarray(absorbed), layers, *surface)[0]
    theta = 1 - absorbed.astype(np.longdouble)
    t21 = np.longdouble(t12) / np.longdouble(index) ** 2
    bounce = 1 - ((1 - t21) * theta) ** 2
    t_first, t = first * theta * t21 / bounce, np.longdouble(t12) * theta * t21 / bounce
    r = 1 - np.longdouble(t12) + (1 - t21) * theta * t
    d = np.sqrt((1 + r + t) * (1 + r - t) * (1 - r + t) * (1 - r - t))
    a, b = (1 + r**2 - t**2 + d) / (2 * r), (1 - r**2 + t**2 + d) / (2 * t)
    power = b ** (structure - 1)
    bottom = a**2 * power**2 - 1
    r_sub, t_sub = a * (power**2 - 1) / bottom, power * (a**2 - 1) / bottom
    expected_r = (
        1
        - np.longdouble(first)
        + (1 - t21) * theta * t_first
        + t_first * r_sub * t / (1 - r_sub * r)
    )
    np.testing.assert_allclose(transmittance, t_first * t_sub / (1 - r_sub * r), rtol=0, atol=2e-14)
    np.testing.assert_allclose(reflectance, expected_r, rtol=0, atol=2e-14)


@pytest.mark.parametrize(("dtype", "tolerance"), [(np.float64, 3e-12), (np.float32, 2e-5)])
def test_written_slopes_are_the_automatic_ones(dtype, tolerance):
    """Over thin, usual and opaque layers, those that absorb nothing, and N = 1."""
    draw = np.random.default_rng(3)
    k = np.concatenate([np.zeros(50), 10 ** draw.uniform(-12, 2.8, 20_000)]).astype(dtype)
    structure = draw.uniform(1.0, 3.5, k.size).astype(dtype)
    structure[::10] = 1.0
    index = draw.uniform(1.28, 1.52, k.size)
    surface = [interface_transmissivity(angle, index) for angle in (40.0, 90.0)]
    inputs = [np.asarray(x, dtype) for x in (structure, *surface, index)]
    value, by_k, by_structure = jax.jit(pile_and_slopes)(k, *inputs)

    exact = [jnp.asarray(x, float) for x in (k, *inputs)]  # the reference, of the same numbers
    of_layer = lambda a, n: _stack(a, n, *exact[2:])[0]  # noqa: E731
    absorbed = layer_absorptance(exact[0])
    ones, zeros = jnp.ones_like(absorbed), jnp.zeros_like(absorbed)
    expected, by_absorbed = jax.jvp(of_layer, (absorbed, exact[1]), (ones, zeros))
    _, expected_structure = jax.jvp(of_layer, (absorbed, exact[1]), (zeros, ones))
    wide = k.astype(float)
    slope = 2 * np.exp(-wide) - 2 * np.where(wide > 0, wide * exp1(np.maximum(wide, 1e-300)), 0.0)
    for got, wanted, factor in (
        (value, expected, 1.0),
        (by_k, by_absorbed, slope),
        (by_structure, expected_structure, 1.0),
    ):
        for part, known in zip(got, wanted):
            assert part.dtype == dtype
            np.testing.assert_allclose(part, factor * known, rtol=tolerance, atol=tolerance)


def test_second_derivatives_are_differences_of_the_first():
    leaf = LeafParameters(
        structure=1.8, chlorophyll=30.0, carotenoids=7.0, anthocyanins=2.0, brown_pigments=0.2,
        water=0.012, dry_matter=0.008,
    )  # fmt: skip
    flat = jnp.stack([jnp.asarray(x, float) for x in jax.tree.leaves(leaf)])
    gradient = jax.jit(jax.grad(lambda x: (spectra_of(x) ** 2).sum()))
    curved = jax.jit(jax.hessian(lambda x: (spectra_of(x) ** 2).sum()))(flat)
    np.testing.assert_allclose(curved, curved.T, rtol=1e-8, atol=1e-8)
    for i, scale in enumerate(np.maximum(np.abs(flat), 1e-3)):
        step = jnp.zeros_like(flat).at[i].set(1e-5 * scale)
        difference = (gradient(flat + step) - gradient(flat - step)) / (2 * step[i])
        np.testing.assert_allclose(curved[i], difference, rtol=1e-5, atol=1e-6)


EDGES = {
    "N = 1": {"structure": 1.0},
    "no absorber": CLEAR,
    "no absorber, N = 1": CLEAR | {"structure": 1.0},
    "pigments only": {"water": 0.0, "dry_matter": 0.0, "proteins": 0.0, "carbon_constituents": 0.0},
    "tiny absorber": CLEAR | {"water": 1e-9, "chlorophyll": 1e-6},
    "opaque": {"structure": 3.5, "brown_pigments": 4.0, "water": 0.2, "dry_matter": 0.08},
    "very opaque": {"structure": 3.5, "brown_pigments": 90.0, "water": 1.0, "dry_matter": 0.9},
    "very opaque, N = 1": {"structure": 1.0, "brown_pigments": 90.0, "water": 1.0},
    "N = 0.5": {"structure": 0.5},
}  # fmt: skip


def spectra_of(vector):
    return both(jax.tree.unflatten(jax.tree.structure(LeafParameters()), list(vector)))


DERIVATIVES = [
    jax.jit(jax.jacfwd(spectra_of)),
    # The reverse gradient, and the Hessian times ones: an entry that is not finite spoils its row.
    jax.jit(lambda v: jax.jvp(jax.grad(lambda v: spectra_of(v).sum()), (v,), (jnp.ones_like(v),))),
]


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("name", EDGES)
def test_edges_are_finite_to_second_order(name, dtype):
    edge = EDGES[name]  # some beyond the bounds, which the record itself would refuse
    leaf = eqx.tree_at(
        lambda p: [getattr(p, key) for key in edge], LeafParameters(), list(edge.values())
    )
    leaf = jax.tree.map(lambda x: jnp.asarray(x, dtype), leaf)
    flat = jnp.stack(jax.tree.leaves(leaf))

    values = both(leaf)
    assert np.isfinite(values).all()
    assert values.min() >= 0
    if EDGES[name].get("structure", 1.5) >= 1.0:
        assert (values.sum(0) <= 1 + 5e-7).all()
    for derivative in DERIVATIVES:
        assert all(np.isfinite(part).all() for part in jax.tree.leaves(derivative(flat)))


def test_gradient_without_absorber_equals_the_one_sided_difference():
    clear = jax.tree.map(lambda x: jnp.asarray(x, float), LeafParameters(**CLEAR))
    h = 1e-9
    for name, scale in (("water", 1.0), ("dry_matter", 1.0), ("chlorophyll", 1.0)):
        move = lambda x, name=name: eqx.tree_at(lambda p: getattr(p, name), clear, x)  # noqa: E731
        slope = jax.jacfwd(lambda x, move=move: both(move(x)))(jnp.asarray(0.0))
        difference = (both(move(jnp.asarray(h * scale))) - both(clear)) / (h * scale)
        np.testing.assert_allclose(
            slope, difference, rtol=2e-4, atol=1e-5 * np.abs(difference).max()
        )


def test_any_grid_inside_the_tables():
    leaf = LeafParameters()
    full, coarse = prospect(leaf), prospect(leaf, np.array([2400.0, 550.5, 700.0]))
    assert abs(coarse.reflectance[2] - full.reflectance[300]) < 1e-14
    low, high = full.reflectance[150], full.reflectance[151]
    assert min(low, high) <= coarse.reflectance[1] <= max(low, high)
    assert np.array_equal(coarse.wavelength, [2400.0, 550.5, 700.0])


@pytest.mark.parametrize(
    ("wavelength", "message"),
    [([350.0, 500.0], "400 to 2500"), ([0.4, 2.5], "µm"), ([np.nan, 500.0], "400 to 2500")],
)
def test_grids_outside_are_refused(wavelength, message):
    with pytest.raises(ValueError, match=message):
        prospect(LeafParameters(), np.array(wavelength))


def test_bad_arguments_are_named():
    with pytest.raises(ValueError, match="mg/cm2"):
        LeafParameters(water=10.0)
    with pytest.raises(ValueError, match=r"dry_matter.*g/m2"):
        LeafParameters(dry_matter=90.0)
    with pytest.raises(ValueError, match="chlorophyll"):
        LeafParameters(chlorophyll=-1.0)
    with pytest.raises(ValueError, match="structure"):
        LeafParameters(structure=float("nan"))
    with pytest.raises(ValueError, match="many"):
        LeafParameters(chlorophyll=jnp.ones(3))
    with pytest.raises(ValueError, match="version"):
        prospect(LeafParameters(), version="4")
    with pytest.raises(ValueError, match="incidence"):
        prospect(LeafParameters(), incidence_half_angle=0.0)
    with pytest.raises(TypeError, match="Cab"):
        LeafParameters.many(Cab=3.0)


def test_many_leaves_are_the_loop_over_one():
    leaves = LeafParameters.many(chlorophyll=[10.0, 50.0], water=0.02)
    stacked = jax.vmap(lambda p: both(p))(leaves)
    for i, chlorophyll in enumerate((10.0, 50.0)):
        one = both(LeafParameters(chlorophyll=chlorophyll, water=0.02))
        np.testing.assert_allclose(stacked[i], one, rtol=0, atol=1e-14)


@pytest.mark.parametrize("wrong", ["40", None, {}, object(), [1, "b"], [None], [1, [2]]])
def test_a_trait_that_is_no_number_is_named(wrong):
    with pytest.raises(InputError, match=r"Chlorophyll .*as a number.*missing") as caught:
        fx.LeafParameters(chlorophyll=wrong)
    assert "\n" not in str(caught.value)
    with pytest.raises(InputError, match="number"):
        fx.prospect(chlorophyll=wrong)


def test_no_leaf_and_no_leaf_parameters_are_refused():
    for empty in ([], np.zeros((3, 0))):
        with pytest.raises(InputError, match="one leaf or more, but got the shape"):
            fx.prospect(chlorophyll=empty)
    for wrong in ({"chlorophyll": 40.0}, 40.0, "leaf"):
        with pytest.raises(InputError, match=r"traits by name.*but got (dict|float|str)"):
            fx.prospect(wrong)
