"""Which facets of the plants are of which material, and what their optics are."""

import dataclasses
from collections.abc import Callable, Collection, Mapping, Sequence
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np

from fynjax._core.errors import InputError, did_you_mean
from fynjax.canopy import FORMS, MeshPlant, Organ, PlantModel, Shrubland
from fynjax.leaf import LeafParameters
from fynjax.scene._parameters import LEAF_FIELDS, MaterialParameters
from fynjax.scene._species import (
    PETAL,
    SHRUB_LEAF,
    USUAL_LEAF,
    LeafRow,
    Material,
    SpeciesRow,
    usual_leaf,
)
from fynjax.scene._spectra import HIGHEST, LOWEST, Spectrum, background_spectrum

_AREA_INDICES = {"leaf_area_index": Organ.LEAF, "wood_area_index": Organ.WOOD}
_MOST_BEYOND = 0.1
"""Share of the wavelengths at which a stated spectrum may be beyond what a material can do."""
_ORGANS = {organ.name.lower() for organ in Organ}


ReadSpectrum = Callable[[Path, str, bool], Spectrum]
"""Reads the one spectrum of a file: takes what it is of besides, for errors, and whether it is
transmittance."""


@dataclasses.dataclass(frozen=True)
class PlantMaterials:
    """The materials of the plants of a plot, species by species."""

    species: tuple[tuple[Material, ...], ...]
    """Those of each species."""
    plants: tuple[PlantModel | None, ...]
    """Shape of each species' plants, whose elements say of which of these they are."""
    parameters: MaterialParameters | None
    """Traits of those that are as leaves; None where there are none."""


def plant_materials(
    species: Sequence[SpeciesRow],
    leaves: Sequence[LeafRow],
    plants: Sequence[MeshPlant | None],
    *,
    population: Shrubland = "fynbos",
    read: ReadSpectrum | None = None,
    file: Path | None = None,
) -> PlantMaterials:
    """What the plants of a plot are made of, by the rows of its leaf table that name materials.

    A facet of a mesh is of the material that it names, if a row describes it, or else of its organ:
    of the taxon's leaf, or of the materials "wood" and "flower", which also are those of generated
    plants; without a row for these, of the shipped bark and petals. Leaves of generated plants are
    of further materials as far as their rows state an `outer_fraction`. Traits that a row leaves
    out are those of a leaf row, of flowers those of the shipped petals.

    **Arguments:**

    - `species`: rows of the species table.
    - `leaves`: rows of the leaf table, without spectra to fit.
    - `plants`: the mesh of each species; None: generated plants.
    - `population`: whose usual leaves.
    - `read`: reads the files that the rows name.
    - `file`: of the leaf table, for errors.

    **Returns:** `PlantMaterials`. Species share the traits of a row of "*" for wood and flowers;
    those of leaves are a species' own, whose shoots hide and hold dead tissue in their own way.

    **Raises:** `InputError` for optics that a mesh states and no row describes, and for a row that
    describes nothing which the plants have.
    """
    rows = {(row.taxon, row.material): row for row in leaves if row.material}
    described = _Described(rows, read, population)
    of_species: list[tuple[Material, ...]] = []
    shapes: list[PlantModel | None] = []
    for one, mesh in zip(species, plants, strict=True):
        if mesh is None:
            # All of an organ is of the material that has its name.
            keys = [(kind, described.row(one, kind.name.lower())) for kind in Organ]
            of_species.append(
                (
                    *described.outer(one, file),
                    *(described.material(one, kind, key, 1.0) for kind, key in keys if key),
                )
            )
            shapes.append(None)
            continue
        organ, which = np.asarray(mesh.plant.organ), np.asarray(mesh.material)
        area = np.asarray(mesh.plant.area_fraction, float)
        element = np.full(len(organ), -1)
        found: list[Material] = []
        parts: dict[tuple[Organ, str], np.ndarray] = {}
        for k, names in enumerate(zip(mesh.materials, mesh.optics, strict=True)):
            if (mine := which == k).any():
                kind = Organ(int(organ[mine][0]))
                name = described.name(one, kind, *names)
                parts[kind, name] = parts.get((kind, name), False) | mine
        for (kind, name), mine in parts.items():
            if (key := described.row(one, name)) is None:
                continue
            if key[0] == one.taxon and rows[key].outer_fraction is not None:
                raise InputError(
                    f"{name!r} of {one.taxon!r} has an outer_fraction, but its mesh says where the "
                    "material is. Leave one of both out.",
                    file=file,
                    column="outer_fraction",
                )
            if name != kind.name.lower():  # else it is of its organ, as elements are
                element[mine] = len(found)
            found.append(described.material(one, kind, key, float(area[mine].sum())))
        of_species.append(tuple(found))
        several = (element >= 0).any()
        material = jnp.asarray(element, jnp.int32) if several else None
        shapes.append(dataclasses.replace(mesh.plant, material=material))
    described.check_used(species, plants, file)
    return PlantMaterials(tuple(of_species), tuple(shapes), described.parameters())


