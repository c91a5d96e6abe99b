"""Every reader of a user's files, and how a valid file of each is made."""

import gzip
import shutil
import tempfile
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import jax.numpy as jnp
import laspy
import numpy as np
import openpyxl
import rasterio
import trimesh
import xarray as xr
from rasterio import Affine
from rasterio.crs import CRS
from rasterio.errors import NotGeoreferencedWarning

from fynjax._core.checkpoint import Journal
from fynjax._core.errors import InputError
from fynjax.app.assembly import StandSettings, plot_parameters
from fynjax.app.compare import read_drone_image, read_spectra_sample
from fynjax.app.io.captures import panel_reflectance, read_capture
from fynjax.app.io.frames import read_frames
from fynjax.app.io.instruments import load_lidar, load_sensor, read_atmosphere
from fynjax.app.io.plot import (
    example_folder,
    read_plot,
    read_prior,
    read_statistics,
    read_structure,
    with_parameter_table,
)
from fynjax.app.io.raster import (
    CubeBlocks,
    MapWriter,
    open_blocks,
    read_band_stack,
    read_cover_map,
    read_probability_map,
    write_geotiff,
)
from fynjax.app.io.raster._cubes import (
    Cube,
    write_cube_envi,
    write_cube_geotiff,
    write_cubes_netcdf,
)
from fynjax.app.io.spectra import read_spectra_file
from fynjax.app.jobs import Training, read_training, write_training
from fynjax.app.terrain import read_cloud, read_terrain
from fynjax.canopy import plant_model_from_mesh, plant_model_from_points, read_scan
from fynjax.inversion import AmortisedPosterior
from fynjax.scene import COVERS
from fynjax.sensors import BandSet, group_bands, lidar_folder
from tests.canopy.test_scan import ball
from tests.helpers import read_cube, write_ply, write_raster
from tests.io import frame_files
from tests.io.dji_files import SHAPE, write_dji
from tests.io.emit_files import write_emit
from tests.io.rededge_files import lit, panel_scene, write_rededge
from tests.io.test_crowns import write as write_crowns
from tests.io.test_parameter_values import TABLE as PARAMETER_TABLE
from tests.io.test_plot_light import PATTERN
from tests.io.test_sensor_file import OWN as SENSOR
from tests.io.test_spectra import asd

UTM = "EPSG:32734"
PLACE = Affine(0.5, 0.0, 412_300.0, 0.0, -0.5, 6_191_200.0)


@dataclass(frozen=True)
class Reader:
    """How a kind of file is made and read."""

    write: Callable[[Path], Any]
    """Writes valid files into a folder."""
    read: Callable[[Path], Any]
    """Reads those of a folder."""
    missing: bool = False
    """Whether NaN stands for what a valid file does not state."""


def _text(name: str, text: str) -> Callable[[Path], Any]:
    return lambda folder: (folder / name).write_text(text, encoding="utf-8")


def _rows(*columns: Any) -> str:
    return "\n".join(",".join(f"{v:.9g}" for v in row) for row in zip(*columns, strict=True)) + "\n"


_WAVES = np.arange(400.0, 2500.0, 60.0)
_GREEN = 0.1 + 0.3 * (_WAVES > 700)


def _wide() -> str:
    rows = [f"leaf{k}," + _rows(*(0.9**k * _GREEN)[:, None]) for k in (1, 2)]
    return "name," + _rows(*_WAVES[:, None]) + "".join(rows)


def _points(count: int = 60) -> np.ndarray:
    chance = np.random.default_rng(0)
    corner = np.array([412_300, 6_191_200, 80])
    return corner + chance.uniform(0, 1, (count, 3)) * [10, 10, 2]


def _las(name: str) -> Callable[[Path], Any]:
    def write(folder: Path) -> None:
        points = _points()
        header = laspy.LasHeader(version="1.4", point_format=6)
        header.offsets, header.scales = points.min(axis=0).round(), [0.001] * 3
        header.vlrs.append(laspy.vlrs.known.WktCoordinateSystemVlr(CRS.from_string(UTM).to_wkt()))
        header.global_encoding.wkt = True
        las = laspy.LasData(header)
        las.x, las.y, las.z = points.T
        las.classification = np.full(len(points), 2, np.uint8)
        las.write(folder / name)

    return write


