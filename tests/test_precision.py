"""In a process of 32 bits fynjax finds what it finds in one of 64, and leaves both as they are."""

import os
import pickle
import pkgutil
import subprocess
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
import pytest

import fynjax as fx
from fynjax._core.parts import Pool
from fynjax.canopy import leaf_angle, table1_2006
from fynjax.errors import InputError
from fynjax.inversion import (
    AbstractView,
    CalibrationSettings,
    Data,
    LogPosterior,
    PosteriorSampler,
    Source,
    derivative_measures,
)
from fynjax.scene import hard_counts

COLUMNS = "taxon", "growth_form", "mean_diameter_cm", "cover_percent", "height_max_m"
TABLE = [dict(zip(COLUMNS, ("Erica", "rounded_shrub", 40, 30, 0.6), strict=True))]
BANDS = np.arange(400.0, 2401.0, 100.0)
AT = np.array([0.0, 1.0, 2.0])
INDEX = np.array([1])


class Lines:
    """What lines of a user give, and that each leaves the process as it was."""

    def __init__(self) -> None:
        self.bits = jax.config.jax_enable_x64
        self.found: dict[str, Any] = {}

    def __call__(self, name: str, call: Callable[[], Any], *arrays: str) -> Any:
        """Keep the arrays of that name of what `call` gives; without names all of it."""
        value = call()
        assert jax.config.jax_enable_x64 == self.bits, f"{name} changed the bits of the process"
        kept = {key: getattr(value, key) for key in arrays} if arrays else value
        self.found[name] = jax.tree.map(np.asarray, kept)
        return value


def in_32_bits(folder: Path, *names: str) -> dict[str, dict[str, Any]]:
    """What the functions of these names find in a process of 32 bits, one after the other; a
    warning is an error there."""
    code = (
        "import pickle, warnings; warnings.simplefilter('error', UserWarning)\n"
        "from tests import test_precision as own; found = {}\n"
        f"for name in {names}:\n"
        "    lines = own.Lines(); getattr(own, name)(lines); assert not lines.bits\n"
        "    found[name] = lines.found\n"
        "open('found.pickle', 'wb').write(pickle.dumps(found))"
    )
    root = str(Path(__file__).resolve().parents[1])
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=folder, capture_output=True, text=True, check=False,
        env=os.environ | {"JAX_ENABLE_X64": "0", "PYTHONPATH": root},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    found: dict[str, dict[str, Any]] = pickle.loads((folder / "found.pickle").read_bytes())
    return found


@pytest.fixture(scope="module")
def narrow_of(tmp_path_factory: pytest.TempPathFactory) -> dict[str, dict[str, Any]]:
    """What `imports`, `light` and `fits` find in one process of 32 bits: to start it costs most."""
    return in_32_bits(tmp_path_factory.mktemp("narrow"), "imports", "light", "fits")


def in_64_bits(lines: Callable[[Lines], None]) -> dict[str, Any]:
    """What `lines` find here, in 64 bits."""
    here = Lines()
    assert here.bits
    lines(here)
    return here.found


def same(name: str, both: Sequence[dict[str, Any]], rtol: float, atol: float) -> None:
    """Compare what a line found, array by array."""
    for narrow, wide in zip(*(jax.tree.leaves(found[name]) for found in both), strict=True):
        np.testing.assert_allclose(narrow, wide, rtol, atol, err_msg=name)


def scene() -> fx.Scene:
    return fx.Scene.from_table(TABLE, size=1.0, voxel=0.25, structure="even", seed=1)


def imports(_: Lines) -> None:
    for module in pkgutil.walk_packages(fx.__path__, "fynjax."):
        if module.ispkg and "._" not in module.name:
            __import__(module.name)


def light(lines: Lines) -> None:
    plot, camera = lines("planting", scene, "planting", "parameters"), fx.sensor("mavic_3m")

    def ndvi(p: Any) -> jax.Array:
        return fx.observe(plot, camera, pixel=0.25, parameters=p).index("NDVI").mean()

    every = lines("stand", lambda: fx.Scene.from_table(
        table1_2006(), size=3.0, voxel=0.5, structure="even"), "planting")  # fmt: skip
    lines("counts", lambda: hard_counts(every, every.parameters).astype(np.int32))
    lines("observe", lambda: fx.observe(plot, camera, pixel=0.25), "reflectance")
    lines("grad", lambda: jax.jit(jax.grad(ndvi))(plot.parameters).species.cover)
    thin = lines("thin", lambda: plot.with_values({"species.*.cover": 0.1}), "parameters")
    lines("realisation", lambda: plot.realisation(1), "planting")
    lines("observe thin", lambda: fx.observe(thin, camera, pixel=0.25), "reflectance")
    lines("prospect", lambda: tuple(fx.prospect(chlorophyll=40.0, wavelength=BANDS)))
    vector = jnp.array([20.0, 40.0])
    many = jax.vmap(lambda c: fx.prospect(chlorophyll=c, wavelength=BANDS).reflectance)
    lines("vmap", lambda: many(vector))


