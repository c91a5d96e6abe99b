"""Valid files that say the same in another way: optional fields of formats, in pairs and more.

They are written from the values of a reader's seed without the package's writers. What a reader
makes of them must be what it makes of the seed.
"""

import random
import re
import shutil
import struct
from collections.abc import Callable, Iterator
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import laspy
import netCDF4
import numpy as np
import openpyxl
import pandas as pd
import rasterio
import spectral
import trimesh

from fynjax.app.io.raster._cubes import Cube

Hidden = np.ndarray | dict[str, int] | None
"""What a variant states to be missing: values of the seed, or a place by the path of its array."""
Numbers = dict[str, np.ndarray]

_SHARE = 2e-3
"""Error that is let pass, of the range of an array: what 16 bits round."""
_OF_THE_FILE = re.compile(
    r"meta|\.crs$|\.file|step$|without_data|\.taken|\.gap|names|full|saturated"
)
"""What differs with the way in which a file says it."""


def numbers_of(value: Any, path: str = "") -> Iterator[tuple[str, np.ndarray]]:
    """Arrays of numbers in what a reader gives, by their path."""
    if value is None or isinstance(value, str | bytes | Path):
        return
    if is_dataclass(value):
        for field in fields(value):
            yield from numbers_of(getattr(value, field.name), f"{path}.{field.name}")
    elif hasattr(type(value), "model_fields"):
        for name in type(value).model_fields:
            yield from numbers_of(getattr(value, name), f"{path}.{name}")
    elif isinstance(value, dict):
        for name, part in value.items():
            yield from numbers_of(part, f"{path}.{name}")
    elif isinstance(value, list | tuple) and not all(isinstance(v, int | float) for v in value):
        for i, part in enumerate(value):
            yield from numbers_of(part, f"{path}[{i}]")
    else:
        try:
            array = np.asarray(value, float)
        except (TypeError, ValueError):
            return
        if array.size:
            yield path, array


def plain(reader: str, result: Any) -> Any:
    """What a reader gives, with bands by rising wavelength, and of blocks in reflectance: these
    leave the scale to their caller."""
    if isinstance(result, Cube):
        order = np.argsort(result.wavelength)
        parts = {name: getattr(result, name)[order] for name in ("values", "wavelength", "fwhm")}
        return {**parts, "cell": result.pixel_m, "origin": result.origin_m}
    if reader.startswith("blocks"):
        scale, blocks, wavelength = result
        order = np.argsort(wavelength)
        return {"values": np.concatenate(blocks)[..., order] / scale, "waves": wavelength[order]}
    return result


def difference(whole: Any, found: Any, hidden: Hidden = None) -> str | None:
    """Which numbers of the seed are not found again, those `hidden` as missing."""
    wanted, came = dict(numbers_of(whole)), dict(numbers_of(found))
    for name, old in wanted.items():
        if _OF_THE_FILE.search(name):
            continue
        new = came.get(name)
        if new is None or new.shape != old.shape:
            return f"{name} has the shape {None if new is None else new.shape}, not {old.shape}"
        if isinstance(hidden, dict):
            old = old.copy()
            old.flat[hidden.get(name, [])] = np.nan
        elif hidden is not None and old.size > 4:
            old = np.where(np.isclose(old[..., None], hidden, rtol=1e-6).any(axis=-1), np.nan, old)
        known = old[np.isfinite(old)]
        wide = float(np.ptp(known)) if known.size else 0.0
        most = max(_SHARE * wide, 1e-6 * float(np.abs(known).max(initial=0.0)) * (wide == 0.0))
        same = np.isclose(new, old, rtol=0.0, atol=most, equal_nan=True)
        if not same.all():
            at = tuple(int(i) for i in np.argwhere(~same)[0]) if same.ndim else ()
            return f"{name}{list(at)} is {new[at]:.6g}, not {old[at]:.6g}"
    return None


def _some(chance: random.Random, *options: str) -> set[str]:
    """One of the options, a pair, or up to four."""
    return set(chance.sample(options, min(len(options), chance.choice((1, 2, 2, 3, 4)))))


