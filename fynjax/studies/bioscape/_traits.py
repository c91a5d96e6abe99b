"""The trait library of BioSCape: what was measured of a species, and what is nearest to it."""

import difflib
import re
import warnings
from collections import defaultdict
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from fynjax._core.errors import InputError
from fynjax.studies.bioscape._assumed import DEFAULT_TRAITS, OLD_GENERA, plant_shape
from fynjax.studies.bioscape._tables import TraitRow

TRAITS = {
    "leaf_mass_per_area": "Mean_Leaf_Mass_Per_Area",
    "water_content": "Mean_Water_Content",
    "nitrogen": "Mean_Nitrogen",
    "carbon": "Mean_Carbon",
}
"""Traits and their columns in the library."""

SOURCES = ("measured", "genus mean", "family mean", "growth form mean", "growth form default")
"""Where a trait can come from; the first that has a value is taken."""

_SAME_GENUS, _SAME_EPITHET = 0.85, 0.88
"""Names this similar (difflib's ratio) are spellings of one name."""


@dataclass(frozen=True)
class Sourced:
    """A value and where it came from."""

    value: float
    source: str
    """Source of the value: one of `SOURCES`."""


def split_name(name: str) -> tuple[str, str]:
    """Genus, as the tables use it, and epithet of a name; '' for 'sp.' and the like.

    Authors, subspecies and marks of hybrids fall away: `Rhus lucida L.` gives Searsia, lucida.
    """
    words = [w for w in re.split(r"[\s_]+", name.strip()) if w.lower() not in ("x", "×", "cf.")]
    genus = words[0].capitalize() if words else ""
    epithet = words[1].lower() if len(words) > 1 else ""
    if not re.fullmatch(r"[^\W\d_]{3,}(-[^\W\d_]+)?", epithet) or epithet in ("spp", "indet"):
        epithet = ""
    return OLD_GENERA.get(genus, genus), epithet


def _stem(epithet: str) -> str:
    """An epithet without its ending, which follows the gender of the genus."""
    return re.sub(r"(us|um|a|is|e)$", "", epithet)


class TraitLibrary:
    """Measured traits by species, and their means by genus, family and growth form."""

    def __init__(self, rows: Iterable[tuple[int, TraitRow]], path: Path) -> None:
        self._species: dict[tuple[str, str], TraitRow] = {}
        self._family: dict[str, str] = {}
        row_of: dict[tuple[str, str], int] = {}
        for where, row in rows:
            genus, epithet = split_name(row.GenusSpecies)
            key = genus, _stem(epithet)
            before = self._species.get(key)
            if before is not None and any(
                getattr(before, column) != getattr(row, column) for column in TRAITS.values()
            ):
                raise InputError(
                    f"{row.GenusSpecies!r} is there twice with other traits, first in row "
                    f"{row_of[key]}. Keep one row.",
                    file=path,
                    row=where,
                    column="GenusSpecies",
                )
            if before is None:
                self._species[key], row_of[key] = row, where
                self._family.setdefault(genus, row.Family)
        groups: dict[tuple[str, str, str], list[float]] = defaultdict(list)
        for (genus, _), row in self._species.items():
            form = plant_shape(genus, row.Family).growth_form
            for trait, column in TRAITS.items():
                if (value := getattr(row, column)) is not None:
                    groups["genus mean", genus, trait].append(value)
                    groups["family mean", row.Family, trait].append(value)
                    groups["growth form mean", form, trait].append(value)
        self._means = {key: sum(values) / len(values) for key, values in groups.items()}

    def family(self, genus: str) -> str:
        """Family of a genus, '' if the library does not have it."""
        return self._family.get(genus, "")

    def lookup(self, name: str, family: str) -> tuple[dict[str, Sourced], str | None]:
        """Traits of a species, each from the nearest source, and its name in the library.

        The name is `None` where the library does not have the species; a slip of spelling is
        forgiven, with a warning. Leaf mass per area and water content are always there.
        """
        genus, epithet = split_name(name)
        row = self._species.get((genus, _stem(epithet))) if epithet else None
        if row is None and epithet:
            row = self._respelled(name, genus, epithet)
        if row is not None:
            genus = split_name(row.GenusSpecies)[0]
        form = plant_shape(genus, family).growth_form
        groups = {"genus mean": genus, "family mean": family, "growth form mean": form}
        traits: dict[str, Sourced] = {}
        for trait, column in TRAITS.items():
            values = {"measured": None if row is None else getattr(row, column)}
            values |= {kind: self._means.get((kind, g, trait)) for kind, g in groups.items()}
            values["growth form default"] = DEFAULT_TRAITS.get(trait)
            for source in SOURCES:
                if (value := values[source]) is not None:
                    traits[trait] = Sourced(value, source)
                    break
        return traits, None if row is None else " ".join(row.GenusSpecies.split())

    def _respelled(self, name: str, genus: str, epithet: str) -> TraitRow | None:
        def similar(a: str, b: str) -> float:
            return difflib.SequenceMatcher(None, a, b).ratio()

        near = []
        for row in self._species.values():
            other_genus, other_epithet = split_name(row.GenusSpecies)
            match = similar(epithet, other_epithet)
            if similar(genus, other_genus) >= _SAME_GENUS and match >= _SAME_EPITHET:
                near.append((match, row))
        if not near:
            return None
        row = max(near, key=lambda pair: pair[0])[1]
        warnings.warn(
            f"{name!r} is not in the trait library; it is read as {row.GenusSpecies!r}.",
            stacklevel=4,
        )
        return row
