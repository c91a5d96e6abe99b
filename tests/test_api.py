"""`import fynjax as fx`: quick, and every name is there."""

import inspect
import re
import subprocess
import sys

import numpy as np
import pytest

import fynjax as fx


def test_the_import_is_light():
    """Neither JAX nor anything else that is heavy, until a name is used."""
    code = (
        "import sys, fynjax as fx; before = set(sys.modules); fx.LeafParameters;"
        "print(sorted({'jax', 'numpy', 'pandas', 'equinox'} & before), 'jax' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split("\n")[0] == "[] True"


def test_leaves_and_light_do_without_what_reads_and_draws():
    code = (
        "import sys\n"
        "for name in ('rasterio', 'rioxarray', 'matplotlib', 'xarray', 'netCDF4',"
        " 'trimesh', 'pyproj', 'PIL', 'dask'):\n"
        "    sys.modules[name] = None  # as if it were not installed\n"
        "import fynjax as fx, fynjax.leaf, fynjax.radiation, fynjax.canopy, fynjax.sensors\n"
        "fx.fit_leaf, fx.leaf.LeafFit\n"
        "leaf = fx.prospect(fx.Leaf(), [550.0, 860.0])\n"
        "canopy = fx.canopy_reflectance(*leaf, layers=2)\n"
        "print(float(canopy.max()) > 0.3)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.stdout == "True\n", done.stderr


def test_a_command_starts_without_what_it_may_need_later(tmp_path):
    """Of `fit-leaf`, until its inputs are checked: half of what it imported was for later."""
    leaf = tmp_path / "leaf.csv"
    leaf.write_text("wavelength,leaf\n" + "".join(f"{w},0.3\n" for w in range(400, 2401, 10)))
    code = (
        "import sys\nfrom fynjax.app.cli import main\n"
        f"try: main(['fit-leaf', {str(leaf)!r}, '--dry-run'])\n"
        "except SystemExit as end: print(end.code)\n"
        "late = {'matplotlib', 'PIL', 'rasterio', 'pyproj', 'emcee', 'scipy.stats', 'scipy.signal',"
        " 'jaxopt', 'trimesh', 'fynjax.scene', 'fynjax.inversion'}\n"
        "print(sorted(late & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.stdout.splitlines()[-2:] == ["0", "[]"], done.stderr


def test_every_name_is_there_and_described():
    assert {
        *("read_scene", "fit", "sample", "Leaf", "LeafParameters", "prospect"),
        *("fit_leaf", "sensor", "errors", "cite", "canopy_reflectance"),
        *("canopy_albedo", "fit_canopy"),
    } <= set(fx.__all__)
    for name in fx.__all__:
        assert inspect.getdoc(getattr(fx, name)), name
    assert fx.Leaf is fx.LeafParameters
    # Commands, which write folders, are in `fx.jobs`.
    assert not {"calibrate", "posterior"} & set(fx.__all__)
    with pytest.raises(AttributeError):
        _ = fx.nothing


def test_one_family_of_errors():
    for wrong in (
        lambda: fx.sensor("aviris"),
        lambda: fx.cite("prosail"),
        lambda: fx.prospect(fx.LeafParameters(), version="4"),
        lambda: fx.LeafParameters(chlorophyll=-1.0),
        lambda: fx.fit_leaf([500.0, 400.0], [[0.1, 0.1]]),
        lambda: fx.canopy_reflectance(0.1, 0.1, -1.0),
    ):
        with pytest.raises(fx.errors.InputError):
            wrong()
    assert issubclass(fx.errors.InputError, ValueError)


def test_the_largest_seed_plants_a_scene():
    """Each species has seeds made of it, which are larger."""
    pool = fx.canopy.table1_2006()[:2]
    largest = np.int32(2**31 - 1)
    scene = fx.Scene.from_table(pool, size=1.0, voxel=0.5, structure="even", seed=largest)
    assert int(scene.seed) == 2**31 - 1


@pytest.mark.parametrize("seed", [-1, pytest.param(1.5, marks=pytest.mark.untyped)])
def test_a_seed_is_a_whole_number(seed, tmp_path):
    """Wherever one is stated: of draws, plants, scenes, metrics, searches and commands."""
    spectra, names = np.random.default_rng(0).random((12, 3)), ["a", "b"] * 6
    pool = fx.canopy.table1_2006()[:2]
    for stated in (
        lambda: fx.Scene.from_table(pool, size=1.0, voxel=0.5, structure="even", seed=seed),
        lambda: fx.canopy.plant_model("rounded_shrub", 50, seed=seed),
        lambda: fx.canopy.mesh.generate_plant("rounded_shrub", seed),
        lambda: fx.canopy.poisson_disk((1.0, 1.0), 0.2, seed=seed),
        lambda: fx.diversity.mantel(np.eye(6), np.eye(6), seed=seed),
        lambda: fx.diversity.spectral_species(spectra.reshape(2, 6, 3), clusters=2, seed=seed),
        lambda: fx.diversity.spectral_variety(spectra, seed=seed),
        lambda: fx.diversity.classify(
            spectra, names, [0] * 6 + [1] * 6, method="forest", seed=seed
        ),
        lambda: fx.prior().draws(3, seed=seed),
        lambda: fx.emulate(lambda x: x, [0.0], [1.0], seed=seed),
        lambda: fx.inversion.CalibrationSettings(seed=seed),
        lambda: fx.jobs.plant("Metalasia muricata", tmp_path, seed=seed),
    ):
        with pytest.raises(fx.errors.InputError, match="`seed` as a whole number"):
            stated()


def test_a_sensor_is_any_sensor():
    assert type(fx.sensor("mavic_3m")) is fx.sensors.Sensor
    assert type(fx.sensor("flash_lidar_paper")) is fx.sensors.Lidar
    with pytest.raises(fx.errors.InputError, match="flash_lidar_paper"):
        fx.sensor("flash_lidar")


def test_citations_are_entries_of_bibtex_each_once():
    every = fx.cite()
    keys = [line for line in every.splitlines() if line.startswith("@")]
    assert len(keys) == len(set(keys)) >= 10
    assert every.count("{") == every.count("}")
    pages = re.findall(r"pages = \{(.*)\}", every)
    assert all(re.fullmatch(r"\d+(--\d+)?", numbers) for numbers in pages)
    assert len(re.findall(r"doi = \{10\.\d{4}/\S+\}", every)) == every.count("doi = ") >= 8
    assert fx.cite("prospect-d") in fx.cite("PROSPECT-D", "prospect-d")
    for year in ("1990", "2008", "2017", "2021"):
        assert f"year = {{{year}}}" in fx.cite("prospect")
