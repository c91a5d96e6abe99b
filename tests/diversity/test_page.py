"""The page on diversity: its code runs, and it names what there is."""

import re
from pathlib import Path

import fynjax as fx

PAGE = (Path(__file__).resolve().parents[2] / "docs" / "diversity.md").read_text("utf-8")


def test_the_code_of_the_page_runs() -> None:
    (source,) = re.findall(r"^```python\n(.*?)^```$", PAGE, re.M | re.S)
    names: dict = {}
    exec(compile(source, "docs/diversity.md", "exec"), names)
    assert names["variety"].sizes == {"y": 4, "x": 4}
    assert names["slope"].shape == (2, 4)


def test_every_function_is_on_the_page() -> None:
    functions = {name for name in fx.diversity.__all__ if name.islower()}
    assert len(functions) > 25
    assert not {name for name in functions if f"`{name}`" not in PAGE}
