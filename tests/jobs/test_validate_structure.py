"""What a comparison of clouds says and writes: noise, birds, cells, files."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import xarray as xr

from fynjax._core.errors import InputError
from fynjax.app.compare.structure._cloud import CloudSettings, height_cloud
from fynjax.app.compare.structure._compare import ComparisonSettings, compare_clouds
from fynjax.app.compare.structure._pits import sunk, without_pits
from fynjax.app.compare.structure._settings import cloud_settings
from fynjax.app.jobs._validate import ValidationData, validate
from fynjax.app.report.pages import Table, structure_section
from fynjax.app.terrain import PointCloud
from fynjax.metrics.structure import STRUCTURE_METRICS, STRUCTURE_PRESETS
from tests.compare.test_structure import plot, write_las
from tests.helpers import assert_valid_summary

BOUNDS = (0.0, 0.0, 10.0, 10.0)


def surface(height, number: int = 400, seed: int = 0) -> PointCloud:  # type: ignore[no-untyped-def]
    """Ground points at random places of 10 m x 10 m, with 1 cm of noise."""
    rng = np.random.default_rng(seed)
    x, y = rng.uniform(0.0, 10.0, (2, number))
    return PointCloud(x, y, height(x, y) + rng.normal(0.0, 0.01, number))


@pytest.mark.parametrize("slope", [0.0, 1.5])
def test_pits_in_pairs_do_not_hide_one_another(slope: float) -> None:
    cloud = surface(lambda x, y: slope * x)
    near = np.argsort(np.hypot(cloud.x - 5.0, cloud.y - 5.0))[:2]
    edge = np.argsort(np.hypot(cloud.x, cloud.y))[:2]
    cloud.z[[*near, *edge]] -= (1.0, 1.2, 4.0, 7.0)
    kept = without_pits(cloud, np.ones(400, bool), 0.5)
    assert sorted(np.flatnonzero(~kept)) == sorted([*near, *edge])


def test_slopes_ditches_and_steps_are_ground() -> None:
    for height in (
        lambda x, y: 1.5 * x + 0.5 * y,
        lambda x, y: np.where(np.abs(x - 5.0) < 0.6, -1.0, 0.0),
        lambda x, y: np.where(x < 5.0, 0.0, 2.0),
        lambda x, y: 1.5 * np.sin(x) + 0.05 * x**2,
    ):
        cloud = surface(height)
        assert without_pits(cloud, np.ones(400, bool), 0.5).all()


def test_points_below_the_ground_are_not_plants() -> None:
    cloud = surface(lambda x, y: 0.8 * x)
    ground = np.arange(400) % 4 == 0
    cloud.z[1::4] += 1.0
    cloud.z[2::4] += 0.3
    cloud.z[[3, 7]] -= 2.0
    assert list(np.flatnonzero(sunk(cloud, ground, 0.5))) == [3, 7]


@pytest.mark.parametrize("labelled", [True, False])
def test_noise_below_the_ground_leaves_the_heights(labelled: bool) -> None:
    """20 of 1317 returns far too low, as ground where there are classes; warned of."""
    x, y, height, z, ground = plot(3, 13.17)
    which = np.random.default_rng(5).choice(len(z), 20, replace=False)
    z[which] -= np.random.default_rng(6).uniform(1.0, 8.0, 20) + height[which]
    ground[which] = True
    classes = np.where(ground, 2, 1).astype(np.uint8) if labelled else None
    cloud = PointCloud(x, y, z, classification=classes)
    with pytest.warns(UserWarning, match=r"20 of 131\d returns .*--deepest"):
        got = height_cloud(cloud, Path("a.las"), CloudSettings(), BOUNDS)
    assert got.below_ground == 20
    true = np.delete(height, which)
    np.testing.assert_allclose(got.height.mean(), true.mean(), atol=0.02)
    np.testing.assert_allclose(np.quantile(got.height, 0.95), np.quantile(true, 0.95), atol=0.03)


@pytest.fixture(scope="module")
def clouds(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A real plot, a denser simulated one, one with birds, and bare ground; heights all."""
    folder = tmp_path_factory.mktemp("heights")
    for name, seed, density in (("real", 0, 13.17), ("simulated", 1, 60.0)):
        x, y, height, _, _ = plot(seed, density)
        write_las(folder / f"{name}.las", x, y, height)
    x, y, height, _, _ = plot(0, 13.17)
    height[:3] += 60.0
    write_las(folder / "birds.las", x, y, height)
    rounding = np.random.default_rng(1).uniform(0.0, 0.001, len(x))
    write_las(folder / "bare.las", x, y, rounding)
    return folder