def straight(x: jax.Array) -> jax.Array:
    return x[0] + x[1] * AT


class Curve(eqx.Module):
    """A model that computes in the precision of its arrays."""

    def __call__(self, x: jax.Array) -> jax.Array:
        return jnp.exp(0.1 * x[0] + x[1] * jnp.array([0.0, 0.1, 0.2]))


class Crowns(AbstractView):
    """A number of a plot that needs no light."""

    names: tuple[str, ...] = eqx.field(static=True, default=("a",))

    def observe(self, scene: fx.Scene, parameters: Any) -> tuple[None, jax.Array]:
        return None, parameters.species.cover * parameters.species.height

    def for_search(self, scene: fx.Scene, accuracy: Any, stride: int) -> "Crowns":
        return self


def data(value: Any) -> fx.Data:
    return fx.Data(("a", "b", "c"), value, np.full(3, 0.1))


def fits(lines: Lines) -> None:
    grid = np.arange(400.0, 2501.0)
    spectrum = 0.05 + 0.4 * np.exp(-(((grid - 900.0) / 400.0) ** 2))
    traits = "structure", "chlorophyll", "water", "dry_matter"
    leaf = lines("leaf", lambda: fx.fit_leaf(grid, spectrum[None]), "standard_deviation", "fitted")
    lines("traits", lambda: leaf.parameters, *traits)
    lines("prospect of the leaf", lambda: fx.prospect(leaf.parameters, BANDS).reflectance)
    bounds = (np.full(2, value) for value in (-100.0, 100.0, 0.1, 10.0))
    space = lines("space", lambda: fx.ParameterSpace(("offset", "slope"), *bounds), "width")
    u = jnp.array([0.1, 0.2])
    measured = data(1.0 + 1.1 * AT)
    density = LogPosterior(straight, space, measured, jnp.zeros(3))
    compiled = [jax.jit(f) for f in (straight, lambda u: space.physical(u), lambda u: density(u))]
    lines("compiled before", lambda: [function(u) for function in compiled])
    found = lines("fit", lambda: fx.fit(straight, measured, space), "estimate", "sd")
    of_space = lambda x: jnp.concatenate([space.whitened(x), x[INDEX]])  # noqa: E731
    lines("fit of the space", lambda: fx.fit(of_space, data(1.0 + 1.1 * AT), space), "estimate")
    lines("compiled after", lambda: [jax.jit(of_space)(u), jax.jit(straight)(u), u[INDEX]])
    lines("table", lambda: dict(found.table().select_dtypes(float)))
    lines("sample", lambda: fx.sample(found, "laplace", predict=straight, target=50.0), "values")
    states = PosteriorSampler(straight, measured, space, start=found).states()
    lines("states", lambda: next(states), "ahead")  # suspended, the process is the caller's
    measures = lambda: derivative_measures(Curve(), space, "abc", samples=16, do=Pool().all)  # noqa: E731
    lines("measures", measures, "measure", "variance")
    lines("emulate", lambda: fx.emulate(lambda x: x**3, [0.1], [2.0]), "coefficients", "error")
    exact = jnp.array([1.0, 2.0, 3.5])  # also in float32
    traced = lambda value: fx.fit(straight, data(value), space).estimate  # noqa: E731
    lines("jit", lambda: jax.jit(traced)(exact))
    lines("jit of vmap", lambda: jax.jit(jax.vmap(traced))(jnp.stack([exact, 2.0 * exact])))
    residual = fx.whitened_residual(straight, data(1.0 + 1.1 * AT), space)
    solver = optx.Dogleg(1e-5, 1e-5)
    lines(
        "own loop", lambda: space.physical(optx.least_squares(residual, solver, jnp.zeros(2)).value)
    )
    plot, settings = scene(), CalibrationSettings(stand_realisations=2, scatter_draws=6)
    crowns = Data(
        ("a",), np.array([0.25]), np.array([0.02]),
        source=Source("structure", lambda *_: Crowns()),
    )  # fmt: skip
    covers = fx.free(plot, "species.*.cover")
    found = lines("plot", lambda: fx.fit(plot, crowns, covers, settings=settings), "coordinates")
    lines("plantings of the plot", lambda: found.plantings, "spread")
    lines("fit of the plot", lambda: found.fit, "estimate", "sd")
    lines("drawn", lambda: fx.sample(found, "laplace", target=50.0), "values")
    rows = [f"{w:g},{r:.5f}" for w, r in zip(grid, spectrum, strict=True)]
    Path("leaf.csv").write_text("\n".join(["wavelength,leaf", *rows]), "utf-8")
    lines("job", lambda: fx.jobs.fit_leaves(["leaf.csv"], "fitted"), "seed")
    lines.found["traits.csv"] = Path("fitted/traits.csv").read_text("utf-8")


