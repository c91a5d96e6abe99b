"""Plant models: what they promise of shape, area and normals."""

import math
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from fynjax._core.errors import InputError
from fynjax.canopy import FORMS, Organ, PlantModel, forms, leaf_angle, plant_model, table1_2006
from fynjax.canopy._elements import _outline, free_shoots
from fynjax.canopy._table import leaf_sizes


def arrays(plant: PlantModel, organ: Organ) -> tuple[np.ndarray, np.ndarray]:
    chosen = np.asarray(plant.organ) == organ
    return np.asarray(plant.position)[chosen], np.asarray(plant.normal)[chosen]


@pytest.mark.parametrize("n_elements", [3, 40, 501])
@pytest.mark.parametrize("form", FORMS)
def test_what_every_form_promises(form: str, n_elements: int) -> None:
    plant = plant_model(form, n_elements, seed=4)
    position, organ = np.asarray(plant.position), np.asarray(plant.organ)
    assert position.shape == (n_elements, 3)
    assert np.hypot(position[:, 0], position[:, 1]).max() <= 1.0
    assert position[:, 2].min() >= 0.0
    assert position[:, 2].max() <= 1.0
    np.testing.assert_allclose(np.linalg.norm(plant.normal, axis=1), 1.0, atol=1e-12)
    assert np.asarray(plant.normal)[:, 2].min() >= -1e-12
    defaults = FORMS[form]
    bears = (defaults.leaf_area_index, defaults.wood_area_index, defaults.flower_fraction)
    for kind, amount in zip(Organ, bears, strict=True):
        total = np.asarray(plant.area_fraction)[organ == kind].sum()
        assert total == pytest.approx(1.0 if amount > 0 else 0.0, abs=1e-12)


@pytest.mark.parametrize("form", FORMS)
def test_a_seed_fixes_the_plant(form: str) -> None:
    same = plant_model(form, 50, seed=1), plant_model(form, 50, seed=1)
    np.testing.assert_array_equal(same[0].position, same[1].position)
    assert not np.array_equal(same[0].position, plant_model(form, 50, seed=2).position)


@pytest.mark.parametrize(
    "form", [
        "upright_ericoid", "rounded_shrub", "broad_leaved", "climber", "cushion", "mat",
        "succulent", "moss_layer",
    ],
)  # fmt: skip
def test_leaf_normals_project_as_their_distribution(form: str) -> None:
    """G of the elements, with every azimuth, against the Ross-Nilson integral."""
    _, normal = arrays(plant_model(form, 4000, seed=0), Organ.LEAF)
    angle = leaf_angle(FORMS[form].leaf_angle)
    level, upright = np.hypot(normal[:, 0], normal[:, 1])[:, None], normal[:, 2:]
    turn = np.cos(np.linspace(0, 2 * np.pi, 180, endpoint=False))
    for zenith in (0.0, 25.0, 57.5, 80.0):
        view = math.radians(zenith)
        g = np.mean(np.abs(level * turn * math.sin(view) + upright * math.cos(view)))
        expected = float(angle.projection(np.array(math.cos(view))))
        assert g == pytest.approx(expected, rel=0.01)


@pytest.mark.parametrize("form", FORMS)
def test_individuals_differ_and_are_as_wide_and_high_as_stated(form: str) -> None:
    """Mean of two horizontal extents is the diameter; sectors differ within a plant, not on the
    mean of all. Few elements of a large crown tell the same as many."""
    organ = Organ.LEAF if FORMS[form].leafy else Organ.WOOD
    extents, sectors, reach = [], [], []
    for seed in range(40):
        position, _ = arrays(plant_model(form, 60 if seed % 2 else 800, seed=seed), organ)
        if seed % 2 == 0:
            extents.append(np.ptp(position[:, :2], axis=0).mean())
            assert position[:, 2].max() > 0.9
        turn = np.arctan2(position[:, 1], position[:, 0]) / (2 * np.pi) + 0.5
        sectors.append(np.histogram(turn, 6, (0.0, 1.0))[0] / len(turn))
        distance = np.hypot(position[:, 0], position[:, 1])
        reach.append([distance[(6 * turn).astype(int) % 6 == k].max(initial=0) for k in range(6)])
    # Few of few stems reach the rim, and columns are thick about their axes.
    shoots = FORMS[form].shoots
    few = FORMS[form].crown is None and shoots is not None and shoots.number < 20
    assert np.mean(extents) == pytest.approx(1.0, abs=0.2 if few else 0.1)
    assert np.std(reach, axis=1).mean() > 0.04  # lobes: of discs it is 0.01
    np.testing.assert_allclose(np.mean(sectors, axis=0), 1 / 6, atol=0.035)


