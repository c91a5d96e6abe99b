"""The doctor finds what is wrong with a backend, and says the way out."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from fynjax._core import compiler
from fynjax.app.cli import main
from fynjax.app.jobs import _doctor


@pytest.mark.parametrize(
    ("name", "change", "advice"),
    [
        ("error_of_sums", lambda: 1.0, "XLA_FLAGS=--xla_cpu"),
        ("_double", lambda: 1.0, "JAX_PLATFORMS=cpu"),
        ("_gradient", lambda: float("nan"), "another version of JAX"),
    ],
)
def test_a_wrong_number_is_named_with_the_way_out(name, change, advice, monkeypatch, capsys):
    for other in ("error_of_sums", "_products", "_image", "_gradient", "_double"):
        monkeypatch.setattr(_doctor, other, lambda: 0.0)
    monkeypatch.setattr(_doctor, name, change)
    with pytest.raises(SystemExit) as ended:
        main(["doctor"])
    wrong = [line for line in capsys.readouterr().out.splitlines() if line.startswith("WRONG")]
    assert ended.value.code == 1
    assert len(wrong) == 1
    assert advice in wrong[0]


def test_what_fails_has_not_passed(monkeypatch):
    def broken() -> float:
        raise RuntimeError("no device\nat all")

    check = _doctor._checked("image", broken, 1.0, "try another")
    assert (check.passed, check.found) == (False, "RuntimeError: no device")
    monkeypatch.setattr(_doctor, "free_memory", lambda: 2**30)
    assert not _doctor._memory().passed


def test_products_that_are_cut_short_are_found(monkeypatch):
    """As on a graphics card: factors of 10 bits."""
    assert _doctor._products() < 1e-5
    monkeypatch.setattr(
        _doctor.jnp, "matmul", lambda a, b: jnp.dot(*(x.astype(jnp.bfloat16) for x in (a, b)))
    )
    assert _doctor._products() > 1e-4


def test_sums_slopes_images_and_bits_that_are_wrong_are_found(monkeypatch):
    total = jnp.sum
    with monkeypatch.context() as wrong:
        wrong.setattr(jnp, "sum", lambda a, axis: total(a, axis=axis).at[0].set(0.0))
        assert _doctor.error_of_sums() > 1e-2
    with monkeypatch.context() as wrong:  # of ten times one
        factors = iter([1.0] * 4 + [np.nan] + [1.0] * 5)
        wrong.setattr(jax, "jit", lambda f: lambda *x: next(factors) * f(*x))
        assert np.isnan(_doctor.error_of_sums())
    monkeypatch.setattr(
        _doctor, "canopy_reflectance", lambda r, t, area, soil: soil * jax.lax.stop_gradient(area)
    )
    assert not _doctor._gradient() < 1e-2
    first = _doctor.observe

    def mixed_up(scene, camera, **options):
        seen = first(scene, camera, **options)
        return dataclasses.replace(seen, reflectance=seen.reflectance[::-1])

    monkeypatch.setattr(_doctor, "observe", mixed_up)
    assert _doctor._image() > 1e-2
    bits = jax.enable_x64(False)
    monkeypatch.setattr(_doctor.jax, "enable_x64", lambda _: bits)
    assert _doctor._double() > 1e-3


def test_a_folder_that_cannot_be_written_is_named(monkeypatch, tmp_path):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("JAX_COMPILATION_CACHE_DIR", str(tmp_path / "file"))
    check = _doctor._kept()
    assert not check.passed
    assert check.advice.startswith("set JAX_COMPILATION_CACHE_DIR to a folder")
    monkeypatch.delenv("JAX_COMPILATION_CACHE_DIR")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert _doctor._kept() == (
        "kept programs", True, str(tmp_path / "fynjax" / "jax"), _doctor._kept().advice
    )  # fmt: skip
    assert "XDG_CACHE_HOME" in _doctor._kept().advice


def test_sums_are_checked_by_the_first_command_of_a_version_alone(monkeypatch, tmp_path, capsys):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    asked = []
    monkeypatch.setattr(compiler, "error_of_sums", lambda: asked.append(1) or found)
    plant = ["plant", "Metalasia muricata", "--elements", "50", "--quiet"]

    def run(*options):
        with pytest.raises(SystemExit) as ended:
            main([*plant, "--output", str(tmp_path / "out"), *options])
        return ended.value.code, len(asked), capsys.readouterr().err

    found = float("nan")
    assert run("--dry-run")[:2] == (0, 0)
    for times in (1, 2):  # what is wrong is not forgotten
        code, count, said = run()
        assert (code, count) == (1, times)
        assert "wrong sums" in said
        assert "fynjax doctor" in said
    assert not (tmp_path / "out").exists()
    found = 1e-7
    assert run()[:2] == (0, 3)
    assert run()[:2] == (0, 3)
    monkeypatch.setattr(compiler, "version", lambda name: "99.0")
    assert run()[:2] == (0, 4)