def _ply(binary: bool) -> Callable[[Path], Any]:
    def write(folder: Path) -> None:
        points = _points() - [412_300, 6_191_200, 0]
        if binary:
            trimesh.PointCloud(points).export(folder / "cloud.ply")
        else:
            write_ply(folder / "cloud.ply", ["double x", "double y", "double z"], points)

    return write


def _mesh(name: str) -> Callable[[Path], Any]:
    shape = trimesh.creation.box((0.4, 0.5, 0.8))
    return lambda folder: shape.export(folder / name)


def _scan(name: str) -> Callable[[Path], Any]:
    def write(folder: Path) -> None:
        table = np.hstack(ball(80)).astype(float)
        if name.endswith("ply"):
            axes = ("x", "y", "z", "nx", "ny", "nz")
            write_ply(folder / name, [f"double {axis}" for axis in axes], table)
        else:
            (folder / name).write_text("x,y,z,nx,ny,nz\n" + _rows(*table.T), encoding="utf-8")

    return write


def _cube() -> Cube:
    values = np.random.default_rng(0).uniform(0.02, 0.5, (4, 3, 4))
    waves = np.array([550.0, 660.0, 730.0, 860.0])
    return Cube(
        values=values, names=("green", "red", "red_edge", "nir"), wavelength=waves,
        fwhm=np.full(4, 20.0), good=np.ones(4, bool), pixel_m=0.5, origin_m=(8.0, 3.0), crs=UTM,
    )  # fmt: skip


def _library(folder: Path) -> None:
    np.stack([_GREEN, 0.5 * _GREEN]).astype("<f4").tofile(folder / "lib.sli")
    waves = ", ".join(f"{w:g}" for w in _WAVES)
    (folder / "lib.hdr").write_text(
        f"ENVI\ndescription = {{ two leaves }}\nsamples = {len(_WAVES)}\nlines = 2\nbands = 1\n"
        "header offset = 0\nfile type = ENVI Spectral Library\ndata type = 4\ninterleave = bsq\n"
        "byte order = 0\nreflectance scale factor = 1.0\nwavelength units = Nanometers\n"
        f"wavelength = {{ {waves} }}\nspectra names = {{ a, b }}\n",
        encoding="utf-8",
    )


def _image(folder: Path) -> None:
    values = np.random.default_rng(0).integers(400, 5000, (4, 12, 14)).astype(np.uint16)
    values[3] += 5000
    write_geotiff(
        folder / "image.tif", values.astype(np.float32) / 2e4, ["green", "red", "red_edge", "nir"],
        transform=PLACE, wavelengths=[550.0, 660.0, 730.0, 860.0], crs=UTM,
    )  # fmt: skip


def _raster(name: str, kind: Any = np.uint8, bands: int = 1, **options: Any) -> Any:
    def write(folder: Path) -> None:
        chance = np.random.default_rng(0)
        values = chance.uniform(2, 250, (bands, 20, 20)).astype(kind)
        write_raster(folder / name, values, transform=PLACE, crs=UTM, compress="deflate", **options)

    return write


def _ground(folder: Path) -> None:
    shares = np.full((2, 20, 20), 0.2, np.float32)
    write_geotiff(folder / "ground.tif", shares, list(COVERS[:2]), transform=PLACE, crs=UTM)


def _terrain(folder: Path) -> None:
    y, x = np.mgrid[:20, :20]
    heights = (100.0 + 0.05 * x + 0.02 * y).astype(np.float32)
    write_geotiff(folder / "terrain.tif", heights[None], ["h"], transform=PLACE, crs=UTM, unit="m")


def _capture(folder: Path) -> None:
    scene, _ = panel_scene(shape=(48, 64))
    write_rededge(folder, "IMG", lit(scene))


def _read_capture(folder: Path) -> Any:
    return read_capture("IMG", [folder / f"IMG_{k}.tif" for k in (1, 2, 3)])


def _dji(folder: Path) -> None:
    write_dji(folder, "DJI_20261122100000_0001", [np.full(SHAPE, 0.3)] * 4, lens=True)


def _read_dji(folder: Path) -> Any:
    capture = read_capture("DJI", sorted(folder.glob("DJI_*.TIF")))
    lens = capture.bands[0].registration
    counts = capture.bands[0].counts  # NaN is where the lens does not reach
    return capture.radiance(), lens and np.nan_to_num(lens.on_frame(counts))


