"""What to cite for the models of a run."""

import tomllib
from pathlib import Path
from typing import Any

from fynjax._core.errors import InputError

_SOURCES: dict[str, dict[str, Any]] = tomllib.loads(
    Path(__file__).with_suffix(".toml").read_text("utf-8")
)


def _bibtex(key: str, **fields: Any) -> str:
    lines = [f"  {name} = {{{value}}}," for name, value in fields.items()]
    return "\n".join([f"@article{{{key},", *lines, "}"])


_TOGETHER: dict[str, tuple[str, ...]] = {
    "prospect": ("prospect", "prospect-5", "prospect-d", "prospect-pro"),
    "prospect-5": ("prospect", "prospect-5"),
    "prospect-d": ("prospect", "prospect-d"),
    "prospect-pro": ("prospect", "prospect-pro"),
}


def cite(*components: str) -> str:
    """BibTeX of the articles behind what was used.

    **Arguments:** `components`, such as "scene", "prospect", "prospect-d", "6s", "spctrl2",
    "shoots", "ground", "emcee" or "nuts"; all if none is given. "prospect" is every version, and
    one version brings the first article too.

    **Returns:** the entries, each once. Author lists of more than two are given as "and others".

    **Raises:** `InputError` for an unknown component.

    >>> import fynjax as fx
    >>> print(fx.cite("emcee").splitlines()[0])
    @article{foremanmackey2013,
    """
    wanted: dict[str, None] = {}
    for component in components or tuple(_SOURCES):
        name = component.lower()
        if name not in _SOURCES:
            raise InputError(
                f"`components` must be among {', '.join(_SOURCES)}, but one is {component!r}"
            )
        wanted |= dict.fromkeys(_TOGETHER.get(name, (name,)))
    return "\n\n".join(_bibtex(**_SOURCES[name]) for name in wanted)
