"""Prints the lowest direct versions that pyproject.toml allows, as constraints for pip."""

import re
import tomllib
from pathlib import Path

ROOT = Path(__file__).parents[1]
project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
extras = project["optional-dependencies"]
every = {*project["dependencies"], *(r for e in extras.values() for r in e)}
for requirement in sorted(one for one in every if not one.startswith("fynjax[")):
    stated = re.match(r"([A-Za-z0-9._-]+)(?:\[.+\])?>=([0-9.]+)", requirement)
    if stated is None:
        raise SystemExit(f"pyproject.toml: '{requirement}' states no lowest version")
    marker = "".join(requirement.partition(";")[1:])
    print(f"{stated[1]}=={stated[2]}{marker}")
