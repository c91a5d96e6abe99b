"""From the options of `fynjax validate` to the settings of a comparison of clouds."""

from collections.abc import Mapping
from dataclasses import fields, replace
from typing import Any

from fynjax._core.errors import InputError
from fynjax.compare.structure._options import ComparisonSettings
from fynjax.metrics import STRUCTURE_PRESETS, StructureSettings

_BOTH = ("tallest", "deepest", "tolerance")
"""Settings of how a cloud is read that are stated for both at once."""


def cloud_settings(preset: str | None, options: Mapping[str, Any]) -> ComparisonSettings:
    """Settings by a preset's name and single options, which override it; `None` is not stated.

    `options` by the names of `StructureSettings` and `ComparisonSettings`, besides `shift`,
    `real_ground`, `simulated_ground`, and those of reading that hold for both clouds.
    """
    if preset is not None and preset not in STRUCTURE_PRESETS:
        raise InputError(
            f"a preset of structure metrics (--structure-preset) must be one of "
            f"{', '.join(STRUCTURE_PRESETS)}, but is {preset!r}"
        )
    stated = {name: value for name, value in options.items() if value is not None}
    structure = STRUCTURE_PRESETS["fynjax" if preset is None else preset]
    names = {field.name for field in fields(StructureSettings)}
    changed = {name: stated.pop(name) for name in sorted(names & set(stated))}
    if changed:
        if structure.lowest == structure.diversity_lowest and "lowest" in changed:
            changed.setdefault("diversity_lowest", changed["lowest"])
        told = ", ".join(f"{name} {value}" for name, value in changed.items())
        structure = replace(structure, **changed, source=f"{structure.source}, but {told}")
    both = {name: stated.pop(name) for name in _BOTH if name in stated}
    settings = ComparisonSettings()
    reading = {
        side: replace(getattr(settings, side), ground=stated.pop(f"{side}_ground", "auto"), **both)
        for side in ("real", "simulated")
    }
    if "shift" in stated:
        stated["simulated_shift"] = stated.pop("shift")
    return replace(settings, structure=structure, **reading, **stated)
