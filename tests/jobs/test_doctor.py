"""The doctor finds what is wrong with a backend, and says the way out."""

import jax.numpy as jnp
import pytest

from fynjax.cli import main
from fynjax.jobs import _doctor, doctor


@pytest.mark.parametrize(
    ("name", "change", "advice"),
    [
        ("_sums", lambda: 1.0, "XLA_FLAGS=--xla_cpu"),
        ("_double", lambda: 1.0, "JAX_PLATFORMS=cpu"),
        ("_gradient", lambda: float("nan"), "another version of JAX"),
    ],
)
def test_a_wrong_number_is_named_with_the_way_out(name, change, advice, monkeypatch, capsys):
    for other in ("_sums", "_products", "_image", "_gradient", "_double"):
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


def test_products_that_are_cut_short_and_slopes_that_are_wrong_are_found(monkeypatch):
    """As on a graphics card: factors of 10 bits."""
    assert _doctor._products() < 1e-5
    monkeypatch.setattr(
        _doctor.jnp, "matmul", lambda a, b: jnp.dot(*(x.astype(jnp.bfloat16) for x in (a, b)))
    )
    assert _doctor._products() > 1e-4


def test_this_machine_is_well():
    assert [check for check in doctor() if not check.passed] == []
