"""The code does not grow past its measures (`tests/measures.py`)."""

import ast
import subprocess
import sys

import pytest

from tests import measures
from tests.measures import MEASURES, PREDICTION


@pytest.fixture(scope="module")
def modules() -> measures.Trees:
    return measures.trees()


@pytest.mark.parametrize("name", MEASURES)
def test_no_measure_rises(name, modules):
    measure = MEASURES[name]
    counted = measure.counted(modules)
    shown = "" if isinstance(counted, int) else "\n".join(counted)
    assert measure.value(modules) <= measure.bound, shown
    assert measure.value(modules) > 0 or measure.bound == 0  # else nothing is counted


@pytest.mark.slow
def test_a_prediction_enters_few_modules():
    code = "from tests import measures; print(*measures.prediction_modules())"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    entered = done.stdout.split()
    assert {"radiation._ordinates", "scene._observe", "inversion._views"} <= set(entered)
    assert len(entered) <= PREDICTION, entered


def test_what_is_counted_is_found():
    """In sources of which the count is known."""
    twice = {name: ast.parse("def one(): ...\nclass _Own: ...") for name in ("leaf/a.py", "b.py")}
    assert measures.names_of_two(twice) == ["one: b.py, leaf/a.py"]
    assert measures.names_of_two({**twice, "b.py": ast.parse("")}) == []
    body = "\n    x = 0" * 81
    long = (
        f"class One:\n  def f(self):\n    'Text.'{body}\n\ndef g(a, b, c, d, *, e, f, g, h, i): ..."
    )
    assert [
        line.split(": ")[1] for line in measures.large_functions({"m.py": ast.parse(long)})
    ] == ["One.f, 81 lines, 0 arguments", "g, 1 lines, 9 arguments"]
    assert (
        measures.large_functions({"app/cli/m.py": ast.parse("def g(a,b,c,d,e,f,g,h,i): 0")}) == []
    )
    record = ast.parse("class Rules:\n    spacing: float\n    spacing_m: float\n    room: float")
    places = measures.places_of_keys({"scene/a.py": record, "radiation/b.py": record})
    assert places == ["scene/a.py: Rules.spacing", "scene/a.py: Rules.spacing_m"]
    room = "from fynjax.scene._a import b, c, d as e\nimport jax\n__all__ = ['b']"
    rooms = {"scene/__init__.py": ast.parse(room), "app/io/__init__.py": ast.parse(room)}
    found = measures.names_between_rooms(rooms)
    assert found == ["scene/__init__.py: c", "scene/__init__.py: e"]
