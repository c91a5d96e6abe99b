"""Leaf optics of a plot's taxa from a folder of measured spectra, in one key."""

import json
import warnings
from contextlib import nullcontext
from pathlib import Path

import numpy as np
import pytest

import fynjax as fx
from fynjax._core.dry_run import dry_run
from fynjax._core.errors import InputError
from fynjax._core.store import Store
from fynjax.app.assembly import _leaf_spectra, build_plot, plot_parameters
from fynjax.app.assembly._forward import plot_problem
from fynjax.app.io.plot import plant_sources, read_plot
from tests.small import write_plot

SPECIES = """taxon,mean_diameter_cm,cover_percent,height_max_m,growth_form
Erica,40,30,0.6,rounded_shrub
Erica tetralix,30,15,0.5,upright_ericoid
Calluna vulgaris,30,15,0.5,upright_ericoid
"""
WATER = {
    "spectra/Erica_01.csv": 0.010,
    "spectra/ERICA.TETRALIX-003.csv": 0.014,
    "spectra/erica tetralix 4.csv": 0.022,
    "spectra/.thumbs/Erica.csv": 0.030,
}
WAVE = np.arange(400.0, 2401.0, 5.0)


def write_leaves(folder: Path, key: str = 'leaf_spectra = "spectra"\n') -> Path:
    folder.mkdir(exist_ok=True)
    path = write_plot(folder, 'plants = "generic"\n' + key)
    (folder / "species.csv").write_text(SPECIES)
    for name, water in WATER.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        write_leaf(folder / name, water)
    return path


def write_leaf(path: Path, water: float) -> None:
    r, _ = fx.prospect(water=[water], dry_matter=[0.008], chlorophyll=[40.0])
    values = np.interp(WAVE, np.arange(400.0, 2501.0), np.asarray(r)[0])
    rows = "".join(f"{w:g},{v:.6f}\n" for w, v in zip(WAVE, values))
    path.write_text("wavelength,reflectance\n" + rows, encoding="utf-8")


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return tmp_path / "cache" / "fynjax" / "leaves"