# -- ENVI -----------------------------------------------------------------------------------

_ENVI_TYPES = {"<f4": 4, "<f8": 5, "<i2": 2, "<u2": 12, "<i4": 3}


def _envi(path: Path, chance: random.Random) -> Hidden:
    """A cube or a library: scale, ignore value, units, order of values, bytes and bands."""
    data = next(p for p in path.parent.iterdir() if p.suffix in (".dat", ".sli"))
    library = data.suffix == ".sli"
    keys = spectral.envi.read_envi_header(path)
    lines, samples, bands = (int(keys[k]) for k in ("lines", "samples", "bands"))
    place = {"bsq": (bands, lines, samples), "bil": (lines, bands, samples)}[keys["interleave"]]
    values = np.fromfile(data, "<f4").reshape(place).astype(float)
    if keys["interleave"] == "bil":
        values = values.transpose(1, 0, 2)
    some = _some(
        chance, "scale", "ignore", "units", "interleave", "bytes", "offset", "bands", "type"
    )
    hidden: Hidden = None
    ignored = np.zeros(values.shape, bool)
    if "ignore" in some:
        at = chance.randrange(lines), chance.randrange(samples)
        ignored[(slice(None), *at)] = True
        hidden = {f"[{at[0]}].reflectance": at[1]} if library else values[ignored]
    if "bands" in some and not library:
        order = list(range(bands))
        chance.shuffle(order)
        for key in ("wavelength", "fwhm", "band names", "bbl"):
            keys[key] = [keys[key][i] for i in order]
        values, ignored = values[order], ignored[order]
    kind = chance.choice(("<f4", "<f8"))
    divisor = 1.0
    if "scale" in some:
        divisor = chance.choice((100.0, 10000.0))
        kind = chance.choice(("<i2", "<u2", "<i4", "<f4")) if divisor > 100.0 else "<f4"
        keys["reflectance scale factor"] = f"{divisor:g}"
    values = values * divisor
    # It must not become reflectance by being divided.
    missing = round(0.9 * divisor) if divisor > 1.0 else -9999
    values[ignored] = missing
    if "ignore" in some or "data ignore value" in keys:
        keys["data ignore value"] = str(missing)
    if "units" in some:
        keys["wavelength units"] = chance.choice(("Micrometers", "micrometers", "um"))
        keys["wavelength"] = [f"{float(w) / 1000:.6g}" for w in keys["wavelength"]]
        if "fwhm" in keys:
            keys["fwhm"] = [f"{float(w) / 1000:.6g}" for w in keys["fwhm"]]
    if "interleave" in some and not library:
        keys["interleave"] = chance.choice(("bsq", "bil", "bip"))
    if "bytes" in some:
        keys["byte order"] = "1"
    turned = {"bsq": (0, 1, 2), "bil": (1, 0, 2), "bip": (1, 2, 0)}[keys["interleave"]]
    if kind[1] != "f":
        values = np.round(values)
    keys["data type"] = str(_ENVI_TYPES[kind])
    kind = kind.replace("<", ">") if keys["byte order"] == "1" else kind
    before = b""
    if "offset" in some:
        before = b"\x2a" * chance.choice((1, 64))
        keys["header offset"] = str(len(before))
    data.write_bytes(before + values.transpose(turned).astype(kind).tobytes())
    rows = [f"{k} = {{{', '.join(v)}}}" if isinstance(v, list) else
            f"{k} = {{{v}}}" if k in ("description", "coordinate system string") else f"{k} = {v}"
            for k, v in keys.items()]  # fmt: skip
    chance.shuffle(rows)
    path.write_text("ENVI\n" + "\n".join(rows) + "\n", "utf-8")
    return hidden


# -- GeoTIFF --------------------------------------------------------------------------------


