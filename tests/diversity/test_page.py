"""The page on diversity: its code runs, and it names what there is."""

import re
from pathlib import Path
from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pytest

import fynjax as fx
from fynjax.scene import PixelTruth

PAGE = (Path(__file__).resolve().parents[2] / "docs" / "diversity.md").read_text("utf-8")


@pytest.fixture(scope="module")
def names() -> dict:
    """What the code of the page defines."""
    source = "".join(re.findall(r"^```python\n(.*?)^```$", PAGE, re.M | re.S))
    found: dict = {}
    exec(compile(source, "docs/diversity.md", "exec"), found)
    return found


def test_the_code_of_the_page_runs(names: dict) -> None:
    assert names["variety"].sizes == {"y": 4, "x": 4}
    assert names["slope"].shape == (2, 4)


def test_pixels_of_an_image_are_chosen_by_their_leading_species(names: dict) -> None:
    """Two stands of six pixels a species, and between them mixed ones that are left out."""
    shares = np.zeros((2, 4, 8))
    shares[0, :, :3] = shares[1, :, 5:] = 0.8
    shares[:, :, 3:5] = 0.4  # none of these has half of the pixel
    none, ground = np.zeros((2, 4, 8)), np.full((4, 8), 0.1)
    taxa = ("Erica", "Restio")
    layers = map(jnp.asarray, (shares, none, none, none, ground, ground))
    truth = PixelTruth(*layers, taxa, "camera", 1.0, (0.0, 0.0))
    bands = np.tensordot([[0.1, 0.4], [0.3, 0.2]], shares, axes=1)
    bands += np.random.default_rng(0).normal(0.0, 0.01, bands.shape)
    spectra, species = names["pixels_of_species"](SimpleNamespace(reflectance=bands), truth)
    assert spectra.shape == (24, 2)
    planting = np.repeat([1, 2], 12)  # the lower and the upper rows
    got = fx.diversity.classify(spectra, species, planting)
    np.testing.assert_array_equal(got.confusion, [[12, 0], [0, 12]])


def test_every_function_is_on_the_page() -> None:
    functions = {name for name in fx.diversity.__all__ if name.islower()}
    assert len(functions) > 25
    assert not {name for name in functions if f"`{name}`" not in PAGE}