def test_each_taxon_has_the_mean_of_its_leaves_fitted_once(
    tmp_path: Path, cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    plot = read_plot(write_leaves(tmp_path))
    leaf = plot_parameters(plot).leaf
    np.testing.assert_allclose(leaf.water, [0.010, 0.018, 0.0109], rtol=0.1)
    np.testing.assert_allclose(leaf.chlorophyll, [40.0, 40.0, 38.6], rtol=0.1)
    assert plant_sources(plot).count("eaf traits (2 of 3 species): spectra.") == 1
    assert len(list(cache.iterdir())) == 1
    assert {path.name for path in plot.inputs} >= {"Erica_01.csv", "species.csv"}

    def refit(spectra: object, **_: object) -> None:
        raise RuntimeError("fitted again")

    monkeypatch.setattr(_leaf_spectra, "fit_leaf", refit)
    np.testing.assert_array_equal(plot_parameters(plot).leaf.water, leaf.water)
    write_leaf(tmp_path / "spectra" / "Erica_01.csv", 0.012)
    with pytest.raises(RuntimeError, match="fitted again"):
        plot_parameters(plot)
    next(cache.iterdir()).write_text("damaged")
    write_leaf(tmp_path / "spectra" / "Erica_01.csv", 0.010)
    with pytest.raises(RuntimeError, match="fitted again"):
        plot_parameters(plot)


def test_doubts_of_kept_fits_are_said_every_time(tmp_path: Path, cache: Path) -> None:
    """A refused file, and one that is no leaf, which counts where its taxon has no other."""
    path = write_leaves(tmp_path)
    line = "".join(f"{w:g},{0.1 + 1e-4 * (w - 400):.6f}\n" for w in WAVE)
    rows = "wavelength,reflectance\n"
    for name in ("ERICA.TETRALIX-005.csv", "calluna vulgaris.csv"):
        (tmp_path / "spectra" / name).write_text(rows + line)
    (tmp_path / "spectra" / "Erica_02.csv").write_text(rows + "500,700.5\n600,800\n700,50000\n")
    said = []
    for _ in range(2):
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always", UserWarning)
            leaf = plot_parameters(read_plot(path)).leaf
        said.append([str(warning.message) for warning in caught])
        np.testing.assert_allclose(leaf.water[1], 0.018, rtol=0.1)
    assert len(list(cache.iterdir())) == 1
    assert said[0] == said[1]
    text = " ".join(said[0])
    assert "Erica_02.csv" in text
    assert "1 of 3 leaf spectra of Erica tetralix are fitted in doubt, such as " in text
    assert "they are left out of the mean of the other 2" in text
    assert "Calluna vulgaris" in text
    assert "they are used, since there are no others" in text
    (tmp_path / "spectra" / "Erica_01.csv").write_text(rows + line)
    (tmp_path / "leaves.csv").write_text("taxon,spectrum\n*,spectra/Erica_01.csv\n")
    path.write_text(
        path.read_text().replace('leaf_spectra = "spectra"', 'leaf_table = "leaves.csv"')
    )
    for _ in range(2):
        with pytest.warns(UserWarning, match=r"leaf spectra of Erica_01\.csv are fitted in doubt"):
            plot_parameters(read_plot(path))


def test_the_prior_of_measured_leaves_is_that_of_their_fits(tmp_path: Path) -> None:
    """By errors, number and spread of the leaves; what the plot file states goes before."""
    water = "species.{}.leaf.water".format
    path = write_leaves(tmp_path)
    for i in range(12):
        write_leaf(tmp_path / "spectra" / f"Erica_{i}.csv", 0.010)
    (tmp_path / "leaves.csv").write_text("taxon,spectrum\nCalluna vulgaris,spectra/Erica_1.csv\n")
    text = path.read_text().replace("[plot]", '[plot]\nleaf_table = "leaves.csv"', 1)
    path.write_text(text)

    def widths(free: str) -> dict[str, float]:
        space = plot_problem(read_plot(path), None, [free], seed=0).free
        return dict(zip(space.names, (space.prior_sd / space.prior).tolist(), strict=True))

    found = widths("species.*.leaf.water")
    many, two, one = (found[water(t)] for t in ("Erica", "Erica tetralix", "Calluna vulgaris"))
    assert 0.02 < many < 0.15 < two < 0.35
    assert many < one
    assert abs(one - 0.3) > 0.005
    # 13 leaves of which one differs not at all: less than of two that differ by 45 %.
    scene, _ = build_plot(read_plot(path))
    assert dict(scene.spreads)[water("Erica")] == pytest.approx(many, rel=1e-6)
    assert fx.free(scene, water("Erica")).prior_sd[0] == pytest.approx(many * 0.01, rel=0.2)
    path.write_text(text + '\n[calibration.priors]\n"*.leaf.water" = 0.4\n')
    assert widths("species.*.leaf.water")[water("Erica")] == pytest.approx(0.4, rel=1e-6)


@pytest.mark.parametrize("key", ['leaf_spectra = "spectra"', 'leaf_table = "leaves.csv"'])
def test_a_dry_run_checks_spectra_of_leaves_and_fits_none(
    tmp_path: Path, cache: Path, monkeypatch: pytest.MonkeyPatch, key: str
) -> None:
    path = write_leaves(tmp_path, f"{key}\n")
    (tmp_path / "leaves.csv").write_text("taxon,spectrum\n*,spectra/Erica_01.csv\n")
    with monkeypatch.context() as patched, dry_run():
        patched.setattr(_leaf_spectra, "fit_leaf", None)
        assert len(plot_parameters(read_plot(path)).leaf.water) > 0
    assert not cache.exists()
    (tmp_path / "spectra" / "Erica_01.csv").write_text("wavelength,reflectance\n500,thick\n")
    said = []
    for block in (dry_run(), nullcontext()):
        with pytest.raises((InputError, UserWarning), match=r"Erica_01.*thick") as caught, block:
            plot_parameters(read_plot(path))
        said.append(str(caught.value))
    assert said[0] == said[1]


@pytest.mark.parametrize(
    ("keys", "background"),
    [('leaf_measurement = "probe"\n', 0.0),
     ('leaf_measurement = "leaf-clip"\nleaf_background = 0.9\n', 0.9)],
)  # fmt: skip
def test_spectra_of_a_clip_are_fitted_as_of_a_clip(
    tmp_path: Path, cache: Path, keys: str, background: float
) -> None:
    """Shine of 0.05 over black, or light that a white face sends back through the leaf."""
    wave = np.arange(400.0, 2501.0)
    r, t = (
        np.asarray(x)[0] for x in fx.prospect(water=[0.012], dry_matter=[0.008], chlorophyll=[40.0])
    )
    seen = r + t**2 * background / (1.0 - r * background) + (0.05 if not background else 0.0)
    plain = write_leaves(tmp_path, 'leaf_spectra = "spectra"\n')
    rows = "".join(f"{w:g},{v:.6f}\n" for w, v in zip(wave, seen))
    for name in WATER:
        (tmp_path / name).write_text("wavelength,reflectance\n" + rows)
    error = {}
    for what, more in (("sphere", ""), ("clip", keys)):
        leaf = plot_parameters(read_plot(with_keys(plain, more))).leaf
        true = np.array([0.012, 0.008, 40.0])
        found = np.array([leaf.water[0], leaf.dry_matter[0], leaf.chlorophyll[0]])
        error[what] = np.abs(found / true - 1.0)
    assert error["clip"].max() < 0.1
    assert error["clip"].max() != error["sphere"].max()  # over black shine alone differs
    assert error["sphere"].max() > 0.3 or not background
    assert len(list(cache.iterdir())) == 2
    with pytest.raises(InputError, match="expected leaf_background with leaf_measurement"):
        read_plot(with_keys(plain, "leaf_background = 0.9\n"))


def with_keys(path: Path, more: str) -> Path:
    """The plot file again, with other keys under [plot]."""
    text = path.read_text(encoding="utf-8").split('leaf_spectra = "spectra"\n')[0]
    path.write_text(text + 'leaf_spectra = "spectra"\n' + more, encoding="utf-8")
    return path


def test_names_say_the_taxon_by_whole_words(tmp_path: Path) -> None:
    path = write_leaves(tmp_path)
    (tmp_path / "spectra" / "callunella.csv").write_text("wavelength,a\n400,0.1\n")
    inside = tmp_path / "spectra" / "Calluna vulgaris, top"
    inside.mkdir()
    (inside / "leaf 2.csv").write_text("wavelength,a\n400,0.1\n")
    with pytest.warns(UserWarning, match=r"are left out \(1\), such as 'callunella.csv'"):
        files = read_plot(path).leaf_files
    assert {taxon: len(own) for taxon, own in files.items()} == {
        "Erica": 1, "Erica tetralix": 2, "Calluna vulgaris": 1,
    }  # fmt: skip


def test_a_link_out_of_the_folder_is_refused(tmp_path: Path) -> None:
    path = write_leaves(tmp_path / "plot")
    write_leaf(tmp_path / "secret.csv", 0.01)
    (tmp_path / "plot" / "spectra" / "Erica_9.csv").symlink_to(tmp_path / "secret.csv")
    with pytest.raises(InputError, match=r"Erica_9\.csv: .*--allow-outside"):
        read_plot(path)
    assert len(read_plot(path, allow_outside=True).leaf_files["Erica"]) == 2


def test_a_table_says_the_taxon_where_names_do_not(tmp_path: Path) -> None:
    path = write_leaves(tmp_path, 'leaf_spectra = "taxa.csv"\n')
    table = "file,taxon\nspectra/Erica_01.csv,Calluna vulgaris\n"
    (tmp_path / "taxa.csv").write_text(table)
    (own,) = read_plot(path).leaf_files["Calluna vulgaris"]
    assert own.name == "Erica_01.csv"
    (tmp_path / "taxa.csv").write_text(table.replace("Calluna vulgaris", "Calluna vulgare"))
    with pytest.raises(InputError, match=r"unknown taxon 'Calluna vulgare'.*Calluna vulgaris"):
        read_plot(path)
    (tmp_path / "taxa.csv").write_text(table + "spectra/lost.csv,Erica\n")
    with pytest.raises(InputError, match=r"row 3.*lost\.csv"):
        read_plot(path)


def test_folders_without_leaves_of_a_taxon_and_leaves_stated_twice_are_refused(
    tmp_path: Path,
) -> None:
    path = write_leaves(tmp_path, 'leaf_spectra = "spectra"\nleaf_table = "leaves.csv"\n')
    head = "taxon,chlorophyll,carotenoids,water,dry_matter\n"
    (tmp_path / "leaves.csv").write_text(head + "Calluna vulgaris,40,8,0.01,0.01\n")
    assert set(read_plot(path).leaf_files) == {"Erica", "Erica tetralix"}
    (tmp_path / "leaves.csv").write_text(head + "*,40,8,0.01,0.01\nErica,40,8,0.01,0.01\n")
    with pytest.raises(InputError, match=r"row 3.*leaf_spectra have leaves of 'Erica' too"):
        read_plot(path)
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "IMG_1.csv").write_text("wavelength,a\n400,0.1\n")
    path.write_text(path.read_text().replace('"spectra"', '"other"'))
    with pytest.raises(InputError, match=r"begin with a taxon, such as 'Erica'.*'IMG_1.csv'"):
        read_plot(path)
    path.write_text(path.read_text().replace('"other"', '"nowhere"'))
    with pytest.raises(InputError, match=r"'nowhere': .*leaf spectra"):
        read_plot(path)