def _frames(folder: Path) -> Any:
    where = {"crs": frame_files.CRS, "origin": frame_files.ORIGIN, "ground": frame_files.GROUND}
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        frames = read_frames(folder, **where)
    if left_out := [str(one.message) for one in caught if "left out" in str(one.message)]:
        raise InputError(left_out[0])  # refused by name, while the others are read
    return [(f.name, f.pose.position, f.pose.axes, f.lens) for f in frames]


def _plot(folder: Path) -> None:
    shutil.copytree(example_folder(), folder, dirs_exist_ok=True)
    text = (folder / "plot.toml").read_text("utf-8")
    text = "\n".join(line.split(" #")[0].rstrip() for line in text.splitlines() if line[:1] != "#")
    for old, new in (
        ('leaf_table = "leaves.csv"', 'leaf_table = "leaves.csv"\ndead_tissue = "dead.csv"'),
        ("aerosol_optical_depth = 0.1", 'table = "sky.csv"\npattern = "pattern.csv"'),
        ('name = "mavic_3m"', 'path = "own.toml"'),
    ):
        assert old in text
        text = text.replace(old, new, 1)
    (folder / "plot.toml").write_text(text, encoding="utf-8")
    (folder / "own.toml").write_text(SENSOR, encoding="utf-8")
    (folder / "pattern.csv").write_text(PATTERN, encoding="utf-8")
    (folder / "sky.csv").write_text("wavelength_nm,diffuse_fraction\n400,0.3\n2500,0.02\n", "utf-8")
    (folder / "dead.csv").write_text("wavelength_nm,reflectance\n400,0.2\n2500,0.6\n", "utf-8")
    for unused in ("README.txt", "statistics.csv"):
        (folder / unused).unlink()


def _sensor(folder: Path) -> None:
    start, end = SENSOR.index("response"), SENSOR.index("[psf]")
    text = SENSOR[:start] + 'response = "tabulated"\ncurves = "curves.csv"\n\n' + SENSOR[end:]
    (folder / "own.toml").write_text(text, encoding="utf-8")
    curves = "".join(
        f"{band},{centre + 10 * k},{max(0, 3 - abs(k))}\n"
        for band, centre in (("green", 550), ("red", 660), ("nir", 850))
        for k in range(-3, 4)
    )
    (folder / "curves.csv").write_text("band,wavelength_nm,response\n" + curves, encoding="utf-8")


def _spectrometer(folder: Path) -> None:
    (folder / "own.toml").write_text(
        'name = "own"\nsource = "data sheet"\n[geometry]\nkind = "orthographic"\npixel_m = 3\n'
        '[bands]\ntable = "bands.csv"\n[noise]\nkind = "radiometric"\ntable = "noise.csv"\n'
        'radiance_unit = "W m-2 sr-1 um-1"\n',
        encoding="utf-8",
    )
    waves = np.arange(400.0, 1000.0, 25.0)
    columns = (waves, np.full_like(waves, 30.0))
    (folder / "bands.csv").write_text("centre_nm,fwhm_nm\n" + _rows(*columns), encoding="utf-8")
    noise = (waves, 0.01 + 0 * waves, 1 + 0 * waves, 0.02 + 0 * waves)
    (folder / "noise.csv").write_text("wavelength_nm,a,b,c\n" + _rows(*noise), encoding="utf-8")


_AIR = """wavelength [nm],direct [W/m2/nm],diffuse [W/m2/nm],upward_direct [%],\
upward_diffuse [%],path_radiance [W m-2 sr-1 um-1],spherical_albedo
400,1.00,0.40,70,9,30,0.12
500,1.20,0.30,72,8,25,0.10
900,0.80,0.05,89,3,3,0.02
"""


def _air(folder: Path) -> None:
    read = read_atmosphere(_written(folder / "air.csv", _AIR))
    (folder / "air.csv").unlink()
    units = {"direct": "W m-2 um-1", "diffuse": "W m-2 um-1", "path_radiance": "W m-2 sr-1 um-1"}
    curves = ("upward_direct", "upward_diffuse", "spherical_albedo", *units)
    data = xr.Dataset({"wavelength": ("wavelength", np.array(read.wavelength), {"units": "nm"})})
    for name in curves:
        values = np.asarray(getattr(read, name))
        data[name] = ("wavelength", values, {"units": units.get(name, "1")})
    data.to_netcdf(folder / "air.nc")


def _written(path: Path, text: str) -> Path:
    path.write_text(text, encoding="utf-8")
    return path