def check_leafy(plant: MeshPlant, form: str, **where: Any) -> None:
    """Raise `InputError` for a plant with leaves where its growth form has none, or the other way
    round.

    **Arguments:** `plant`; `form`, its growth form; `where`, the file, for errors.
    """
    leafy = FORMS[form].leafy
    if leafy != (float(plant.organ_area[Organ.LEAF]) > 0):
        raise InputError(
            f"expected a plant {'with' if leafy else 'without'} leaves for the growth form "
            f"{form!r}, but this one has {'none' if leafy else 'some'}. Do the names of its "
            "materials say what they are? `fynjax plant --materials` states them.",
            **where,
        )


def undescribed(optics: str, organ: str, described: Collection[str]) -> str:
    """What is wrong with the name `optics` of facets of an `organ`, which no row of a leaf table
    describes; `described` are those that there are."""
    there = [organ, *sorted(described)]
    return (
        f"nothing describes the optics {optics!r}: there is {', '.join(map(repr, there))}."
        f"{did_you_mean(optics, there)} Add a row with this material to the leaf table, or leave "
        f"the name empty: it is then as all {organ} of the taxon."
    )


_Key = tuple[str, str]
"""Taxon and material of a row of a leaf table."""


class _Described:
    """The materials that rows of a leaf table describe, and their optics as they are used."""

    def __init__(
        self, rows: Mapping[_Key, LeafRow], read: ReadSpectrum | None, population: Shrubland
    ) -> None:
        self._rows, self._read, self._population = rows, read, population
        self._used: set[_Key] = set()
        self._traits: dict[str, LeafRow] = {}
        self._files: dict[tuple[Path | str, bool], Spectrum] = {}
        self._spectra: list[bytes] = []

    def row(self, one: SpeciesRow, name: str) -> _Key | None:
        """The row of a material of a species, if there is one."""
        return next((k for k in ((one.taxon, name), ("*", name)) if k in self._rows), None)

    def outer(self, one: SpeciesRow, file: Path | None) -> list[Material]:
        """Materials of the leaves of generated plants of a species, from the outermost inwards in
        the order of their rows."""
        if not FORMS[one.growth_form].leafy:
            return []
        names = dict.fromkeys(name for taxon, name in self._rows if taxon in (one.taxon, "*"))
        found = []
        for key in (self.row(one, name) for name in names):
            share = None if key is None else self._rows[key].outer_fraction
            if key is not None and share is not None:
                found.append(self.material(one, Organ.LEAF, key, share))
        if (total := sum(one.share for one in found)) > 1.0 + 1e-9:
            raise InputError(
                f"the outer_fraction of {', '.join(m.name for m in found)} of {one.taxon!r} are "
                f"{total:g} together, more than all leaves",
                file=file,
                column="outer_fraction",
            )
        return found

    def name(self, one: SpeciesRow, organ: Organ, own: str, optics: str) -> str:
        """Name of the material of facets whose material in the mesh is `own`, with `optics`."""
        usual = organ.name.lower()
        if optics == usual:  # as no name
            return usual if self.row(one, own) is None else own
        if self.row(one, optics) is None:
            names = {name for taxon, name in self._rows if taxon in (one.taxon, "*")}
            raise InputError(undescribed(optics, usual, names), file=one.plant)
        return optics

    def material(self, one: SpeciesRow, organ: Organ, key: _Key, share: float) -> Material:
        """The material of a row, of which a share of an organ's area is."""
        row, name = self._rows[key], key[1]
        self._used.add(key)
        if row.reflectance is not None:
            through = row.transmittance
            pair = _physical(
                name,
                self._spectrum(row.reflectance, passed=False),
                None if through is None else self._spectrum(through, passed=True),
            )
            content = b"".join(b"" if s is None else s.values.tobytes() for s in pair)
            if content not in self._spectra:
                self._spectra.append(content)
            return Material(name, int(organ), share, self._spectra.index(content), *pair)
        # Shoots of a species hide their leaves, and hold dead tissue, in their own way.
        own = key[0] != "*" or organ == Organ.LEAF
        prefix = f"species.{one.taxon}.{name}" if own else f"material.{name}"
        self._traits.setdefault(prefix, self._filled(row, organ, one))
        return Material(name, int(organ), share, list(self._traits).index(prefix))

    def parameters(self) -> MaterialParameters | None:
        """Traits of the materials that were used."""
        rows = self._traits.values()
        if not rows:
            return None
        traits = {name: np.array([getattr(row, name) for row in rows]) for name in LEAF_FIELDS}
        return MaterialParameters(tuple(self._traits), LeafParameters.many(**traits))

    def check_used(
        self, species: Sequence[SpeciesRow], plants: Sequence[MeshPlant | None], file: Path | None
    ) -> None:
        """Raise `InputError` for a row that describes nothing which the plants have."""
        for taxon, name in self._rows:
            if (taxon, name) in self._used:
                continue
            there: set[str] = set()
            for one, mesh in zip(species, plants, strict=True):
                if taxon not in (one.taxon, "*"):
                    continue
                pairs = [] if mesh is None else zip(mesh.materials, mesh.optics, strict=True)
                named = {own if optics in _ORGANS else optics for own, optics in pairs}
                there |= named if mesh is not None else _ORGANS - {"leaf"}
            grown = self._rows[taxon, name].outer_fraction is None and any(
                mesh is None and FORMS[one.growth_form].leafy
                for one, mesh in zip(species, plants, strict=True)
                if taxon in (one.taxon, "*")
            )
            remedy = " Leaves of plants without a mesh need its outer_fraction." if grown else ""
            raise InputError(
                f"{name!r} of {taxon!r} is no material of its plants, which have "
                f"{', '.join(map(repr, sorted(there)))}.{did_you_mean(name, there)}{remedy}",
                file=file,
                column="material",
            )

    def _filled(self, row: LeafRow, organ: Organ, one: SpeciesRow) -> LeafRow:
        if organ == Organ.LEAF:
            return row.filled(usual_leaf(one.growth_form, self._population))
        if organ == Organ.WOOD:
            return row.filled(USUAL_LEAF if self._population == "fynbos" else SHRUB_LEAF)
        unset = {n: v for n, v in PETAL.items() if n not in row.model_fields_set}
        return row.replace(**unset)

    def _spectrum(self, what: Path | str | Spectrum, *, passed: bool) -> Spectrum:
        if isinstance(what, Spectrum):
            return what
        if (what, passed) not in self._files:
            if isinstance(what, Path):
                assert self._read is not None  # whoever takes files can read them
                found = self._read(what, "material", passed)
            else:
                grid = np.arange(LOWEST, HIGHEST + 1.0)
                found = Spectrum.of(grid, background_spectrum(what, grid), "a shipped spectrum")
            self._files[what, passed] = found
        return self._files[what, passed]


