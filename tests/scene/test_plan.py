"""The plan of a scene has the counts of the scene that is then planted."""

from contextlib import nullcontext

import numpy as np
import pytest

from fynjax import jobs
from fynjax._core.dry_run import begin_work
from fynjax._core.errors import InputError
from fynjax.app.assembly import build_plot
from fynjax.app.io.plot import example_folder, read_plot
from fynjax.app.jobs._plant import plant
from fynjax.scene import hard_counts, hard_scene
from tests.assembly.test_plants import COLUMNS, TOML
from tests.io.test_crowns import CROWNS, write

MEASURED = {5.0: (0.87, 16.0), 10.0: (1.53, 19.0), 20.0: (3.25, 36.0), 40.0: (2.76, 172.0)}
"""Largest memory [GiB] and processor time [s] of `fynjax render` of the shipped plot of this side
[m], in 4 bands, on one processor; the last in tiles, beside other work."""
FACTOR = 2.0
"""Within which plans are."""


def shipped(side):
    return read_plot(example_folder() / "plot.toml").replace(size_m=(side, side))


def planned(plot):
    """The plan of a plot, and its scene without plants."""
    with jobs.dry_run():
        scene, _ = build_plot(plot)
        with pytest.raises(jobs.DryRunEnd) as caught:
            begin_work({})
    return caught.value.plan, scene


def check_against_planted(plot):
    plan, bare = planned(plot)
    scene, parameters = build_plot(plot)
    planting, taxa = scene.planting, len(scene.taxa)
    assert len(bare.planting.species) == 0
    np.testing.assert_array_equal(plan.plants, hard_counts(scene, parameters))
    np.testing.assert_array_equal(plan.sites, np.bincount(planting.species, minlength=taxa))
    assert plan.elements == len(hard_scene(scene, parameters).planting.plant) > 0
    assert plan.sites @ plan.each == len(planting.plant)
    assert (plan.voxels, plan.finer) == (scene.grid.shape, scene.finer)
    if scene.finer:
        assert plan.record()["finest_voxels"] == np.prod(scene._finest().shape)
    assert f"{plan.plants.sum()} plants of {taxa} species" in str(plan)


def test_the_plan_of_the_shipped_plot_has_the_counts_of_its_scene():
    check_against_planted(shipped(4.0))


@pytest.mark.parametrize("elements", [300, 1500])
def test_the_plan_of_a_plot_of_meshes_has_the_counts_of_its_scene(tmp_path, elements):
    plant("Pterocelastrus tricuspidatus", tmp_path, n_elements=elements, seed=0)
    rows = [f"Pterocelastrus tricuspidatus,60,40,1.2,broad_leaved,{tmp_path / 'elements.csv'}"]
    rows += ["Erica irregularis,40,20,0.6,rounded_shrub,"]
    (tmp_path / "species.csv").write_text(COLUMNS + "\n".join(rows) + "\n")
    (tmp_path / "plot.toml").write_text(TOML)
    check_against_planted(read_plot(tmp_path / "plot.toml", allow_outside=True))


def test_the_plan_of_known_plants_has_all_of_them(tmp_path):
    check_against_planted(read_plot(write(tmp_path, CROWNS)))


def test_the_plan_counts_the_plants_of_a_table_of_parameters(tmp_path):
    table = tmp_path / "parameters.csv"
    table.write_text("name,unit,estimate\nspecies.Erica irregularis.cover,%,10\n")
    stated = planned(shipped(4.0))[0]
    plot = shipped(4.0).replace(parameters=table)
    check_against_planted(plot)
    assert planned(plot)[0].plants.sum() != stated.plants.sum()


@pytest.mark.parametrize("side", MEASURED)
def test_memory_and_time_of_the_plan_are_near_those_that_were_measured(side):
    plan, _ = planned(shipped(side))
    memory, seconds = MEASURED[side]
    assert memory / FACTOR < plan.memory / 2**30 < memory * FACTOR
    assert seconds / FACTOR < plan.seconds < seconds * FACTOR


@pytest.mark.parametrize(
    ("where", "sentence"),
    [
        ("fynjax.app.assembly._memory.total_memory", "GiB of memory, but this machine has"),
        ("fynjax.radiation._check._memory", "voxels in 4 bands needs about"),
    ],
)
def test_a_dry_run_refuses_what_the_run_has_no_memory_for(where, sentence, tmp_path, monkeypatch):
    monkeypatch.setattr(where, lambda: 2**20)
    with pytest.raises(InputError, match=sentence) as dry, jobs.dry_run():
        jobs.render_plot(shipped(2.0), tmp_path)
    # The light has the same to say when it is to be solved.
    monkeypatch.setattr("fynjax.app.jobs._render.check_image", lambda *_, **__: None)
    with pytest.raises(InputError) as real:
        jobs.render_plot(shipped(2.0), tmp_path)
    assert str(dry.value) == str(real.value)


def test_a_dry_run_refuses_a_mesh_of_too_many_triangles(tmp_path):
    said = []
    for block in (nullcontext(), jobs.dry_run()):
        with pytest.raises(InputError, match="triangles each are") as caught, block:
            jobs.build(shipped(2.0), tmp_path, mesh=True, max_triangles=1000)
        said.append(str(caught.value))
    assert said[0] == said[1]


def test_a_structure_of_too_many_voxels_is_refused_alike(tmp_path):
    fine = shipped(100.0).replace(structure_m=0.005)
    with pytest.raises(InputError, match="of the finest voxels, but at most"), jobs.dry_run():
        jobs.render_plot(fine, tmp_path)