_PANEL = "band,reflectance\nBlue,0.5\nRed,0.5\nNIR,0.5\n"
_STATISTICS = "statistic,value,sd\ngreen.mean,0.05,0.001\nnir.mean,0.3,0.01\nNDVI.std,0.1,\n"


def _workbook(folder: Path) -> None:
    book = openpyxl.Workbook()
    for row in _STATISTICS.splitlines():
        book.active.append([_cell(cell) for cell in row.split(",")])
    book.save(folder / "statistics.xlsx")


def _cell(text: str) -> float | str:
    return float(text) if text[:1].isdigit() else text


_STRUCTURE = "metric,value,sd,grain_m,returns_m2\nrugosity,0.8,0.05,1,50\nheight_cv,1.1,,1,50\n"
_COLUMNS = "wavelength_nm,leaf\n" + _rows(_WAVES, _GREEN)
_EXPORT = "Wavelength\tleaf.asd\n" + _COLUMNS.split("\n", 1)[1].replace(",", "\t")
_LIBRARY_TEXT = (
    "Name: leaf\nType: vegetation\nX Units: Wavelength (micrometers)\n"
    "Y Units: Reflectance (percent)\n"
    f"Number of X Values: {len(_WAVES)}\n\n" + _rows(_WAVES / 1000, 100 * _GREEN).replace(",", "\t")
)


def _one(name: str, read: Callable[[Path], Any]) -> Callable[[Path], Any]:
    return lambda folder: read(folder / name)


def _plant(name: str) -> Callable[[Path], Any]:
    def read(folder: Path) -> Any:
        return plant_model_from_mesh(folder / name, 50)

    return read


def _scanned(name: str) -> Callable[[Path], Any]:
    def read(folder: Path) -> Any:
        points, normals, organ = read_scan(folder / name)
        try:  # it knows no file
            return plant_model_from_points(points, normals, 50, "leaf" if organ is None else organ)
        except InputError as error:
            raise InputError(str(error), file=folder / name) from error

    return read


def _with_table(folder: Path) -> Any:
    plot = read_plot(example_folder() / "plot.toml")
    return with_parameter_table(plot_parameters(plot), plot.taxa, folder / "parameters.csv")


def _shipped(name: str) -> Callable[[Path], Any]:
    return lambda folder: shutil.copy(lidar_folder() / name, folder / name)


def _blocks(name: str) -> Callable[[Path], Any]:
    def read(folder: Path) -> Any:
        with open_blocks(folder / name) as cube:
            rows = [cube.read(start, 1) for start in range(min(cube.shape[0], 100))]
            return cube.scale(), rows, cube.wavelength

    return read


def _emit(folder: Path) -> None:
    values = np.random.default_rng(0).uniform(0.02, 0.5, (9, 6, 4))
    write_emit(folder / "emit.nc", values, _cube().wavelength, _cube().fwhm)


def _placed(folder: Path) -> Any:
    with open_blocks(folder / "emit.nc") as cube, tempfile.TemporaryDirectory() as work:
        writer = MapWriter(Path(work) / "work", "fuzz", [("one", "1")], cube, 1)
        writer.write(0, 0, np.ones((1, *cube.shape)))
        writer.finish(Path(work) / "maps.tif", {})
        with warnings.catch_warnings():
            # Damage may leave no table, and so no place.
            warnings.simplefilter("ignore", NotGeoreferencedWarning)
            with rasterio.open(Path(work) / "maps.tif") as maps:
                return list(maps.transform), maps.read()


def _zarr(version: Literal[2, 3]) -> Callable[[Path], Any]:
    def write(folder: Path) -> None:
        cube = np.random.default_rng(0).uniform(0.02, 0.5, (4, 3, 4)).astype(np.float32)
        data = xr.Dataset(
            {"reflectance": (("y", "x", "band"), cube)},
            {"wavelength": ("band", _cube().wavelength, {"units": "nm"})},
        )
        data.to_zarr(folder / "cube.zarr", zarr_format=version, consolidated=False)

    return write


_KEPT = np.arange(6.0), np.ones(2)


def _kept(folder: Path) -> Any:
    kept = Journal(folder / "work", "fuzz").kept(0)
    assert kept is None or all(map(np.array_equal, kept, _KEPT))
    return kept


def _begun(folder: Path) -> MapWriter:
    """Maps of which one of two blocks is written."""
    like = CubeBlocks(
        folder / "cube.tif", (6, 4), np.ones(1), np.ones(1), np.ones(1, bool), PLACE, None, None
    )
    return MapWriter(folder / "work", "fuzz", [("one", "1")], like, 2)