def _physical(
    name: str, reflectance: Spectrum, transmittance: Spectrum | None
) -> tuple[Spectrum, Spectrum | None]:
    """The spectra of a material that makes no light: single values beyond 0 and 1, as of field
    spectra where water takes the sunlight, are cut. Raises `InputError` where they are many."""
    r = reflectance.values
    t = np.zeros_like(r) if transmittance is None else transmittance.values
    beyond = np.mean((r < 0.0) | (t < 0.0) | (r + t > 1.0 + 1e-6))
    if beyond > _MOST_BEYOND:
        raise InputError(
            f"expected reflectance and transmittance of {name!r} of 0 or more, together at most 1, "
            f"but at {100 * beyond:.0f} % of the wavelengths they are not",
            file=reflectance.file,
        )
    r = np.clip(r, 0.0, 1.0)
    cut = dataclasses.replace(reflectance, values=r)
    if transmittance is None:
        return cut, None
    return cut, dataclasses.replace(transmittance, values=np.clip(t, 0.0, 1.0 - r))


def with_areas(row: SpeciesRow, plant: MeshPlant | None) -> SpeciesRow:
    """The species with the area indices of its plant where its table states none.

    **Arguments:** `row`, of the species table; `plant`, its mesh; None: a generated plant.
    """
    if plant is None:
        return row
    # Areas over that of the crown, as the tables state them.
    crown = np.pi / 4.0 * plant.modelled_diameter**2
    own = {name: float(plant.organ_area[organ]) / crown for name, organ in _AREA_INDICES.items()}
    return row.replace(**{n: v for n, v in own.items() if getattr(row, n) is None})