def _tiff(path: Path, chance: random.Random, reader: str) -> Hidden:
    """An image: scale and offset, no data, order of bands, place of values, rows from the south."""
    with rasterio.open(path) as file:
        values, profile, names = file.read().astype(float), file.profile, list(file.descriptions)
        tags = [file.tags(i) for i in file.indexes]
        own, units = file.tags(), file.units
    image = path.name in ("cube.tif", "image.tif")
    some = _some(
        chance, "scale", "nodata", "bands", "interleave", "tiles", "type", "south", "units"
    )
    hidden: Hidden = None
    ignored = np.zeros(values.shape, bool)
    if "nodata" in some and image:
        at = chance.randrange(values.shape[1]), chance.randrange(values.shape[2])
        ignored[(slice(None), *at)] = True
        hidden = values[ignored]
        if path.name == "image.tif":  # its counts are few, and so a pixel's are also others'
            ignored[:], hidden = False, None
    if "bands" in some and image:
        order = list(range(len(values)))
        chance.shuffle(order)
        values, ignored = values[order], ignored[order]
        names, tags = [names[i] for i in order], [tags[i] for i in order]
    scale, offset, kind = 1.0, 0.0, profile["dtype"]
    if "scale" in some and kind.startswith("float"):
        low = float(values.min())
        scale, offset = (float(np.ptp(values)) or 1.0) / 30000.0, chance.choice((0.0, low))
        if low / scale < 30000.0 or offset:
            kind = chance.choice(("uint16", "float32"))
    elif "type" in some:
        kind = "float64"
    values = (values - offset) / scale
    missing = 65535 if kind == "uint16" else -9999
    values[ignored] = missing
    if kind == "uint16":
        values = np.round(values)
    transform = profile["transform"]
    if "south" in some and reader in ("cube-geotiff", "image"):  # others keep it so or refuse it
        values = values[:, ::-1]
        transform = transform @ rasterio.Affine(1, 0, 0, 0, -1, values.shape[1])
    layout: dict[str, Any] = {"interleave": chance.choice(("band", "pixel"))}
    if "tiles" in some:
        layout |= {"tiled": True, "blockxsize": 16, "blockysize": 16}
    layout |= {"compress": chance.choice(("lzw", "deflate", "none"))}
    path.unlink()
    count, height, width = values.shape
    with rasterio.open(
        path, "w", driver="GTiff", count=count, height=height, width=width, dtype=kind,
        crs=profile["crs"], transform=transform,
        nodata=missing if ignored.any() or kind.startswith("float") else None, **layout,
    ) as file:  # fmt: skip
        file.write(values.astype(kind))
        file.descriptions = names
        file.units = units
        file.update_tags(**own)
        for i, tag in enumerate(tags, 1):
            if "units" in some and "wavelength" in tag:
                micro = {k: f"{float(tag[k]) / 1000:g}" for k in ("wavelength", "fwhm") if k in tag}
                tag = {**tag, **micro, "wavelength_units": "Micrometers"}
            file.update_tags(i, **tag)
        if scale != 1.0 or offset:
            file.scales, file.offsets = [scale] * count, [offset] * count
    return hidden


# -- NetCDF and zarr ------------------------------------------------------------------------


