"""`fynjax render`: what it writes, and that one process compiles its programs once."""

import jax
import numpy as np
import pytest
import rasterio

from fynjax.jobs import render, simulate
from tests.helpers import compilations
from tests.jobs import test_simulate


@pytest.mark.parametrize("job", [render, simulate])
def test_another_seed_compiles_nothing(job, tmp_path):
    jax.clear_caches()  # other tests compile the same programs
    plot, images, programs = test_simulate.write_plot(tmp_path), [], []
    for number in range(2):
        out = tmp_path / f"out_{number}"
        out.mkdir()
        with compilations() as compiled:
            job(plot, out, seed=number)
        programs.append(compiled)
        with rasterio.open(out / ("image.tif" if job is render else "reflectance.tif")) as file:
            images.append(file.read(1))
    assert programs[0]
    assert programs[1] == []
    assert not np.array_equal(*images)
