"""The parts of `fit-leaf`: on processes, and after an interruption."""

from datetime import UTC, datetime

import jax
import numpy as np
import pandas as pd
import pytest

from fynjax import jobs
from fynjax._core import parts
from fynjax.app.cli import main
from fynjax.app.io.plot import read_plot
from fynjax.app.jobs import _fit_leaf as job
from fynjax.leaf import LeafChunks, LeafParameters, _result, prospect
from fynjax.scene import leaves_of
from tests.small import write_plot

LEAVES, PART = 10, 4


@pytest.fixture(scope="module")
def table(tmp_path_factory):
    """Reflectance of leaves with noise, one of them doubtful."""
    draw = np.random.default_rng(3)
    many = LeafParameters.many(
        chlorophyll=draw.uniform(15, 70, LEAVES), water=draw.uniform(0.006, 0.02, LEAVES)
    )
    optics = jax.vmap(prospect)(many)
    wavelength = np.asarray(optics.wavelength)[0]
    values = np.asarray(optics.reflectance) + 0.002 * draw.normal(size=optics.reflectance.shape)
    values[5] = 0.5
    columns = {f"leaf {i + 1}": row for i, row in enumerate(values)}
    path = tmp_path_factory.mktemp("leaves") / "leaves.csv"
    pd.DataFrame({"wavelength": wavelength, **columns}).to_csv(path, index=False)
    return path


class Noon(datetime):
    """A clock that stands: files tell when they were made."""

    @classmethod
    def now(cls, tz=None):
        return cls(2026, 1, 1, 12, tzinfo=UTC)


@pytest.fixture(autouse=True)
def small_parts(monkeypatch):
    """Few leaves are a part."""
    monkeypatch.setattr(job, "_PART", PART)
    monkeypatch.setattr(_result, "datetime", Noon)


def contents(folder):
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def without_times(result):
    return result.model_dump(exclude={"output", "timings_s", "peak_memory_mib"})


@pytest.mark.study
def test_files_of_two_workers_are_those_of_one_process(table, tmp_path, monkeypatch):
    pytest.importorskip("distributed", reason="the extra `map` is not installed")
    monkeypatch.setattr(parts, "_machine", lambda: (2, 8 * 2**30))
    here = jobs.fit_leaves([table], tmp_path / "here")
    there = jobs.fit_leaves([table], tmp_path / "there", workers=jobs.Workers(2))
    assert here.spectra == LEAVES
    assert without_times(here) == without_times(there)
    assert set(contents(tmp_path / "here")) == {
        "traits.csv", "spectra.nc", "spectra.png", "report.html"
    }  # fmt: skip
    files = [contents(tmp_path / name) for name in ("here", "there")]
    pages = [kept.pop("report.html").splitlines() for kept in files]
    assert files[0] == files[1]
    # The table of the run says that one had workers.
    assert all(a == b or b"fynjax version" in a for a, b in zip(*pages, strict=True))


