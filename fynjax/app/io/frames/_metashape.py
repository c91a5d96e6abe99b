"""Metashape: `cameras.xml` (Agisoft Metashape User Manual, appendix on camera models).

A camera's transform leads from its own axes (right, down, ahead) to those of its chunk or of its
component, whose transform leads on to geocentric coordinates. Principal points count from the
middle of the picture.
"""

import functools
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import numpy as np
import pyproj
from jaxtyping import Float

from fynjax._core.errors import InputError, listed, refusing
from fynjax._core.tables import as_utf8
from fynjax.app.io.frames._shot import Shot, finite
from fynjax.app.io.text import read_bytes
from fynjax.sensors import Lens


def metashape_shots(path: Path) -> list[Shot]:
    """Shots of the cameras that were aligned."""
    text = as_utf8(read_bytes(path), path).decode()
    if "<!DOCTYPE" in text or "<!ENTITY" in text:
        raise InputError("expected cameras of Metashape without entities, but it defines some")
    with refusing(ElementTree.ParseError, words="expected XML, but it is damaged ({error})"):
        root = ElementTree.fromstring(text)
    chunks = [chunk for chunk in root.iter("chunk") if chunk.find("cameras") is not None]
    if len(chunks) != 1:
        raise InputError(
            f"expected one chunk with cameras, as Metashape exports it, but got {len(chunks)}"
        )
    chunk = chunks[0]
    system = _system(chunk)
    lenses = {sensor.get("id"): sensor for sensor in chunk.iterfind("sensors/sensor")}
    components = {part.get("id"): part for part in chunk.iterfind("components/component")}
    shots = []
    for camera in chunk.iterfind("cameras//camera"):
        stated = camera.find("transform")
        if stated is None:
            continue  # not aligned, or a further band of one that is
        name = camera.get("label", camera.get("id", "?"))
        sensor = lenses.get(camera.get("sensor_id"))
        if sensor is None:
            raise InputError(
                f"expected the sensor of {name}, {camera.get('sensor_id')!r}, but there are "
                f"{listed(map(str, lenses)) or 'none'}"
            )
        owner = components.get(camera.get("component_id"), chunk)
        place = owner.find("transform")
        if place is None:
            place = chunk.find("transform")
        if place is None:
            raise InputError(
                "expected a chunk that is georeferenced, but it has no 'transform': its cameras "
                "are in a frame of their own"
            )
        shots.append(_shot(name, stated, place, _lens(sensor), system))
    return shots


def _values(element: ElementTree.Element, count: int, what: str) -> Float[np.ndarray, " value"]:
    return finite((element.text or "").replace(",", " ").split(), count, what)


def _system(chunk: ElementTree.Element) -> pyproj.CRS:
    """The geographic system of a chunk."""
    text = (chunk.findtext("reference") or "").strip()
    try:
        system = pyproj.CRS.from_user_input(text)
    except (pyproj.exceptions.CRSError, RecursionError, ValueError) as error:
        raise InputError(
            f"expected the chunk's reference system as WKT, but got {text[:60]!r}"
        ) from error
    if system.geodetic_crs is None:
        raise InputError(
            f"expected a chunk with a place on Earth, but its system is {system.name[:60]!r}"
        )
    return system.geodetic_crs.to_2d()


def _lens(sensor: ElementTree.Element) -> Lens:
    name = f"sensor {sensor.get('label', sensor.get('id'))}"
    found = sensor.findall("calibration")
    adjusted = [c for c in found if c.get("class") == "adjusted"] or found
    if not adjusted:
        raise InputError(f"expected a calibration of {name}, but there is none: was it aligned?")
    numbers = adjusted[0]
    kind = numbers.get("type", sensor.get("type", "frame"))
    if kind not in ("frame", "fisheye"):
        raise InputError(f"expected a lens of type frame or fisheye, but {name} is {kind!r}")
    size = numbers.find("resolution")
    if size is None:
        size = sensor.find("resolution")
    sides = (None, None) if size is None else (size.get("width"), size.get("height"))
    columns, rows = (int(finite([side], 1, f"the resolution of {name}")[0]) for side in sides)

    def number(key: str, default: str | None = "0") -> float:
        return float(finite([numbers.findtext(key, default)], 1, f"'{key}' of {name}")[0])

    focal = number("f", None)
    return Lens(
        (columns, rows),
        (focal + number("b1"), focal),
        (0.5 * (columns - 1) + number("cx"), 0.5 * (rows - 1) + number("cy")),
        tuple(number(f"k{k}") for k in (1, 2, 3, 4)),
        # Its p1 is of columns, where OpenCV's is of rows.
        (number("p2"), number("p1")),
        number("b2"),
        kind == "fisheye",
    )


def _shot(
    name: str,
    stated: ElementTree.Element,
    place: ElementTree.Element,
    lens: Lens,
    system: pyproj.CRS,
) -> Shot:
    camera = _values(stated, 16, f"the transform of {name}").reshape(4, 4)
    parts = {}
    for key, count in (("rotation", 9), ("translation", 3), ("scale", 1)):
        part = place.find(key)
        if part is None:
            raise InputError(f"expected the chunk's transform with {key!r}, but it has none")
        parts[key] = _values(part, count, f"the {key} of the chunk")
    turn = parts["rotation"].reshape(3, 3)
    centre = parts["scale"] * (turn @ camera[:3, 3]) + parts["translation"]
    longitude, latitude, height = _from_geocentric(system).transform(*centre)
    (sl, cl), (sp, cp) = ((np.sin(a), np.cos(a)) for a in np.radians([longitude, latitude]))
    local = np.array([[-sl, cl, 0.0], [-sp * cl, -sp * sl, cp], [cp * cl, cp * sl, sp]])
    axes = (local @ turn @ camera[:3, :3]).T
    return Shot(name, np.array([longitude, latitude, height]), axes, lens, system)


@functools.cache
def _from_geocentric(system: pyproj.CRS) -> pyproj.Transformer:
    """What takes geocentric coordinates on the ellipsoid of a system to longitude, latitude and
    height."""
    ellipsoid = system.ellipsoid
    assert ellipsoid is not None
    sides = {"a": ellipsoid.semi_major_metre, "b": ellipsoid.semi_minor_metre}
    here, there = (pyproj.CRS.from_dict({"proj": p} | sides) for p in ("geocent", "longlat"))
    return pyproj.Transformer.from_crs(here, there.to_3d(), always_xy=True)