FEW = {"real_ground": "none", "simulated_ground": "none", "repetitions": 3, "bounds": BOUNDS}


def notes(folder: Path, real: str = "real", preset: str | None = None, **options: object) -> str:
    settings = cloud_settings(preset, {**FEW, **options})
    comparison = compare_clouds(folder / f"{real}.las", folder / "simulated.las", settings=settings)
    return " ".join(comparison.notes)


def test_notes_name_what_makes_numbers_doubtful(clouds: Path) -> None:
    assert notes(clouds) == ""
    assert "the highest return is at 6" in (said := notes(clouds, "birds", grain=2.0))
    assert "--tallest" in said
    said = notes(clouds, "birds", grain=2.0, tallest=10.0)
    assert "the highest return" not in said
    assert "3 returns higher than `tallest`" in said
    said = notes(clouds, grain=4.0)
    assert "36 % of the plot is in no cell" in said
    assert "means over 4 cells" in said
    assert "more than 0.01 %" in notes(clouds, largest_change=1e-4)
    said = notes(clouds, preset="GEDI L2B")
    assert "leaf area density std is undefined in the real cloud: with layers of 5 m" in said
    assert "diversity is 0 in the simulated cloud because one layer of 5 m" in said


def test_bare_ground_is_not_measured_by_its_rounding(clouds: Path) -> None:
    settings = cloud_settings(None, {**FEW, "grain": 2.0})
    comparison = compare_clouds(clouds / "bare.las", clouds / "simulated.las", settings=settings)
    values = comparison.real.metrics["value"]
    assert np.isnan(values["height_cv"])
    assert values["rugosity"] == 0.0
    assert np.isnan(comparison.difference_percent["rugosity"])
    assert "height cv is undefined in the real cloud" in " ".join(comparison.notes)


def test_options_reach_the_settings_and_override_the_preset() -> None:
    got = cloud_settings("lidR", {"layer": 0.5, "shift": (1.0, 2.0, 3.0), "tallest": 9.0,
                                  "real_ground": "smrf", "grain": None})  # fmt: skip
    assert (got.structure.layer, got.structure.lowest) == (0.5, 2.0)
    assert got.structure.diversity_lowest == STRUCTURE_PRESETS["lidR"].diversity_lowest
    assert got.structure.source.endswith("but layer 0.5")
    assert got.simulated_shift == (1.0, 2.0, 3.0)
    assert (got.real.tallest, got.simulated.tallest) == (9.0, 9.0)
    assert (got.real.ground, got.simulated.ground) == ("smrf", "auto")
    assert cloud_settings(None, {"layer": 0.1, "lowest": 0.1}).structure.diversity_lowest == 0.1
    assert cloud_settings(None, {}) == ComparisonSettings()
    for options, word in (
        ({"layer": 0.0}, "--layer"),
        ({"tallest": -1.0}, "--tallest"),
        ({"grain": 0.0}, "--grain"),
        ({"bounds": (5.0, 0.0, 1.0, 1.0)}, "--bounds"),
        ({"real_ground": "some"}, "--real-ground"),
    ):
        with pytest.raises(InputError, match=word):
            cloud_settings(None, options)
    with pytest.raises(InputError, match="fynjax, lidR"):
        cloud_settings("nope", {})


