"""The job of `fynjax identify`: what a file is taken for, by the readers that all commands use."""

import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from pyproj import Transformer

from fynjax._core.errors import InputError, MissingExtraError
from fynjax._core.files import existing_file
from fynjax.app.io.plot import raster_place, read_plot, read_releve
from fynjax.app.io.raster import open_blocks, open_image
from fynjax.app.io.spectra import MeasuredSpectrum, usable_spectra
from fynjax.app.io.text import read_rows
from fynjax.app.jobs._result import Record
from fynjax.app.terrain import CLOUD_SUFFIXES, is_normalised, read_cloud
from fynjax.canopy import read_plant_mesh
from fynjax.canopy.mesh import default_up, organ_of_name
from fynjax.scene import SpeciesRow

_CUBES = (".nc", ".nc4", ".h5", ".hdf5", ".zarr")
_RASTERS = (".tif", ".tiff", ".img", ".asc", ".hgt", ".bil", ".bsq", ".bip", ".dat", ".png", ".jpg")
_MESHES = (".obj", ".stl", ".glb", ".gltf")
_MOST = 5
"""Spectra, and doubts of them, that are named."""


class Rejected(Record):
    """What a file was not taken for, and why."""

    kind: str
    reason: str


class Identified(Record):
    """What a file was taken for."""

    file: str
    kind: str
    """'leaf spectra', 'image', 'cube', 'point cloud', 'plant mesh', 'plot file', 'species table',
    or 'table of plants' in other words; 'unknown' where no reader takes it."""
    facts: dict[str, str]
    """What is known of it: format, layout, unit, quantity, place, number and others."""
    evidence: list[str]
    """What was repaired or taken, in sentences."""
    rejected: list[Rejected]
    """Other kinds that were tried first, and why it is none of them."""


def identify(path: str | Path) -> Identified:
    """What a file is taken for: kind, format, layout, unit, quantity, place and number, with the
    evidence, and what was rejected.

    The file is opened by the readers that all commands use, so that the verdict is theirs.

    **Arguments:** `path`: a file of spectra, an image, a cube, a point cloud, a plot file or a
    table of plants.

    **Returns:** `Identified`; its kind is "unknown" where no reader takes the file.

    **Raises:** `InputError` for a file that is missing.
    """
    path = Path(path)
    path = path if path.suffix.lower() == ".zarr" else existing_file(path, "a file")
    rejected = []
    for kind, look in _candidates(path):
        try:
            with _heard() as heard:
                facts, evidence = look(path)
        except (InputError, MissingExtraError) as error:
            reason = error.message if isinstance(error, InputError) else str(error)
            rejected.append(Rejected(kind=kind, reason=reason))
            continue
        return Identified(
            file=str(path), kind=kind, facts=facts, evidence=[*evidence, *heard], rejected=rejected
        )
    return Identified(file=str(path), kind="unknown", facts={}, evidence=[], rejected=rejected)


_Look = Callable[[Path], tuple[dict[str, str], list[str]]]


def _candidates(path: Path) -> list[tuple[str, _Look]]:
    """Kinds that a file may be of, the likeliest first."""
    suffix = path.suffixes[-2].lower() if path.suffix.lower() == ".gz" and path.suffixes[1:] else (
        path.suffix.lower()
    )  # fmt: skip
    kinds: dict[str, _Look] = {
        "plot file": _plot,
        "cube": _cube,
        "image": _image,
        "point cloud": _cloud,
        "plant mesh": _mesh,
        "leaf spectra": _spectra,
        "species table": _species,
        "table of plants": _plants,
    }
    order = {
        **dict.fromkeys((".toml",), ("plot file",)),
        **dict.fromkeys(_CUBES, ("cube",)),
        **dict.fromkeys(_RASTERS, ("image", "leaf spectra")),
        **dict.fromkeys(CLOUD_SUFFIXES, ("point cloud",)),
        **dict.fromkeys(_MESHES, ("plant mesh",)),
        **dict.fromkeys((".hdr", ".sli", ".slb"), ("leaf spectra", "image")),
    }.get(suffix, ("leaf spectra", "species table", "table of plants", "point cloud"))
    if suffix in CLOUD_SUFFIXES[:-1]:
        order = ("point cloud", "plant mesh") if suffix == ".ply" else ("point cloud",)
    return [(kind, kinds[kind]) for kind in order]


@contextmanager
def _heard() -> Iterator[list[str]]:
    """The warnings of a block, once each, as sentences."""
    said: list[str] = []
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        yield said
        said += dict.fromkeys(" ".join(str(one.message).split()) for one in caught)


def _many(values: np.ndarray, unit: str) -> str:
    """Numbers of bands in words: how many, from where to where."""
    known = values[np.isfinite(values)]
    if not known.size:
        return "not stated"
    return f"{known.min():g} to {known.max():g} {unit}"


def _spectra(path: Path) -> tuple[dict[str, str], list[str]]:
    read, refused = usable_spectra([path], None, detector_changes=())
    usable = [spectrum for _, spectrum in read]
    first = usable[0]
    named = ", ".join(s.name for s in usable[:_MOST]) + (" ..." if len(usable) > _MOST else "")
    facts = {
        "format": str(first.meta.get("format", "")),
        "layout": str(first.meta.get("layout", "")),
        "quantity": ", ".join(_quantities(usable)),
        "spectra": f"{len(usable)}: {named}",
        "bands": f"{first.wavelength.size}, {_many(first.wavelength, 'nm')}",
        "values": _values(usable),
    }
    doubts = {s.meta.get("doubtful") for s in usable}
    repairs = dict.fromkeys(one for s in usable for one in s.meta["repairs"])
    evidence = [one for one in repairs if one not in doubts]
    evidence += [f"{s.name}: {s.meta['doubtful']}" for s in usable if "doubtful" in s.meta][:_MOST]
    evidence += [f"refused: {name}: {error.message}" for _, name, error in refused[:_MOST]]
    return {key: value for key, value in facts.items() if value}, evidence