def test_an_interrupted_fit_goes_on_and_is_that_of_one_run(table, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("fynjax.app.cli._runtime.keep_compiled", lambda: None)
    jobs.fit_leaves([table], tmp_path / "whole")
    sizes, real = [], LeafChunks.fit

    def interrupted(leaves, setup):
        sizes.append(len(leaves[0]))
        if len(sizes) == 2:
            raise KeyboardInterrupt
        return real(leaves, setup)

    monkeypatch.setattr(LeafChunks, "fit", staticmethod(interrupted))
    kept = tmp_path / "out.checkpoint"

    def command(*more):
        with pytest.raises(SystemExit) as end:
            main(["fit-leaf", str(table), "--quiet", "--output", str(tmp_path / "out"), *more])
        return end.value.code, capsys.readouterr().err

    status, error = command()
    assert (status, sizes) == (130, [4, 4])
    assert f"{kept} keeps what was done" in error
    assert not (tmp_path / "out").exists()
    status, error = command("--version", "PRO")
    assert status == 2
    assert "of another run" in error
    assert command() == (0, "")
    assert sizes == [4, 4, 4, 2]
    assert not kept.exists()
    found, whole = contents(tmp_path / "out"), contents(tmp_path / "whole")
    whole.pop("report.html")  # which says when it was made, and how
    assert {name: found[name] for name in whole} == whole


def test_a_table_of_one_part_needs_no_checkpoint(table, tmp_path, monkeypatch):
    monkeypatch.setattr(job, "_PART", LEAVES)

    def interrupted(leaves, setup):
        raise KeyboardInterrupt

    monkeypatch.setattr(LeafChunks, "fit", staticmethod(interrupted))
    with pytest.raises(KeyboardInterrupt):
        jobs.fit_leaves([table], tmp_path / "out", checkpoint=tmp_path / "kept")
    assert not (tmp_path / "kept").exists()


MEASURED = {
    "structure": ("N_feret", 0.08),
    "chlorophyll": ("cab", 7.5),
    "carotenoids": ("car", 2.5),
    "water": ("ewt", 0.002),
    "dry_matter": ("lma", 0.001),
}
"""Column of the laboratory's table, and the root mean square error that is allowed. N is that which
Feret fitted to reflectance and transmittance."""


def test_traits_of_real_leaves_are_those_of_the_laboratory(shared_data, tmp_path, monkeypatch):
    """Every fourth leaf of ANGERS, from a table of reflectance alone to a table of traits: errors
    below the stated ones, and most intervals hold."""
    monkeypatch.setattr(job, "_PART", 100)
    with np.load(shared_data / "leaf" / "angers_spectra.npz") as stored:
        grid, ids, reflectance = stored["wl"], stored["id"][::4], stored["refl"][::4]
    laboratory = pd.read_csv(shared_data / "leaf" / "angers_chemistry.csv.gz").set_index("id")
    columns = {str(i): row for i, row in zip(ids, reflectance, strict=True)}
    pd.DataFrame({"wavelength": grid, **columns}).to_csv(tmp_path / "leaves.csv", index=False)
    jobs.fit_leaves([tmp_path / "leaves.csv"], tmp_path / "out")
    traits = pd.read_csv(tmp_path / "out" / "traits.csv").set_index("name")
    assert len(traits) == len(ids)
    assert (traits["status"] == "converged").mean() > 0.8
    for trait, (column, most) in MEASURED.items():
        truth = laboratory[column].loc[traits.index]
        error = traits[trait] - truth
        held = (truth > traits[f"{trait}_lower90"]) & (truth < traits[f"{trait}_upper90"])
        assert np.sqrt((error**2).mean()) < most, trait
        assert held.mean() > 0.78, trait


def test_variants_of_species_are_a_leaf_table_of_a_plot(table, tmp_path):
    plot = write_plot(tmp_path, 'leaf_table = "leaves.csv"\n')
    taxa = ["Erica irregularis", "Restio eleocharis"]
    names = [f"leaf {i + 1}" for i in range(LEAVES)]
    groups = pd.DataFrame({"name": names, "species": [taxa[i % 2] for i in range(LEAVES)]})
    groups.to_csv(tmp_path / "groups.csv", index=False)
    jobs.fit_leaves([table], tmp_path / "out", groups=tmp_path / "groups.csv")
    (tmp_path / "leaves.csv").write_bytes((tmp_path / "out" / "leaves.csv").read_bytes())
    read = read_plot(plot)
    leaves = leaves_of(read.species, read.leaves)
    species = pd.read_csv(tmp_path / "out" / "species.csv")
    for taxon, own in zip(taxa, leaves, strict=True):
        drawn = species[(species["species"] == taxon) & (species["variant"] > 0)]
        assert [leaf.water for leaf in own] == pytest.approx(drawn["water"].tolist())