def test_a_shift_upwards_moves_given_heights(clouds: Path) -> None:
    def percentiles(up: float) -> np.ndarray:
        settings = cloud_settings(None, {**FEW, "grain": 5.0, "shift": (0.0, 0.0, up)})
        comparison = compare_clouds(
            clouds / "real.las", clouds / "simulated.las", settings=settings
        )
        return comparison.simulated.percentiles

    np.testing.assert_allclose(percentiles(0.5), percentiles(0.0) + 0.5, atol=2e-3)


def test_every_number_is_in_the_files(clouds: Path, tmp_path: Path) -> None:
    data = ValidationData(real_cloud=clouds / "real.las", simulated_cloud=clouds / "simulated.las")
    summary = validate(data, tmp_path, cloud_options=FEW)
    assert sorted(summary.files) == sorted(p.name for p in tmp_path.iterdir())
    assert_valid_summary(summary)
    grains = pd.read_csv(tmp_path / "structure_grains.csv").set_index("grain_m")
    assert list(grains.index) == [1.0, 2.0, 3.0, 4.0, 5.0]
    assert list(grains.index[grains["taken"] == "yes"]) == [summary.structure.grain_m] == [2.0]
    assert grains.loc[3.0, ["cells", "area_m2", "cut_off_percent"]].tolist() == [9, 81, 19]
    assert grains["paper_median_change_percent"].tolist()[:2] == [17.9, 6.1]
    assert grains.loc[2.0, ["west_m", "south_m", "east_m", "north_m"]].tolist() == [0, 0, 10, 10]
    html = (tmp_path / "report.html").read_text("utf-8")
    for words in ("17.9", "25 cells of 2 m", "100 m²", "0.0 % of the plot"):
        assert words in html, words
    table = pd.read_csv(tmp_path / "structure.csv").set_index("metric")
    with xr.open_dataset(tmp_path / "structure.nc") as file:
        assert list(file["metric"].values) == list(STRUCTURE_METRICS)
        for side in ("real", "simulated"):
            for name in ("", "_full", "_thinning_low", "_bootstrap_high"):
                got = file[f"metric_mean{name}"].sel(cloud=side)
                np.testing.assert_allclose(got, table[side + name][:6].astype(float), rtol=1e-8)
            cells = file["rugosity"].sel(cloud=side)
            assert file["metric_mean"].sel(cloud=side, metric="rugosity") == pytest.approx(
                float(cells.mean()), rel=0.02
            )
            for stem, name in (("profile", "leaf_area_density"), ("histogram", "height_share"),
                               ("percentiles", "height_percentile")):  # fmt: skip
                csv = pd.read_csv(tmp_path / f"structure_{stem}.csv")
                np.testing.assert_allclose(file[name].sel(cloud=side), csv[side], rtol=1e-7)
        for name in ("height_percentile_rmse", "height_intersection"):
            row = table.loc[name]
            assert float(file[name]) == pytest.approx(row["simulated"])
            assert float(file[f"{name}_thinning_low"]) == pytest.approx(
                row["simulated_thinning_low"]
            )


def test_open_tables_of_structure_fit_on_a_page_and_quote_no_other_plot(clouds: Path) -> None:
    settings = cloud_settings(None, {**FEW, "grain": 2.0})
    comparison = compare_clouds(clouds / "real.las", clouds / "simulated.las", settings=settings)
    tables = [part for part in structure_section(comparison).parts if isinstance(part, Table)]
    shown = [[str(c) for c in table.rows] for table in tables if not table.folded]
    folded = [str(c) for table in tables if table.folded for c in table.rows]
    assert [len(columns) for columns in shown] == [9, 11]
    assert not any(c.startswith("paper") for columns in shown for c in columns)
    assert {"paper_real", "real_thinning_low", "paper_median_change_percent", "west_m"} <= set(
        folded
    )