def _taken_up(folder: Path) -> Any:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        maps = _begun(folder)
        rows = maps.read()[0, :3] if maps.done[0] else np.ones((3, 4))
    assert not maps.done[1]
    assert (rows == 1.0).all()
    return rows


def _image_with_metadata(folder: Path) -> None:
    _image(folder)
    text = "<PAMDataset><Metadata><MDI key='place'>a</MDI></Metadata></PAMDataset>"
    (folder / "image.tif.aux.xml").write_text(text, "utf-8")


def _training(folder: Path) -> None:
    """A regression of no use."""
    layer = jnp.ones((2, 44), jnp.float32), jnp.zeros(44, jnp.float32)
    waves = np.arange(450.0, 850.0, 100.0)
    posterior = AmortisedPosterior(
        middle=jnp.zeros(4), rows=jnp.ones((2, 4)), within=jnp.eye(4)[:2],
        points=jnp.zeros((8, 2)), outside=jnp.eye(4)[2:], layers=(layer,),
        values=jnp.tile(jnp.linspace(0.0, 1.0, 161), (8, 1)),
        distance=jnp.tile(jnp.linspace(0.0, 4.0, 2000), (2, 1)),
    )  # fmt: skip
    names = tuple(f"{w:g}nm" for w in waves)
    channels, bands = group_bands(BandSet(names, tuple(waves), (40.0,) * 4))
    record = {
        "kind": "fynjax training of maps", "sensor_bands": 4, "sun_zenith_deg": "[30, 30]",
        "stand_size_m": 3.0, "voxel_m": 0.25, "structure_m": 0.125,
    }  # fmt: skip
    trained = Training(posterior, channels, bands, StandSettings(), 4, record)
    write_training(folder / "training.nc", trained)