def test_an_outline_has_the_area_of_its_circle() -> None:
    for seed in range(5):
        reach = _outline(0.5, np.random.default_rng(seed))
        turn = 2 * np.pi * np.arange(len(reach) + 1) / len(reach)
        x, y = (np.append(reach, reach[0]) * f(turn) for f in (np.cos, np.sin))
        area = 0.5 * np.sum(x[:-1] * y[1:] - x[1:] * y[:-1])
        assert area == pytest.approx(np.pi, rel=1e-3)
        assert np.ptp(reach) > 0.3


@pytest.mark.parametrize("form", ["upright_ericoid", "rounded_shrub", "broad_leaved"])
def test_leaves_stand_in_bunches_with_gaps_between(form: str) -> None:
    """Cells of an eighth of the crown that leaves cover from above: more empty ones inside the
    circle than even leaves leave, and most of the crown covered."""
    empty, even = [], []
    rng = np.random.default_rng(0)
    grid = (np.arange(12) + 0.5) / 12 - 0.5
    inside = np.hypot(*np.meshgrid(grid, grid)) < 0.45
    for seed in range(20):
        position, _ = arrays(plant_model(form, 600, seed=seed), Organ.LEAF)
        turn, distance = 2 * np.pi * rng.random(450), 0.5 * np.sqrt(rng.random(450))
        disc = np.stack([distance * np.cos(turn), distance * np.sin(turn)], axis=-1)
        for points, found in ((position, empty), (disc, even)):
            cells = np.histogram2d(points[:, 0], points[:, 1], 12, [[-0.5, 0.5]] * 2)[0]
            found.append((cells[inside] == 0).mean())
    assert np.mean(even) < 0.03
    assert 0.05 < np.mean(empty) < 0.4


def test_a_form_is_a_file_of_its_folder_and_nothing_else() -> None:
    files = {path.stem for path in Path(forms.__file__).parent.glob("*.py")} - {"__init__"}
    assert set(FORMS) == files
    for form in FORMS.values():
        assert (form.prior is not None) == form.leafy == (form.stand_share > 0.0)
        assert (form.leaf.kind != "none") == form.leafy


def test_a_genus_or_family_belongs_to_one_form() -> None:
    for kind in ("genera", "families"):
        names = [
            name
            for form in FORMS.values()
            for taxa in (form.flat_leaved, form.round_leaved)
            for name in getattr(taxa, kind).split()
        ]
        assert len(names) == len(set(names)) > 0


def test_usual_sizes_are_means_of_the_shipped_taxa_or_said_to_be_assumed() -> None:
    table = table1_2006()
    for name, form in FORMS.items():
        rows = table[table.growth_form == name]
        if rows.empty:
            assert form.size_source.startswith("assumed")
            continue
        assert form.diameter == pytest.approx(rows.mean_diameter_cm.mean() / 100, rel=1e-12)
        assert form.height == pytest.approx(rows.height_max_m.mean(), rel=1e-12)
        assert form.size_source.startswith(f"mean of {len(rows)} taxa")


def test_forms_differ_as_described() -> None:
    leaf = {
        form: arrays(plant_model(form, 1500, seed=0), Organ.LEAF)
        for form in FORMS
        if form != "deadwood"
    }
    height = {form: position[:, 2] for form, (position, _) in leaf.items()}
    assert height["upright_ericoid"].mean() > height["rounded_shrub"].mean() + 0.1
    assert height["climber"].min() > 0.64  # it lies on its hosts
    assert height["tussock"].min() < 0.05
    steepness = {form: np.abs(normal[:, 2]).mean() for form, (_, normal) in leaf.items()}
    assert steepness["tussock"] < steepness["upright_ericoid"] < steepness["broad_leaved"]
    assert steepness["climber"] > 0.8
    assert steepness["column"] < steepness["upright_ericoid"]
    # Leaves of a cushion lie in its surface, those of a round shrub also below.
    depth = {}
    for form in ("cushion", "rounded_shrub"):
        x, y, z = leaf[form][0].T
        depth[form] = 1.0 - np.sqrt((2.0 * np.hypot(x, y)) ** 2 + z**2).mean()
    assert depth["cushion"] < depth["rounded_shrub"]


@pytest.mark.parametrize("form", ["mat", "moss_layer"])
def test_low_sheets_are_closed_and_level_up_to_the_rim(form: str) -> None:
    """Cells of a twelfth of the diameter have leaves, and the leaves of the rim reach as high as
    the others, where those of a dome are lower."""
    grid = (np.arange(12) + 0.5) / 12 - 0.5
    inside = np.hypot(*np.meshgrid(grid, grid)) < 0.42
    rim: dict[str, list[float]] = {form: [], "cushion": []}
    covered = []
    for name in rim:
        for seed in range(10):
            x, y, z = arrays(plant_model(name, 2000, seed=seed), Organ.LEAF)[0].T
            outer = np.hypot(x, y) > np.quantile(np.hypot(x, y), 0.9)
            rim[name].append(np.quantile(z[outer], 0.9) / z.max())
            if name == form:
                cells = np.histogram2d(x, y, 12, [[-0.5, 0.5]] * 2)[0]
                covered.append((cells[inside] > 0).mean())
    assert np.mean(covered) > 0.97
    assert np.mean(rim[form]) > 0.8 > 0.5 > np.mean(rim["cushion"])
    assert FORMS[form].height < 0.34 * FORMS[form].diameter


