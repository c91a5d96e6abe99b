"""Reflectance that stands in a group of a NetCDF or HDF5 file: AVIRIS-3 and -5, NEON."""

import re
from collections.abc import Hashable
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from fynjax._core.errors import InputError, listed
from fynjax.app.io.raster._crs import parse_crs

_REFLECTANCE = re.compile(r"(surface_|hdr_)?reflectance(_data)?|rfl", re.IGNORECASE)
"""Names of the variable."""
WAVELENGTHS = re.compile(r"(cent(ral|re|er)_?|band_?)?wave_?lengths?", re.IGNORECASE)
"""Names of the variable of wavelengths."""
_OF_BANDS = ("fwhm", "good_wavelengths", "reflectance_good")
_MOST_GROUPS = 500


def _walk(group: Any, prefix: str = "") -> list[tuple[str, Any]]:
    """All groups below one, with their paths, itself included."""
    found = [(prefix, group)]
    for name, below in group.groups.items():
        if len(found) < _MOST_GROUPS:
            found += _walk(below, f"{prefix}/{name}")
    return found


@dataclass(frozen=True)
class Tree:
    """What the groups of a file hold, as far as it matters here."""

    groups: tuple[str, ...]
    """Paths of all groups below the root."""
    holders: tuple[tuple[str, str], ...]
    """Group and name of the variables that may be reflectance."""
    of_bands: tuple[str, ...]
    """Groups that describe bands."""
    cubes: tuple[str, ...]
    """Names, with their groups, of all variables of three dimensions."""
    texts: dict[str, dict[str, str]]
    """Texts of NEON's groups of a coordinate system, by group and name."""


def read_tree(path: Path) -> Tree:
    """The groups of a NetCDF or HDF5 file; it is closed again before anything else opens it, which
    the library of NetCDF does not always survive otherwise.

    **Arguments:** `path`, a file that can be opened.
    """
    import netCDF4  # takes a fifth of a second

    with netCDF4.Dataset(path) as data:
        groups = _walk(data)
        variables = [
            (place, name, one) for place, of in groups for name, one in of.variables.items()
        ]
        cubes = [(place, name) for place, name, one in variables if one.ndim == 3]
        bands = [
            place
            for place, name, _ in variables
            if place and (name.lower() in _OF_BANDS or WAVELENGTHS.fullmatch(name))
        ]
        texts: dict[str, dict[str, str]] = {}
        for place, name, one in variables:
            if place.endswith("/Coordinate_System"):
                texts.setdefault(place, {})[name] = _text(one)
    return Tree(
        tuple(place for place, _ in groups if place),
        tuple((place, name) for place, name in cubes if _REFLECTANCE.fullmatch(name)),
        tuple(dict.fromkeys(bands)),
        tuple(f"{place}/{name}".lstrip("/") for place, name in cubes),
        texts,
    )