def plots(lines: Lines) -> None:
    few = {"rounds": 1, "stand_realisations": 2, "scatter_draws": 6, "full_renders": 1}
    plot, settings = scene(), CalibrationSettings(**few, max_steps=3)
    measured = fx.Data.from_table({"red.mean": 0.11, "nir.mean": 0.31, "nir.std": 0.1})
    free = lines("free", lambda: fx.free(plot, "species.*.cover"), "prior")
    found = lines("plot", lambda: fx.fit(plot, measured, free, settings=settings), "coordinates")
    lines("plantings", lambda: found.plantings, "spread")
    lines("fit", lambda: found.fit, "estimate", "sd")
    lines("stand", lambda: dict(found.stand().select_dtypes(float)))
    lines("seen", lambda: fx.observe(
        found.scene, "mavic_3m", pixel=0.25, parameters=found.after), "reflectance")  # fmt: skip
    lines("drawn", lambda: fx.sample(found, "laplace", target=50.0), "values")
    leaf = fx.prospect(chlorophyll=40.0, wavelength=BANDS)
    seen = lines("forward canopy", lambda: fx.canopy_reflectance(*leaf, 2.0))
    seen = np.asarray(seen, float).round(4)
    lines("canopy", lambda: fx.fit_canopy(BANDS, seen, sun_zenith=30.0), "estimate", "interval")


def test_no_import_sets_the_bits_of_the_process(narrow_of):
    assert narrow_of["imports"] == {}  # nothing is computed, nor did the process end


def test_light_is_computed_in_32_bits(narrow_of):
    narrow, wide = both = narrow_of["light"], in_64_bits(light)
    same("planting", [{"planting": found["planting"]["planting"]} for found in both], 0.0, 0.0)
    same("stand", both, rtol=0.0, atol=0.0)
    same("counts", both, rtol=0.0, atol=0.0)
    for name, arrays in narrow.items():
        assert not any(np.asarray(a).dtype.itemsize > 4 for a in jax.tree.leaves(arrays)), name
        same(name, both, rtol=1e-4 if name == "grad" else 2e-5, atol=1e-6)
    assert wide["prospect"][0].dtype == np.float64


def test_fits_are_computed_in_64_bits(narrow_of, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    narrow, wide = both = narrow_of["fits"], in_64_bits(fits)
    for name in narrow.keys() - {"traits.csv"}:
        whole = name in ("leaf", "traits", "space", "job", "measures")
        same(name, both, rtol=1e-9 if whole else 2e-5, atol=1e-12 if whole else 1e-6)
    assert narrow["traits"]["chlorophyll"].dtype == narrow["fit"]["estimate"].dtype == np.float64
    assert narrow["fit of the plot"]["estimate"].dtype == np.float64
    assert narrow["traits.csv"] == wide["traits.csv"]


@pytest.mark.study
def test_a_plot_and_a_canopy_are_fitted_in_32_bits(tmp_path):
    both = in_32_bits(tmp_path, "plots")["plots"], in_64_bits(plots)
    for name in both[0]:
        same(name, both, rtol=1e-3, atol=1e-4)


def test_constants_keep_their_digits_where_both_precisions_are_compiled():
    """JAX keeps what it made of a NumPy array in 32 bits while a compiled function holds it."""
    for name in ("planophile", "uniform"):
        angle = leaf_angle(name)
        kept = jax.jit(lambda mu, angle=angle: (angle.projection(mu), *angle.normals()))
        with jax.enable_x64(False):
            assert kept(jnp.asarray(0.3))[0].dtype == jnp.float32
        anew = jax.jit(lambda mu, angle=angle: (angle.projection(mu), *angle.normals()))
        projection, normals, weights = anew(jnp.asarray(0.3))
        assert projection.dtype == jnp.float64
        np.testing.assert_allclose(jnp.linalg.norm(normals, axis=1), 1.0, rtol=1e-14)
        assert float(weights.sum()) == pytest.approx(1.0, rel=1e-14)


def test_a_scene_in_float64_is_refused_in_32_bits():
    with jax.enable_x64(False), pytest.raises(InputError, match="float64 needs JAX in 64 bits"):
        fx.Scene.from_table(TABLE, size=1.0, voxel=0.5, dtype="float64")


def test_a_fit_compiled_by_its_user_says_where_it_needs_64_bits():
    bounds = (np.full(2, value) for value in (-100.0, 100.0, 0.1, 10.0))
    space = fx.ParameterSpace(("offset", "slope"), *bounds)
    found = jax.jit(
        lambda value: fx.fit(straight, data(value), space, solver=optx.Dogleg(1e-6, 1e-6)).estimate
    )
    value = np.array([1.0, 2.0, 3.0])
    with jax.enable_x64(False), pytest.raises(InputError, match="a fit by Dogleg inside"):
        found(value)
    assert found(value).tolist() == pytest.approx([1.0, 1.0], abs=1e-3)
