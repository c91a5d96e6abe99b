"""The published regression of leaf mass per area, by hand and on its own spectra."""

import json

import numpy as np
import pandas as pd
import pytest

from fynjax._core.errors import InputError
from fynjax.studies.bioscape._plsr import read_leaf_mass_model

MODEL = {
    "wavelengths": [500.0, 600.0],
    "coefficients": [[[1.0], [2.0]], [[3.0], [0.0]]],
    "intercepts": [[0.5], [1.5]],
}


def write(folder, model=MODEL):
    (folder / "LMA_CWM_model_file.json").write_text(json.dumps(model))
    return folder


def test_spectra_have_length_one_and_members_are_averaged(tmp_path):
    model = read_leaf_mass_model(write(tmp_path))
    grid = np.array([499.5, 550.0, 600.0])
    found = model.predict(grid, np.array([[3.0, 9.0, 4.0], [6.0, 0.0, 8.0], [np.nan, 1.0, 1.0]]))
    # (0.6, 0.8): 0.6 + 1.6 + 0.5 and 1.8 + 1.5
    np.testing.assert_allclose(found[:2], (2.7 + 3.3) / 2)
    assert np.isnan(found[2])
    with pytest.raises(ValueError, match="band at 600 nm"):
        model.predict(np.array([500.0, 550.0]), np.ones((1, 2)))


def test_a_folder_without_a_regression_has_none_and_a_bad_one_is_told(tmp_path):
    assert read_leaf_mass_model(tmp_path) is None
    write(tmp_path, MODEL | {"intercepts": [1.0]})
    with pytest.raises(InputError, match="as many intercepts"):
        read_leaf_mass_model(tmp_path)
    write(tmp_path, {"wavelengths": [1.0]})
    with pytest.raises(InputError, match="coefficients"):
        read_leaf_mass_model(tmp_path)
    (tmp_path / "LMA_CWM_model_file.json").write_text("no json")
    with pytest.raises(InputError, match="expected a regression"):
        read_leaf_mass_model(tmp_path)


def test_it_explains_the_means_it_is_published_with(shared_data):
    folder = shared_data / "eco" / "bioscape"
    model = read_leaf_mass_model(folder)
    table = pd.read_csv(folder / "compatible_SpectraCWM.csv")
    bands = [c for c in table if c.startswith("X_")]
    found = model.predict(np.array([float(c[2:]) for c in bands]), table[bands].to_numpy())
    assert np.corrcoef(found, table["LMA_CWM"])[0, 1] > 0.75
    assert found.mean() == pytest.approx(table["LMA_CWM"].mean(), rel=0.02)