READERS: dict[str, Reader] = {
    "asd": Reader(
        lambda folder: (folder / "leaf.asd").write_bytes(asd(count=300, start=400.0)),
        _one("leaf.asd", read_spectra_file), missing=True,
    ),
    "spectra-columns": Reader(
        _text("leaf.csv", _COLUMNS), _one("leaf.csv", read_spectra_file), missing=True
    ),
    "spectra-rows": Reader(_text("leaf.csv", _wide()), _one("leaf.csv", read_spectra_file), True),
    "spectra-export": Reader(_text("leaf.txt", _EXPORT), _one("leaf.txt", read_spectra_file), True),
    "spectra-ecostress": Reader(
        _text("leaf.txt", _LIBRARY_TEXT), _one("leaf.txt", read_spectra_file), True
    ),
    "spectra-gzip": Reader(
        lambda folder: (folder / "leaf.csv.gz").write_bytes(gzip.compress(_COLUMNS.encode())),
        _one("leaf.csv.gz", read_spectra_file), True,
    ),
    "envi-library": Reader(_library, _one("lib.hdr", read_spectra_file), True),
    "cube-envi": Reader(
        lambda folder: write_cube_envi(folder / "cube.hdr", _cube(), {"source": "fuzz"}),
        _one("cube.hdr", read_cube), True,
    ),
    "cube-geotiff": Reader(
        lambda folder: write_cube_geotiff(folder / "cube.tif", _cube(), {"source": "fuzz"}),
        _one("cube.tif", read_cube), True,
    ),
    "cube-netcdf": Reader(
        lambda folder: write_cubes_netcdf(folder / "cube.nc", {"reflectance": _cube()}, {}),
        _one("cube.nc", lambda path: read_spectra_sample([path])), True,
    ),
    "blocks-envi": Reader(
        lambda folder: write_cube_envi(folder / "cube.hdr", _cube(), {}), _blocks("cube.hdr"), True
    ),
    "blocks-geotiff": Reader(
        lambda folder: write_cube_geotiff(folder / "cube.tif", _cube(), {}),
        _blocks("cube.tif"), True,
    ),
    "blocks-netcdf": Reader(
        lambda folder: write_cubes_netcdf(folder / "cube.nc", {"reflectance": _cube()}, {}),
        _blocks("cube.nc"), True,
    ),
    "blocks-zarr": Reader(_zarr(2), _blocks("cube.zarr"), True),
    "blocks-zarr3": Reader(_zarr(3), _blocks("cube.zarr"), True),
    "checkpoint": Reader(
        lambda folder: Journal(folder / "work", "fuzz").put(0, _KEPT), _kept
    ),
    "unfinished-maps": Reader(
        lambda folder: _begun(folder).write(0, 0, np.ones((1, 3, 4))), _taken_up
    ),
    "image-metadata": Reader(
        _image_with_metadata, _one("image.tif", read_drone_image), True
    ),
    "maps-emit": Reader(_emit, _placed, True),
    "training": Reader(_training, _one("training.nc", read_training)),
    "crowns": Reader(write_crowns, _one("plot.toml", read_plot)),
    "image": Reader(_image, _one("image.tif", read_drone_image), True),
    "bands": Reader(
        _raster("bands.tif", np.uint16, 4),
        _one("bands.tif", lambda path: read_band_stack([path])), True,
    ),
    "rededge": Reader(_capture, _read_capture),
    "dji": Reader(_dji, _read_dji),
    "frames-odm": Reader(frame_files.write_odm, _frames),
    "frames-pix4d": Reader(frame_files.write_pix4d, _frames),
    "frames-metashape": Reader(frame_files.write_metashape, _frames),
    "frames-dji": Reader(frame_files.write_dji_pictures, _frames),
    "frames-micasense": Reader(frame_files.write_micasense_pictures, _frames),
    "panel": Reader(
        lambda f: (_capture(f), _text("panel.csv", _PANEL)(f)),
        lambda f: panel_reflectance(str(f / "panel.csv"), _read_capture(f)),
    ),
    "probability-map": Reader(
        _raster("map.tif"), _one("map.tif", lambda path: read_probability_map(path, (10.0, 10.0)))
    ),
    "ground-map": Reader(
        _ground,
        _one("ground.tif", lambda path: read_cover_map(
            path, (10.0, 10.0), (10, 10), origin_m=None, option="origin_m")),
    ),
    "terrain": Reader(_terrain, _one("terrain.tif", read_terrain)),
    "las": Reader(_las("cloud.las"), _one("cloud.las", read_cloud)),
    "laz": Reader(_las("cloud.laz"), _one("cloud.laz", read_cloud)),
    "xyz": Reader(
        lambda f: (f / "cloud.xyz").write_text(_rows(*_points().T).replace(",", " "), "utf-8"),
        _one("cloud.xyz", read_cloud),
    ),
    "cloud-csv": Reader(
        lambda f: (f / "cloud.csv").write_text("x,y,z\n" + _rows(*_points().T), "utf-8"),
        _one("cloud.csv", read_cloud),
    ),
    "cloud-ply": Reader(_ply(True), _one("cloud.ply", read_cloud)),
    "cloud-ply-text": Reader(_ply(False), _one("cloud.ply", read_cloud)),
    **{f"mesh-{kind}": Reader(_mesh(f"plant.{kind}"), _plant(f"plant.{kind}"))
       for kind in ("ply", "obj", "stl", "glb")},
    "scan-ply": Reader(_scan("scan.ply"), _scanned("scan.ply")),
    "scan-csv": Reader(_scan("scan.csv"), _scanned("scan.csv")),
    "sensor": Reader(_text("own.toml", SENSOR), _one("own.toml", load_sensor)),
    "sensor-curves": Reader(_sensor, _one("own.toml", load_sensor)),
    "spectrometer": Reader(_spectrometer, _one("own.toml", load_sensor)),
    **{f"lidar-{name.split('_')[0]}": Reader(_shipped(f"{name}.toml"),
       _one(f"{name}.toml", load_lidar)) for name in ("flash_lidar_paper", "scanning_lidar")},
    "plot": Reader(_plot, _one("plot.toml", read_plot)),
    "parameters": Reader(_text("parameters.csv", PARAMETER_TABLE), _with_table),
    "statistics": Reader(
        _text("statistics.csv", _STATISTICS), _one("statistics.csv", read_statistics), True
    ),
    "workbook": Reader(_workbook, _one("statistics.xlsx", read_statistics), True),
    "structure": Reader(
        _text("structure.csv", _STRUCTURE), _one("structure.csv", read_structure), True
    ),
    "prior": Reader(
        lambda f: shutil.copy(example_folder().parent / "fynbos_2023.toml", f / "prior.toml"),
        _one("prior.toml", read_prior),
    ),
    "atmosphere": Reader(_text("air.csv", _AIR), _one("air.csv", read_atmosphere)),
    "atmosphere-netcdf": Reader(_air, _one("air.nc", read_atmosphere)),
}  # fmt: skip
"""By name."""
