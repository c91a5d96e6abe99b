"""The parts of `fit-leaf`: on processes, and after an interruption."""

import functools
from datetime import UTC, datetime

import jax
import numpy as np
import pandas as pd
import pytest

from fynjax import jobs, leaf
from fynjax._core import parts
from fynjax.io.spectra import _leaf_results
from fynjax.leaf import LeafParameters, prospect

LEAVES, CHUNK = 10, 4


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
def chunks(monkeypatch):
    """Few leaves are a part."""
    monkeypatch.setattr(leaf, "fit_leaf", functools.partial(leaf.fit_leaf, chunk=CHUNK))
    monkeypatch.setattr(_leaf_results, "datetime", Noon)


def contents(folder):
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def without_times(result):
    return result.model_dump(exclude={"output", "timings_s", "peak_memory_mib"})


def test_files_of_two_workers_are_those_of_one_process(table, tmp_path, monkeypatch):
    pytest.importorskip("distributed", reason="the extra `cluster` is not installed")
    monkeypatch.setattr(parts, "_machine", lambda: (2, 8 * 2**30))
    here = jobs.fit_leaf([table], tmp_path / "here")
    there = jobs.fit_leaf([table], tmp_path / "there", workers=jobs.Workers(2))
    assert here.spectra == LEAVES
    assert without_times(here) == without_times(there)
    assert set(contents(tmp_path / "here")) == {"traits.csv", "spectra.nc", "spectra.png"}
    assert contents(tmp_path / "here") == contents(tmp_path / "there")