def with_groups(
    path: Path, tree: Tree, root: xr.Dataset, opened: ExitStack
) -> tuple[xr.Dataset, list[xr.Dataset]]:
    """The dataset that holds `reflectance`, and those of the groups that describe its bands.

    Where the root has no such variable the tree of groups is searched for one of three dimensions;
    coordinates and the grid mapping may stand above it. NEON's is scaled, and placed by its map
    information.

    **Arguments:** `path` of the file; `tree`, its groups; `root`, its root group; `opened`: closes
    what is opened.

    **Raises:** `InputError` where no group has such a variable, or several have.
    """
    holders, cubes = tree.holders, tree.cubes
    around = [opened.enter_context(xr.open_dataset(path, group=place)) for place in tree.of_bands]
    if "reflectance" in root:
        return root, around
    if len(holders) != 1:
        if holders:
            raise InputError(
                "expected one variable 'reflectance', but several groups have one: "
                f"{listed(f'{place}/{name}' for place, name in holders)}. Copy one into a file of "
                "its own: nccopy -g GROUP"
            )
        there = f"of three dimensions {listed(cubes)}" if cubes else f"{listed(map(str, root))}"
        raise InputError(
            "expected a variable 'reflectance' in the file or one of its groups, but it has "
            f"{there if cubes or len(root) else 'none'}. If one of them is reflectance, rename it: "
            "ncrename -v NAME,reflectance"
        )
    ((place, name),) = holders
    raw = opened.enter_context(xr.open_dataset(path, group=place or None, decode_cf=False))
    values = raw[name]
    if "Scale_Factor" in values.attrs:
        values.attrs["scale_factor"] = 1.0 / float(values.attrs["Scale_Factor"])
    if "Data_Ignore_Value" in values.attrs:
        values.attrs.setdefault(
            "_FillValue", np.array(values.attrs["Data_Ignore_Value"]).astype(values.dtype).item()
        )
    own = xr.decode_cf(raw.rename({name: "reflectance"}), decode_times=False)
    above = {
        key: root[key]
        for key in root.variables
        if key not in own.variables and set(root[key].dims) <= set(own["reflectance"].dims)
    }
    own = own.assign(above)
    own = own.assign_coords(
        {d: own[d] for d in own["reflectance"].dims if d in own.variables and d not in own.coords}
    )
    system = f"{place}/Metadata/Coordinate_System"
    if "grid_mapping" not in own["reflectance"].attrs:
        mapped = [key for key, one in own.variables.items() if "crs_wkt" in one.attrs]
        if len(mapped) == 1:
            own["reflectance"].attrs["grid_mapping"] = mapped[0]
        elif (neon := _neon_place(tree.texts.get(system, {}))) is not None:
            own = own.assign(crs=neon)
            own["reflectance"].attrs["grid_mapping"] = "crs"
    return own, around


_SPECTRAL = ("band", "bands", "wavelength", "wavelengths")


_X = re.compile(
    r"x(c|_dim)?|lon(gitude)?|east(ing)?|col(umn)?s?|samples?|crosstrack", re.IGNORECASE
)
_Y = re.compile(r"y(c|_dim)?|lat(itude)?|north(ing)?|rows?|lines?|downtrack", re.IGNORECASE)


def ordered_axes(values: xr.DataArray, sources: list[xr.Dataset]) -> tuple[Hashable, ...]:
    """Dimensions of a cube: of rows (y), of columns (x), and of bands.

    That of bands is called so; or it is the wavelengths' own, or as long as they are, the last of
    several; or the only one that is not of places; or the first. x and y go by their names, and
    are as they stand where these say nothing.
    """
    waves = [s[n] for s in sources for n in s.variables if WAVELENGTHS.fullmatch(str(n))]
    others = [d for d in values.dims if not (_X.fullmatch(str(d)) or _Y.fullmatch(str(d)))]
    spectral = next(
        found[-1]
        for found in (
            [d for d in values.dims if d in _SPECTRAL],
            [d for d in values.dims if any(wave.dims == (d,) for wave in waves)],
            [d for d in values.dims if values.sizes[d] in {wave.size for wave in waves}],
            others if len(others) == 1 else [],
            values.dims[:1],
        )
        if found
    )
    first, second = (d for d in values.dims if d != spectral)
    swapped = _X.fullmatch(str(first)) and _Y.fullmatch(str(second))
    return (second, first, spectral) if swapped else (first, second, spectral)


def _neon_place(words: dict[str, str]) -> xr.DataArray | None:
    """Grid mapping of NEON's reflectance: its map information is that of an ENVI header."""
    parts = [part.strip() for part in words.get("Map_Info", "").split(",")]
    code = re.search(r"\d{4,5}", words.get("EPSG Code", words.get("EPSG_Code", "")))
    if len(parts) < 7 or code is None:
        return None
    try:
        column, row, x, y, width, height = map(float, parts[1:7])
    except ValueError:
        return None
    west, north = x - (column - 1.0) * width, y + (row - 1.0) * height
    attributes = {
        "crs_wkt": parse_crs(f"EPSG:{code[0]}").to_wkt(),
        "GeoTransform": f"{west} {width} 0 {north} 0 {-height}",
    }
    return xr.DataArray(np.int32(0), attrs=attributes)


def _text(variable: Any) -> str:
    """The text of a variable that holds one."""
    found = np.asarray(variable[...]).ravel()
    return str(found[0]) if found.size == 1 else "".join(map(str, found.tolist()[:200]))