def test_kept_fits_that_no_leaf_can_have_are_made_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whole entries of another code, or with numbers out of bounds, as a fault would leave them."""
    plot = read_plot(write_leaves(tmp_path))
    leaf = plot_parameters(plot).leaf
    kept, keys, get = _leaf_spectra._KEPT, [], Store.get
    monkeypatch.setattr(Store, "get", lambda self, key: keys.append(key) or get(self, key))

    def refit(*_: object, **__: object) -> None:
        raise RuntimeError("fitted again")

    monkeypatch.setattr(_leaf_spectra, "fit_leaf", refit)
    np.testing.assert_array_equal(plot_parameters(plot).leaf.water, leaf.water)
    whole = kept.get(keys[0])
    changes = (
        *({"water": float("nan")}, {"chlorophyll": -40.0}, {"structure": 90.8}, {"water": "wet"}),
        *({"spread": -0.1}, {"said": [3]}),
    )
    for wrong in ({}, [], {"leaves": {}, "said": []}, *(_with(whole, **each) for each in changes)):
        kept.put(keys[0], json.dumps(wrong).encode())
        with pytest.raises(RuntimeError, match="fitted again"):
            plot_parameters(plot)
    kept.put(keys[0], whole)
    np.testing.assert_array_equal(plot_parameters(plot).leaf.water, leaf.water)
    monkeypatch.setattr(_leaf_spectra, "code_hash", lambda *_: "other code")
    with pytest.raises(RuntimeError, match="fitted again"):
        plot_parameters(plot)


def _with(whole: bytes, **changes: object) -> dict[str, object]:
    """What was kept with a trait of the first leaf, its first spread or the warnings changed."""
    found = json.loads(whole)
    first = next(iter(found["leaves"].values()))
    for name, value in changes.items():
        if name == "said":
            found["said"] = value
        elif name == "spread":
            first["spread"][next(iter(first["spread"]))] = value
        else:
            first["traits"][name] = value
    return found
