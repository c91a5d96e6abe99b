"""What needs 64-bit numbers gets them without a setting, and says so where it cannot."""

import os
import subprocess
import sys
import textwrap

import pytest

FIT_LEAF = """
import numpy as np
from fynjax.leaf import LeafParameters, fit_leaf, prospect
leaf = prospect(LeafParameters(chlorophyll=40.0), np.arange(400.0, 2501.0))
fit = fit_leaf(np.arange(400.0, 2501.0), np.asarray(leaf.reflectance)[None])
print(leaf.reflectance.dtype, fit.parameters.chlorophyll.dtype)
"""
FIT = """
import jax.numpy as jnp
from fynjax.inversion import Data, ParameterSpace, fit
space = ParameterSpace(("x",), *(jnp.array([v]) for v in (-9.0, 9.0, 0.0, 2.0)))
line = fit(lambda x: x, Data(("y",), jnp.array([1.0]), jnp.array([0.1])), space)
print(line.estimate.dtype, line.covariance.dtype)
"""


def run(code: str, **environment: str) -> subprocess.CompletedProcess[str]:
    inherited = {k: v for k, v in os.environ.items() if k != "JAX_ENABLE_X64"}
    return subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True, text=True, check=False, env=inherited | environment,
    )  # fmt: skip


@pytest.mark.parametrize("code", [FIT_LEAF, FIT], ids=["fit_leaf", "fit"])
def test_what_needs_64_bits_has_them(code):
    done = run(code)
    assert done.stdout.split() == ["float64", "float64"], done.stderr


def test_what_needs_64_bits_says_so_where_there_are_none():
    parts = "\n".join(
        f"try:\n{textwrap.indent(code, '    ')}\nexcept InputError as error:\n    print(error)"
        for code in (FIT_LEAF, FIT)
    )
    done = run(f"from fynjax.errors import InputError\n{parts}", JAX_ENABLE_X64="0")
    said = done.stdout.splitlines()
    assert len(said) == 2, done.stderr
    for line, name in zip(said, ("fit_leaf", "fit")):
        assert f"`{name}` needs numbers of 64 bits" in line
        assert "JAX_ENABLE_X64" in line


@pytest.mark.parametrize("line", ["import fynjax.scene", "from fynjax.jobs import reflectance"])
def test_what_computes_in_64_bits_sets_them_when_it_is_imported(line):
    done = run(f"{line}\nimport jax\nprint(jax.config.jax_enable_x64)")
    assert done.stdout.strip() == "True", done.stderr