def test_leaves_of_a_rosette_rise_from_one_foot_the_inner_ones_steeper() -> None:
    position, normal = arrays(plant_model("rosette", 4000, seed=0), Organ.LEAF)
    distance, height = np.hypot(*position[:, :2].T), position[:, 2]
    assert distance[height < 0.02].max() < 0.15
    _, foot, tip, top = free_shoots(FORMS["rosette"].shoots, 0, 36)[0]
    assert np.corrcoef(tip, top)[0, 1] < -0.9
    assert foot.max() < 0.3 * tip.min()
    # They taper: half of the area lies nearer to the foot than half of their length.
    assert np.median(np.linalg.norm(position, axis=1)) < 0.35
    # Normals of a round leaf stand across it: those of steep ones lie.
    lies = np.abs(normal[:, 2])
    assert lies[distance < 0.5 * height].mean() < lies[distance > height].mean() - 0.15


def test_wood_stays_inside_and_flowers_stand_on_top() -> None:
    for form in ("upright_ericoid", "rounded_shrub", "broad_leaved"):
        plant = plant_model(form, 2000, seed=1)
        wood, _ = arrays(plant, Organ.WOOD)
        flower, _ = arrays(plant, Organ.FLOWER)
        assert flower[:, 2].min() >= 0.75
        low = wood[:, 2] < 0.1
        assert np.hypot(*wood[low, :2].T).max() < 0.1
    dead = plant_model("deadwood", 300, seed=1)
    assert set(np.asarray(dead.organ)) == {Organ.WOOD}


def test_spikelets_and_sheaths_sit_on_the_culms() -> None:
    """Each shoot keeps one direction from the axis; the seed says which."""
    turns = {}
    for seed in (1, 2):
        plant = plant_model("tussock", 3000, seed=seed)
        for organ in Organ:
            position, _ = arrays(plant, organ)
            turn = np.degrees(np.arctan2(position[:, 1], position[:, 0]))
            turns[seed, organ] = set(np.round(turn, 6))
    assert len(turns[1, Organ.LEAF]) == 48
    assert turns[1, Organ.WOOD] <= turns[1, Organ.LEAF]
    assert turns[1, Organ.FLOWER] <= turns[1, Organ.LEAF]
    assert not turns[1, Organ.LEAF] & turns[2, Organ.LEAF]


def test_culms_look_like_thin_cylinders() -> None:
    """Half the surface, with normals all round: from the side pi / 2 times less than flat."""
    position, normal = arrays(plant_model("tussock", 8000, seed=3), Organ.LEAF)
    low = position[:, 2] < 0.15  # nearly upright there
    seen = np.abs(normal[low, 0]).mean()
    assert seen == pytest.approx(2 / np.pi, rel=0.06)


def test_bad_forms() -> None:
    with pytest.raises(InputError, match=r"`form`.*upright_ericoid"):
        plant_model("tree", 10, seed=0)
    with pytest.raises(InputError, match="at least 3"):
        plant_model("tussock", 2, seed=0)


def test_sizes_of_leaves_are_those_of_the_shipped_taxa() -> None:
    """Four times area over perimeter of strips and rectangles, mean over the taxa of a form."""
    sizes = leaf_sizes().merge(table1_2006()[["taxon", "growth_form"]], on="taxon")
    sizes = sizes[(sizes.organ_form != "none") & (sizes.taxon != "Clutia alaternoides")]
    length = pd.to_numeric(sizes.length_mm).fillna(np.inf)
    across = 2.0 / (1.0 / length + 1.0 / pd.to_numeric(sizes.width_mm))
    for form, mean in across.groupby(sizes.growth_form).mean().items():
        assert FORMS[str(form)].leaf_diameter == pytest.approx(mean / 1e3, rel=0.06)


def test_dead_wood_has_more_or_fewer_stems_and_some_lean_low() -> None:
    tops = [free_shoots(FORMS["deadwood"].shoots, seed, 12)[0][3] for seed in range(30)]
    numbers = np.array([len(top) for top in tops])
    assert set(numbers) == {8, 9, 10, 11, 12}
    low = np.concatenate([top < 0.25 * top.max() for top in tops]).mean()
    assert 0.03 < low < 0.35
    assert all(top.max() == pytest.approx(1.0) for top in tops)
    several = [np.asarray(plant_model("deadwood", 300, seed=seed).position) for seed in (1, 2)]
    assert np.abs(np.sort(several[0][:, 2]) - np.sort(several[1][:, 2])).max() > 0.05