def _netcdf(path: Path, chance: random.Random, reader: str) -> Hidden:
    """Variables: packed as integers, fill value, order of dimensions, units of wavelengths."""
    with netCDF4.Dataset(path) as data:
        held = {n: (v[...], v.dimensions, v.__dict__) for n, v in data.variables.items()}
        of_file = data.__dict__
    some = _some(chance, "scale", "fill", "dimensions", "units", "type", "order")
    path.unlink()
    hidden = None
    names = list(held)
    if "order" in some:
        chance.shuffle(names)
    with netCDF4.Dataset(path, "w") as data:
        data.setncatts(of_file)
        for name in names:
            values, dimensions, facts = held[name]
            facts = {k: v for k, v in facts.items() if k != "_FillValue"}
            values = np.ma.filled(values, np.nan) if values.dtype.kind == "f" else values
            cube = name == "reflectance"
            curve = values.dtype.kind == "f" and name not in ("wavelength", "fwhm", "x", "y")
            kind, fill = values.dtype, None
            if cube and "fill" in some and reader != "cube-netcdf":  # it leaves such pixels out
                values, fill = np.array(values), -9999
                pixel = chance.randrange(values.shape[1]), chance.randrange(values.shape[2])
                hidden = values[(slice(None), *pixel)].astype(float)
                values[(slice(None), *pixel)] = np.nan
            if cube and "dimensions" in some:
                turned = chance.choice(((1, 2, 0), (1, 0, 2)))
                values = values.transpose(turned)
                dimensions = tuple(dimensions[i] for i in turned)
            if name in ("wavelength", "fwhm") and "units" in some and path.name == "cube.nc":
                values, facts = np.asarray(values) / 1000.0, {**facts, "units": "um"}
            for axis, size in zip(dimensions, values.shape, strict=True):
                if axis not in data.dimensions:
                    data.createDimension(axis, size)
            if curve and "type" in some:
                kind = np.dtype("f8")
            if curve and "scale" in some:
                kind, fill = np.dtype("i4"), -9999
            made = data.createVariable(name, kind if kind.kind in "iuf" else str, dimensions,
                                       fill_value=fill)  # fmt: skip
            if curve and "scale" in some:
                known = values[np.isfinite(values)]
                facts = {**facts, "scale_factor": 1e-6 * (float(np.abs(known).max()) or 1.0),
                         "add_offset": chance.choice((0.0, float(known.min())))}  # fmt: skip
            made.setncatts(facts)
            made[...] = np.ma.masked_invalid(values) if made.dtype is not str else values
    return hidden


