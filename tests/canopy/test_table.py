"""Table 1: equal to the transcribed paper, and the cover that its hard scene really has."""

import json
from pathlib import Path

import numpy as np

from fynjax.canopy import FORMS, assign_sites, instance_area, poisson_disk, table1_2006, target_area

SIDE, PIXEL = 10.0, 0.01


def test_table_equals_the_paper(shared_data: Path) -> None:
    reference = json.loads((shared_data / "paper" / "reference_values.json").read_text())
    rows = {row["taxon"]: row for row in reference["table1_species_2006"]}
    table = table1_2006()
    assert list(table.taxon) == list(rows)
    for row in table.itertuples():
        for column in ("mean_diameter_cm", "cover_percent", "height_max_m"):
            assert getattr(row, column) == rows[row.taxon][column]
    assert set(table.growth_form) <= set(FORMS)
    assert table.cover_percent.sum() == 100.0


def disc_cover(sites: np.ndarray, diameter: float) -> np.ndarray:
    """Pixels of a periodic raster whose centre lies in at least one crown disc."""
    n = round(SIDE / PIXEL)
    covered = np.zeros((n, n), bool)
    reach = int(np.ceil(diameter / 2 / PIXEL)) + 1
    step = np.arange(-reach, reach + 1)
    for x, y in sites:
        column, row = int(x / PIXEL) + step, int(y / PIXEL) + step
        east = (column + 0.5) * PIXEL - x
        north = (row + 0.5) * PIXEL - y
        inside = north[:, None] ** 2 + east**2 <= (diameter / 2) ** 2
        covered[np.ix_(row % n, column % n)] |= inside
    return covered


def test_cover_of_the_hard_scene() -> None:
    """Crowns planted without regard to each other overlap as in a Boolean model.

    Discs that together have the area fraction c cover 1 - exp(-c) of the ground (Stoyan, Kendall
    and Mecke 1995). So a species of the table's 20 % covers 18.1 %, and all thirteen, whose
    covers sum to 100 %, leave 1/e = 37 % of the ground bare: the bare ground of the paper's scene.
    """
    table = table1_2006()
    diameter = table.mean_diameter_cm.to_numpy() / 100.0
    crowns = [float(instance_area(d, h)) for d, h in zip(diameter, table.height_max_m)]
    wanted = target_area(SIDE**2, table.cover_percent.to_numpy() / 100.0)
    counts = np.ceil(wanted / np.array(crowns)).astype(int)
    covers, totals = [], []
    for seed in range(10):
        points = poisson_disk((SIDE, SIDE), 0.05, seed=seed, periodic=True)
        sites = assign_sites(points, counts, seed=seed)
        assert [len(s) for s in sites] == list(counts)
        rasters = [disc_cover(s, d) for s, d in zip(sites, diameter, strict=True)]
        covers.append([raster.mean() for raster in rasters])
        totals.append(np.any(rasters, axis=0).mean())
    planted = counts * np.array(crowns) / SIDE**2
    # The ceiling adds less than one crown: 0.8 % of the plot for the largest.
    np.testing.assert_array_less(planted - table.cover_percent / 100.0, np.array(crowns) / SIDE**2)
    boolean = 1.0 - np.exp(-planted)
    mean, spread = np.mean(covers, axis=0), np.std(covers, axis=0)
    # Blue noise keeps the closest crowns apart, so a little more is covered than at random; the
    # 1 cm raster adds its own rounding for the 10 cm discs.
    np.testing.assert_allclose(mean, boolean, rtol=0.02, atol=4 * spread.max() / np.sqrt(10))
    assert 0.62 < np.mean(totals) < 0.68  # all species together