def _quantities(spectra: list[MeasuredSpectrum]) -> list[str]:
    counts = {
        "reflectance": sum(s.reflectance is not None for s in spectra),
        "transmittance": sum(s.transmittance is not None for s in spectra),
    }
    return [f"{name} of {count}" for name, count in counts.items() if count]


def _values(spectra: list[MeasuredSpectrum]) -> str:
    both = [v for s in spectra for v in (s.reflectance, s.transmittance) if v is not None]
    return f"fractions, {min(map(np.nanmin, both)):.3g} to {max(map(np.nanmax, both)):.3g}"


def _image(path: Path) -> tuple[dict[str, str], list[str]]:
    with open_image(path, "an image") as file:
        place = raster_place(file)
        names = [file.names[n - 1] for n in file.bands]
        facts = {
            "format": str(file.dataset.driver),
            "size": f"{file.shape[1]} x {file.shape[0]} pixels",
            "bands": f"{len(file.bands)}: {', '.join(name or '(no name)' for name in names[:8])}",
            "wavelengths": _many(file.wavelengths[np.array(file.bands) - 1], "nm"),
            "quantity": "counts of a camera"
            if file.is_raw_capture
            else f"{file.dataset.dtypes[0]}",
            "system": "none" if file.crs is None else file.crs.to_string()[:60],
            "place": _place_in_words(place),
        }
        evidence = []
        try:
            pixel = file.pixel_m
            facts["pixel"] = "not stated" if pixel is None else f"{pixel:.4g} m"
        except InputError as error:
            evidence.append(error.message)
        return facts, evidence


def _place_in_words(place: tuple[float, float] | None) -> str:
    return "none" if place is None else f"latitude {place[0]:.4f}, longitude {place[1]:.4f}"


def _cube(path: Path) -> tuple[dict[str, str], list[str]]:
    with open_blocks(path) as cube:
        t, place = cube.transform, None
        if cube.crs is not None and not t.is_identity:
            x, y = t @ (0.5 * cube.shape[1], 0.5 * cube.shape[0])
            east, north = Transformer.from_crs(cube.crs, 4326, always_xy=True).transform(x, y)
            place = float(north), float(east)
        turned = ", turned" if t.b or t.d else ""
        return {
            "format": path.suffix.lower().lstrip("."),
            "size": f"{cube.shape[1]} x {cube.shape[0]} pixels",
            "bands": f"{cube.wavelength.size}, {_many(cube.wavelength, 'nm')}",
            "quantity": f"reflectance, stored times {1.0 / cube.scale():g}",
            "pixel": "not stated" if t.is_identity else f"{abs(t.a):g} by {abs(t.e):g}{turned}",
            "place": _place_in_words(place),
        }, []


def _cloud(path: Path) -> tuple[dict[str, str], list[str]]:
    cloud = read_cloud(path)
    west, south, east, north = cloud.bounds
    above = is_normalised(cloud)
    return {
        "format": path.suffix.lower().lstrip("."),
        "points": f"{len(cloud)}",
        "unit": "metres",
        "extent": f"{east - west:.4g} by {north - south:.4g} m, heights {cloud.z.min():.4g} to "
        f"{cloud.z.max():.4g} m",
        "heights": "above the ground, by their lowest points" if above else "above a datum",
        "classes": "none" if cloud.classification is None else "yes",
        "system": "none stated" if cloud.crs is None else cloud.crs[:60],
    }, []


def _mesh(path: Path) -> tuple[dict[str, str], list[str]]:
    mesh = read_plant_mesh(path)
    extent = " by ".join(f"{side:.4g}" for side in np.ptp(mesh.vertices, axis=0))
    organs = [
        f"{name!r} {'no organ' if (organ := organ_of_name(name)) is None else organ.name.lower()}"
        f", {'closed' if mesh.is_closed(name) else 'sheets or open'}, {area:.4g} m2"
        for name, area in zip(mesh.materials, mesh.material_area)
    ]
    return {
        "format": path.suffix.lower().lstrip("."),
        "triangles": f"{len(mesh.faces)}",
        "extent": f"{extent} in its unit, vertical axis {default_up(path)}",
        "materials": "; ".join(organs[:_MOST]),
    }, []


def _plot(path: Path) -> tuple[dict[str, str], list[str]]:
    plot = read_plot(path, allow_outside=True)
    return {
        "format": "plot file of fynjax",
        "plot": f"{plot.name}, {plot.size_m[0]:g} by {plot.size_m[1]:g} m",
        "species": f"{len(plot.species)}",
        "plants": plot.shrubland,
        "sensor": plot.sensor.name,
        "place": _place_in_words(plot.place_deg),
    }, []


def _species(path: Path) -> tuple[dict[str, str], list[str]]:
    rows = [row for _, row in read_rows(path, SpeciesRow, "a species table")]
    return {
        "format": "species table of fynjax",
        "species": f"{len(rows)}",
        "cover": f"{100 * sum(row.cover for row in rows):.4g} % in sum",
    }, []


def _plants(path: Path) -> tuple[dict[str, str], list[str]]:
    releve = read_releve(path)
    return {
        "format": "table, a row a plant",
        "plants": f"{len(releve.plants)}",
        "cover": f"{100 * sum(p.record.cover for p in releve.plants):.4g} % in sum",
        "notes": ", ".join(releve.note_columns) or "none",
    }, list(releve.said)