def _zarr(path: Path, chance: random.Random) -> Hidden:
    import xarray as xr

    data = xr.open_zarr(path, consolidated=False).load()
    version = 3 if (path / "zarr.json").is_file() else 2
    some = _some(chance, "scale", "fill", "dimensions", "units", "chunks")
    hidden = None
    encoding: dict[str, Any] = {}
    cube = data["reflectance"].astype("f8")
    if "fill" in some:
        pixel = chance.randrange(cube.sizes["y"]), chance.randrange(cube.sizes["x"])
        hidden = cube.values[pixel].copy()
        cube.values[pixel] = np.nan
        encoding["_FillValue"] = -9999.0
    if "scale" in some:
        encoding |= {"dtype": "int32", "scale_factor": 1e-5, "_FillValue": -9999}
    if "dimensions" in some:
        cube = cube.transpose(*chance.choice((("band", "y", "x"), ("y", "band", "x"))))
    if "chunks" in some:
        encoding["chunks"] = tuple(max(1, size // 2) for size in cube.shape)
    waves = data["wavelength"].values, {"units": "nm"}
    if "units" in some:
        waves = waves[0] / 1000.0, {"units": "um"}
    shutil.rmtree(path)
    cube.encoding = {}
    new = xr.Dataset({"reflectance": (cube.dims, cube.values)},
                     {"wavelength": ("band", *waves)})  # fmt: skip
    new.to_zarr(path, zarr_format=version, consolidated=False, encoding={"reflectance": encoding})
    return hidden


# -- points and meshes ----------------------------------------------------------------------


def _las(path: Path, chance: random.Random) -> Hidden:
    """Points: scales and offsets of the axes, kinds and order of records, versions."""
    old = laspy.read(path)
    some = _some(chance, "scales", "offsets", "format")
    kind = chance.choice((7, 8)) if "format" in some else 6
    header = laspy.LasHeader(version="1.4", point_format=kind)
    header.scales, header.offsets = old.header.scales, old.header.offsets
    if "scales" in some:
        header.scales = [chance.choice((0.001, 0.0005, 0.002)) for _ in range(3)]
    if "offsets" in some:
        header.offsets = old.header.offsets + [chance.choice((-50, 0, 1000)) for _ in range(3)]
    header.vlrs.extend(v for v in old.header.vlrs if "laszip" not in v.user_id)
    header.global_encoding.wkt = True
    new = laspy.LasData(header)
    new.x, new.y, new.z = old.x, old.y, old.z
    new.classification = old.classification
    new.write(path)
    return None


def _points(path: Path, chance: random.Random) -> Hidden:
    """A table of points: order of columns and others between them, separator, decimals."""
    if path.suffix == ".xyz":
        values = np.loadtxt(path)
        names = ["x", "y", "z"]
    else:
        table = pd.read_csv(path)
        values, names = table.to_numpy(float), list(table.columns)
    some = _some(chance, "columns", "more", "separator", "comment", "letters")
    head = path.suffix == ".csv"
    order = list(range(len(names)))
    columns = {name: [f"{v:.9g}" for v in values[:, i]] for i, name in enumerate(names)}
    if head and "columns" in some:
        chance.shuffle(order)
    shown = [(names[i], columns[names[i]]) for i in order]
    if "more" in some:
        at = chance.randrange(len(shown) + 1) if head else len(shown)
        shown.insert(at, ("intensity", [str(7 * k % 255) for k in range(len(values))]))
    separator = "," if head else " "
    if "separator" in some:
        separator = chance.choice((";", "\t", " ") if head else ("\t", "  "))
    rows = [[name.upper() if "letters" in some else name for name, _ in shown]] if head else []
    rows += list(map(list, zip(*[column for _, column in shown], strict=True)))
    text = "# made for a test\n" if "comment" in some else ""
    path.write_text(text + "\n".join(map(separator.join, rows)) + "\n", "utf-8")
    return None


def _ply(path: Path, chance: random.Random) -> Hidden:
    """A PLY of points: order of its properties, their types, bytes or text."""
    content = path.read_bytes()
    names = re.findall(rb"property (?:float|double|float32|float64) (\w+)", content)
    columns = [name.decode() for name in names]
    if b"format ascii" in content:
        lines = content.decode().split("end_header\n")[1].split("\n")
        values = np.array([line.split()[: len(columns)] for line in lines if line], float)
    else:
        values = np.asarray(trimesh.load(path).vertices, float)
        columns = columns[:3]
    some = _some(chance, "order", "type", "bytes", "more")
    if "order" in some:
        order = list(range(len(columns)))
        chance.shuffle(order)
        columns, values = [columns[i] for i in order], values[:, order]
    if "more" in some:
        at = chance.randrange(len(columns) + 1)
        columns.insert(at, "quality")
        values = np.insert(values, at, np.arange(len(values)) % 7, axis=1)
    kind = "float" if "type" in some else "double"
    form = chance.choice(("ascii", "binary_little_endian", "binary_big_endian"))
    head = [f"ply\nformat {form} 1.0\ncomment made for a test\nelement vertex {len(values)}"]
    head += [f"property {kind} {name}" for name in columns]
    text = "\n".join(head) + "\nend_header\n"
    if form == "ascii":
        body = "".join(" ".join(f"{v:.9g}" for v in row) + "\n" for row in values).encode()
    else:
        mark = {"binary_little_endian": "<", "binary_big_endian": ">"}[form]
        body = values.astype(f"{mark}f{4 if kind == 'float' else 8}").tobytes()
    path.write_bytes(text.encode() + body)
    return None


def _mesh(path: Path, chance: random.Random) -> Hidden:
    """The seed's box with its facets as they were, written without trimesh."""
    shape: Any = trimesh.load(path, process=False, force="mesh")
    corners, faces = np.asarray(shape.vertices, float), np.asarray(shape.faces)
    if path.suffix == ".stl":
        if chance.random() < 0.5:
            rows = ["solid plant"]
            for face in corners[faces]:
                rows += ["facet normal 0 0 0", "outer loop"]
                rows += [f"vertex {x:.9g} {y:.9g} {z:.9g}" for x, y, z in face]
                rows += ["endloop", "endfacet"]
            path.write_text("\n".join([*rows, "endsolid plant"]) + "\n", "utf-8")
        else:
            facets = b"".join(
                struct.pack("<12fH", 0, 0, 0, *face.ravel(), 0) for face in corners[faces]
            )
            path.write_bytes(bytes(80) + struct.pack("<I", len(faces)) + facets)
        return None
    if path.suffix == ".ply":
        order = list(range(3))
        chance.shuffle(order)
        rows = ["ply", "format ascii 1.0", f"element vertex {len(corners)}"]
        rows += [f"property float {'xyz'[i]}" for i in order]
        rows += [f"element face {len(faces)}", "property list uchar int vertex_indices"]
        rows += ["end_header", *(" ".join(f"{v:.9g}" for v in row) for row in corners[:, order])]
        rows += [f"3 {a} {b} {c}" for a, b, c in faces]
        path.write_text("\n".join(rows) + "\n", "utf-8")
        return None
    back = len(corners) if chance.random() < 0.5 else -1
    of = (lambda i: i - back) if back > 0 else (lambda i: i + 1)
    shown = {0: "{}", 1: "{0}//1"}[chance.randrange(2)]
    rows = ["# made for a test", *(f"v {x:.9g} {y:.9g} {z:.9g}" for x, y, z in corners), "vn 0 0 1"]
    rows += ["f " + " ".join(shown.format(of(i)) for i in face) for face in faces]
    path.write_text("\n".join(rows) + "\n", "utf-8")
    return None


# -- tables ---------------------------------------------------------------------------------


def _spectrum(path: Path, chance: random.Random) -> Hidden:
    """Columns of a spectrum: units of both, order of wavelengths and columns, separator."""
    table = pd.read_csv(path, sep=None, engine="python")
    waves, values = table.iloc[:, 0].to_numpy(float), table.iloc[:, 1].to_numpy(float)
    some = _some(chance, "percent", "micrometres", "falling", "separator", "decimal", "comment")
    names = ["wavelength_nm", "leaf"]
    if "micrometres" in some:
        waves, names[0] = waves / 1000.0, chance.choice(("wavelength_um", "Wavelength (um)"))
    if "percent" in some:
        values, names[1] = 100.0 * values, chance.choice(("leaf [%]", "leaf (%)"))
    if "falling" in some:
        waves, values = waves[::-1], values[::-1]
    separator = chance.choice((";", "\t")) if some & {"separator", "decimal"} else ","
    rows = [[f"{w:.6g}", f"{v:.6g}"] for w, v in zip(waves, values, strict=True)]
    if "decimal" in some:
        rows = [[cell.replace(".", ",") for cell in row] for row in rows]
    text = "# made for a test\n" if "comment" in some else ""
    path.write_text(text + "\n".join(separator.join(row) for row in [names, *rows]) + "\n", "utf-8")
    return None


def _wide(path: Path, chance: random.Random) -> Hidden:
    """A row a spectrum: its columns in another order, and one of words between them."""
    table = pd.read_csv(path, dtype=str)
    some = _some(chance, "order", "words", "separator")
    columns = list(table.columns)
    if "order" in some:
        columns = [columns[0], *columns[:0:-1]]
    table = table[columns]
    if "words" in some:
        table.insert(1, "site", "east")
    table.to_csv(path, index=False, sep=chance.choice((";", "\t")) if "separator" in some else ",")
    return None


def _table(path: Path, chance: random.Random) -> Hidden:
    """A table of records: order of columns, separator, decimals, blanks and comments."""
    table = pd.read_csv(path, dtype=str, keep_default_na=False)
    some = _some(chance, "columns", "separator", "decimal", "comment", "blanks")
    columns = list(table.columns)
    if "columns" in some:
        chance.shuffle(columns)
    table = table[columns]
    separator = chance.choice((";", "\t")) if some & {"separator", "decimal"} else ","
    if "decimal" in some:
        table = table.map(lambda t: t.replace(".", ",") if re.fullmatch(r"[-+.\d]+", t) else t)
    if "blanks" in some:
        table = table.map(lambda t: f" {t} ")
    text = table.to_csv(index=False, sep=separator)
    path.write_text(("# made for a test\n" if "comment" in some else "") + text, "utf-8")
    return None


def _workbook(path: Path, chance: random.Random) -> Hidden:
    """A sheet: order of columns, an empty row or column before, another sheet without cells."""
    rows = [list(row) for row in openpyxl.load_workbook(path).active.iter_rows(values_only=True)]
    some = _some(chance, "columns", "sheet", "text")
    order = list(range(len(rows[0])))
    if "columns" in some:
        chance.shuffle(order)
    book = openpyxl.Workbook()
    for row in rows:
        cells = [row[i] for i in order]
        if "text" in some:  # numbers that were typed as text
            cells = [None if cell is None else str(cell) for cell in cells]
        book.active.append(cells)
    if "sheet" in some:
        book.create_sheet("empty")
    book.save(path)
    return None


_AIR_UNITS = {
    "W/m2/nm": {"W m-2 nm-1": 1.0, "W m-2 um-1": 1e3, "uW cm-2 nm-1": 100.0},
    "%": {"1": 0.01, "%": 1.0},
    "W m-2 sr-1 um-1": {"W m-2 sr-1 um-1": 1.0, "W m-2 sr-1 nm-1": 1e-3},
}


def _air(path: Path, chance: random.Random) -> Hidden:
    """Curves of an atmosphere: order of columns, units of each."""
    table = pd.read_csv(path)
    some = _some(chance, "columns", "units", "separator")
    new = {}
    for name in table.columns:
        unit = re.search(r"\[(.*)\]", name)
        if unit and unit[1] in _AIR_UNITS and "units" in some:
            other, factor = chance.choice(list(_AIR_UNITS[unit[1]].items()))
            new[name.replace(unit[1], other)] = table[name] * factor
        else:
            new[name] = table[name]
    columns = list(new)
    if "columns" in some:
        chance.shuffle(columns)
    pd.DataFrame(new)[columns].to_csv(
        path, index=False, float_format="%.9g", sep=";" if "separator" in some else ","
    )
    return None


_ENVI_NAMES = {"envi-library": "lib.hdr", "cube-envi": "cube.hdr", "blocks-envi": "cube.hdr"}
_TIFF_NAMES = {"cube-geotiff": "cube.tif", "blocks-geotiff": "cube.tif", "image": "image.tif",
               "terrain": "terrain.tif", "ground-map": "ground.tif"}  # fmt: skip

VARIANTS: dict[str, tuple[str, Callable[..., Hidden]]] = {
    **{reader: (name, _envi) for reader, name in _ENVI_NAMES.items()},
    **{reader: (name, _tiff) for reader, name in _TIFF_NAMES.items()},
    "cube-netcdf": ("cube.nc", _netcdf), "blocks-netcdf": ("cube.nc", _netcdf),
    "atmosphere-netcdf": ("air.nc", _netcdf),
    "blocks-zarr": ("cube.zarr", _zarr), "blocks-zarr3": ("cube.zarr", _zarr),
    "las": ("cloud.las", _las), "laz": ("cloud.laz", _las),
    "xyz": ("cloud.xyz", _points), "cloud-csv": ("cloud.csv", _points),
    "scan-csv": ("scan.csv", _points),
    "cloud-ply": ("cloud.ply", _ply), "cloud-ply-text": ("cloud.ply", _ply),
    "scan-ply": ("scan.ply", _ply),
    "mesh-stl": ("plant.stl", _mesh), "mesh-ply": ("plant.ply", _mesh),
    "mesh-obj": ("plant.obj", _mesh),
    "spectra-columns": ("leaf.csv", _spectrum), "spectra-rows": ("leaf.csv", _wide),
    "statistics": ("statistics.csv", _table), "structure": ("structure.csv", _table),
    "workbook": ("statistics.xlsx", _workbook), "atmosphere": ("air.csv", _air),
}  # fmt: skip
"""By reader: its file, and how it is written anew with some of its optional fields changed."""


def vary(reader: str, folder: Path, chance: random.Random) -> Hidden:
    """Write the valid file of a reader in `folder` anew, so that it says the same otherwise.

    **Returns:** values that the file now states to be missing, or none.
    """
    name, write = VARIANTS[reader]
    return write(folder / name, chance, *([reader] if write in (_tiff, _netcdf) else []))
