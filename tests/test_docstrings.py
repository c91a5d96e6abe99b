"""Docstrings of public names: they name every parameter, and the examples in them run."""

import doctest
import importlib
import inspect
import pkgutil
import re
from collections.abc import Callable
from typing import Any

import jax
import numpy as np
import pytest

import fynjax
import fynjax.radiation

COMPLETE = (
    "fynjax.app.assembly",
    "fynjax.canopy",
    "fynjax.app.compare",
    "fynjax.diversity",
    "fynjax.inversion",
    "fynjax.app.io",
    "fynjax.app.jobs",
    "fynjax.leaf",
    "fynjax.metrics",
    "fynjax.radiation",
    "fynjax.app.report",
    "fynjax.scene",
    "fynjax.sensors",
    "fynjax.studies",
    "fynjax.app.terrain",
)
"""Packages, with those inside them, in which every public function documents its parameters."""

_DECIMAL = re.compile(r"-?\d+\.\d*")


class _Checker(doctest.OutputChecker):
    """Decimal numbers agree to a unit of the last digit written, all else but blanks exactly."""

    def check_output(self, want: str, got: str, optionflags: int) -> bool:
        written, printed = _DECIMAL.findall(want), _DECIMAL.findall(got)
        if len(written) == len(printed):
            close = all(
                abs(float(a) - float(b)) <= 1.01 * 10.0 ** -len(a.partition(".")[2])
                for a, b in zip(written, printed, strict=True)
            )
            frame, printed_frame = (
                "".join(_DECIMAL.sub("#", text).split()) for text in (want, got)
            )
            if close and frame == printed_frame:
                return True
        return super().check_output(want, got, optionflags)


def _exported() -> dict[str, Any]:
    """Functions and classes by the full name in their package, each once: public ones, and those
    that a package has for others."""
    names = [
        module.name
        for module in pkgutil.walk_packages(fynjax.__path__, "fynjax.")
        if module.ispkg and "._" not in module.name
    ]
    names.append("fynjax")
    objects = {}
    for name in names:
        package = importlib.import_module(name)
        for exported in {**dict.fromkeys(getattr(package, "__all__", ())), **vars(package)}:
            value = None if exported[0] == "_" else getattr(package, exported)
            own = (getattr(value, "__module__", None) or "").startswith("fynjax.")
            if own and (inspect.isroutine(value) or inspect.isclass(value)):
                objects.setdefault(id(value), (f"{name}.{exported}", value))
    return dict(objects.values())


EXPORTED = _exported()


def _members(value: Any) -> dict[str, Any]:
    """Methods and properties of a class, by name; nothing of a function."""
    return (
        {n: getattr(m, "__func__", m) for n, m in vars(value).items()}
        if inspect.isclass(value)
        else {}
    )


_EVERY = EXPORTED | {
    f"{name}.{member}": what
    for name, value in EXPORTED.items()
    for member, what in _members(value).items()
    if inspect.isroutine(what) or isinstance(what, property)
}
EXAMPLES = {n: value for n, value in _EVERY.items() if ">>>" in (inspect.getdoc(value) or "")}


def _unnamed(function: Callable[..., Any]) -> list[str]:
    """Parameters that a function's docstring does not name in backticks."""
    text = inspect.getdoc(function) or ""
    names = inspect.signature(function).parameters
    return [name for name in names if not re.search(rf"`{name}\b", text)]


@pytest.mark.parametrize("package", COMPLETE)
def test_every_public_function_documents_its_parameters(package):
    functions = {
        name: value
        for name, value in EXPORTED.items()
        if name.startswith(f"{package}.") and inspect.isroutine(value)
    }
    assert len(functions) >= 10
    missing = {name: _unnamed(value) for name, value in functions.items() if _unnamed(value)}
    assert not missing


def test_a_parameter_that_is_not_documented_is_noticed():
    def area(width, height):
        """Area [m2] of `width` times the other side [m]."""

    assert _unnamed(area) == ["height"]


@pytest.fixture(scope="module")
def solved_light():
    """`solve_light` that remembers: the examples share a scene, and need not solve it each."""
    solve, lights = fynjax.radiation.solve_light, []

    def remembered(scene, accuracy=None):
        if accuracy is not None:
            return solve(scene, accuracy)
        parts, form = jax.tree.flatten(scene)
        for other_parts, other_form, light in lights:
            if form == other_form and all(map(np.array_equal, parts, other_parts)):
                return light
        lights.append((parts, form, solve(scene)))
        return lights[-1][-1]

    return remembered


def _failures(name: str, value: Any) -> str:
    """What the examples of a docstring print that they should not; empty if all is well."""
    runner = doctest.DocTestRunner(
        checker=_Checker(), optionflags=doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE
    )
    text = inspect.getdoc(value) or ""
    output: list[str] = []
    examples = doctest.DocTestParser().get_doctest(text, {}, name, None, 0)
    with jax.enable_x64(False):  # as who reads them runs them
        runner.run(examples, out=output.append)
    return "".join(output)


@pytest.mark.parametrize("name", EXAMPLES)
def test_the_examples_run(name, solved_light, monkeypatch):
    monkeypatch.setattr(fynjax.radiation, "solve_light", solved_light)
    value = EXAMPLES[name]
    assert not _failures(name, value)


def test_an_example_with_a_wrong_number_fails():
    def third():
        """A third.

        >>> 1.0 / 3.0
        0.36
        """

    assert "0.33333" in _failures("third", third)
    third.__doc__ = ">>> 1.0 / 3.0\n0.333\n"
    assert not _failures("third", third)
