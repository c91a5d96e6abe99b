"""`plot.toml` and its tables, read into plain, validated records.

`read_plot` is the only door: whatever it returns is complete, in SI units and within range.
"""

from collections.abc import Sequence
from importlib.resources import files
from pathlib import Path

import numpy as np

from fynjax._core.errors import InputError
from fynjax._core.validation import Row
from fynjax.canopy import FORMS
from fynjax.io.plot._crowns import with_crowns
from fynjax.io.plot._plot import Calibration, Floats, Ground, Plot, Sky
from fynjax.io.plot._plot_tables import COVER_FRACTIONS, PlotFile
from fynjax.io.plot._rows import SkyPatternRow, SkyRow
from fynjax.io.plot._sensor import DRONE, plot_air, plot_sensor, plot_sun
from fynjax.io.text import existing_file, line_of, named_file, read_rows, read_toml
from fynjax.scene import PARAMETERS, LeafRow, SpeciesRow, check_species, check_taxa


def example_folder() -> Path:
    """Folder of the shipped example plot: table 1 of the paper, burnt in 2006."""
    return Path(str(files("fynjax.io.plot") / "data" / "plot_2006"))


def _size(
    size: float | tuple[float, float], voxel: float, path: Path, text: str
) -> tuple[float, float]:
    sides = size if isinstance(size, tuple) else (size, size)
    for side in sides:
        count = round(side / voxel)
        if count < 1 or abs(side / voxel - count) > 1e-6 * max(count, 1):
            raise InputError(
                f"expected a whole number of voxels of {voxel:g} m, but got {side:g} m. "
                f"The nearest is {max(count, 1) * voxel:g} m.",
                file=path,
                row=line_of(text, ("plot", "size_m")),
                column="plot.size_m",
            )
    return (float(sides[0]), float(sides[1]))


def _read_species(
    path: Path, within: Path | None, size: tuple[float, float]
) -> tuple[SpeciesRow, ...]:
    rows = read_rows(path, SpeciesRow, "a species table")
    check_species(rows, path)
    for number, row in rows:
        if row.diameter > min(size):
            raise InputError(
                f"expected a crown smaller than the plot ({min(size):g} m), but got "
                f"{100 * row.diameter:g} cm",
                file=path,
                row=number,
                column="mean_diameter_cm",
            )
    return tuple(_located(row, number, "plant", "a plant", path, within) for number, row in rows)


def _read_leaves(
    path: Path, within: Path | None, species: Sequence[SpeciesRow]
) -> tuple[LeafRow, ...]:
    rows = read_rows(path, LeafRow, "a leaf table")
    check_taxa(rows, [*(row.taxon for row in species), "*"], path)
    named = {row.taxon for _, row in rows}
    for one in species:
        if not named & {one.taxon, "*"} and FORMS[one.growth_form].leafy:
            raise InputError(
                f"expected leaf optics for {one.taxon!r}, but it has no row. Add one, or a row "
                "'*' for all that have none.",
                file=path,
                column="taxon",
            )
    what = "a leaf spectrum"
    return tuple(_located(row, number, "spectrum", what, path, within) for number, row in rows)


def _located(
    row: Row, number: int, column: str, what: str, table: Path, within: Path | None
) -> Row:
    """The row of a table with the place of the file that it names."""
    if (name := getattr(row, column)) is None:
        return row
    path = named_file(table, str(name), what, within=within, row=number, column=column)
    return row.model_copy(update={column: path})


def _stated(value: float | None, kind: str) -> float:
    """What a file states of a parameter, in the parameter's unit, or its default."""
    record = PARAMETERS[kind]
    if value is None:
        assert record.default is not None
        return record.default
    return value / record.shown_factor


def _read_sky(path: Path) -> tuple[Floats, Floats]:
    rows = read_rows(path, SkyRow, "a sky table")
    wavelength = np.array([row.wavelength_nm for _, row in rows])
    if (falls := np.flatnonzero(np.diff(wavelength) <= 0)).size:
        raise InputError(
            f"expected rising wavelengths, but {wavelength[falls[0] + 1]:g} follows "
            f"{wavelength[falls[0]]:g}",
            file=path,
            row=rows[falls[0] + 1][0],
            column="wavelength_nm",
        )
    return wavelength, np.array([row.diffuse_fraction for _, row in rows])


def _read_sky_pattern(path: Path) -> Floats:
    """Radiance [zenith, azimuth] on the even grid of a pattern."""
    rows = [row for _, row in read_rows(path, SkyPatternRow, "a pattern of the sky")]
    zenith = np.unique([row.zenith_deg for row in rows])
    azimuth = np.unique([row.azimuth_deg for row in rows])
    even = len(zenith) > 1 and np.allclose(zenith, np.linspace(0.0, 90.0, len(zenith)), atol=1e-3)
    around = np.allclose(azimuth, np.arange(len(azimuth)) * 360.0 / len(azimuth), atol=1e-3)
    places = {(row.zenith_deg, row.azimuth_deg) for row in rows}
    if not (even and around and len(places) == len(rows) == len(zenith) * len(azimuth)):
        raise InputError(
            "expected every pair of even zenith angles from 0 to 90 degrees and even azimuths from "
            f"0 on once, 360 left out, but got {len(rows)} rows with {len(zenith)} zenith angles "
            f"and {len(azimuth)} azimuths",
            file=path,
        )
    if not any(row.radiance > 0 for row in rows):
        raise InputError("expected some light, but every radiance is 0", file=path)
    ordered = sorted(rows, key=lambda row: (row.zenith_deg, row.azimuth_deg))
    return np.array([row.radiance for row in ordered]).reshape(len(zenith), len(azimuth))


def as_plot(plot: Plot | str | Path) -> Plot:
    """`plot` as it is, or read from its file by `read_plot`, whose errors are raised."""
    return plot if isinstance(plot, Plot) else read_plot(plot)


def read_plot(path: str | Path, *, allow_outside: bool = False) -> Plot:
    """Read and check a plot file and every table it names.

    **Arguments:**

    - `path`: a plot file, `plot.toml`. Paths in it start from its own folder, paths in a table
      from the table's folder.
    - `allow_outside`: whether these may lead out of the plot file's folder. A plot file from
      somebody else would then choose what of this machine is read.

    **Returns:** a `Plot`. Spectra and rasters are named in it, not yet read.

    **Raises:** `InputError` with file, row (as an editor counts), column, the value, what was
    expected and the likely slip. Warns where covers look like fractions.

    >>> from fynjax.io.plot import example_folder, read_plot
    >>> plot = read_plot(example_folder() / "plot.toml")
    >>> len(plot.species), plot.species[0].taxon, plot.size_m
    (13, 'Metalasia muricata', (10.0, 10.0))
    """
    path = existing_file(path, "a plot file").resolve()
    within = None if allow_outside else path.parent
    parsed, text = read_toml(path, PlotFile)
    size = _size(parsed.plot.size_m, parsed.plot.voxel_m, path, text)

    def named(table: str, key: str, name: str | None, what: str) -> Path | None:
        if name is None:
            return None
        row, column = line_of(text, (table, key)), f"{table}.{key}"
        return named_file(path, name, what, within=within, row=row, column=column)

    species_path = named("plot", "species_table", parsed.plot.species_table, "a species table")
    assert species_path is not None
    crowns_path = named("plot", "crowns", parsed.plot.crowns, "a table of crowns")
    leaf_path = named("plot", "leaf_table", parsed.plot.leaf_table, "a leaf table")
    map_path = named("plot", "probability_map", parsed.plot.probability_map, "a GeoTIFF")
    terrain_path = named("plot", "terrain", parsed.plot.terrain, "a GeoTIFF")
    dead_path = named("plot", "dead_tissue", parsed.plot.dead_tissue, "a spectrum of dead tissue")
    sky_path = named("sky", "table", parsed.sky.table, "a sky table")
    pattern_path = named("sky", "pattern", parsed.sky.pattern, "a pattern of the sky")
    if parsed.ground.rpv is not None and parsed.plot.terrain is not None:
        raise InputError(
            "expected rpv or a terrain, but got both: ground with a shape of its own must be level",
            file=path,
            row=line_of(text, ("ground", "rpv")),
            column="ground.rpv",
        )
    own_soil = None if parsed.ground.soil in ("dry", "wet") else parsed.ground.soil
    soil_path = named("ground", "soil", own_soil, "'dry', 'wet' or a soil spectrum")

    cover_paths = [
        named("ground", cover, getattr(parsed.ground, cover), f"a spectrum of {cover}")
        for cover in ("litter", "char", "rock")
    ]
    cover_map = named("ground", "map", parsed.ground.map, "a GeoTIFF")
    sensor_path = named("sensor", "path", parsed.sensor.path, "a sensor file")
    scene = parsed.scene
    values_path = named("scene", "parameters", scene.parameters, "a table of parameters")
    air = parsed.atmosphere
    air_path = None if air is None else named("atmosphere", "file", air.file, "curves of the air")

    species = _read_species(species_path, within, size)
    leaves = () if leaf_path is None else _read_leaves(leaf_path, within, species)
    sensor = plot_sensor(parsed.sensor, sensor_path, path, text)
    tallest = max(row.height for row in species)
    if sensor.altitude_m <= tallest:
        raise InputError(
            f"expected a sensor above the plants ({tallest:g} m), but got {sensor.altitude_m:g} m",
            file=path,
            row=line_of(text, ("sensor", "altitude_m")),
            column="sensor.altitude_m",
        )
    # A drone's pixel as wide as the plot is a slip, a satellite's is not: the plot goes on.
    slip = '. A plot with boundary = "periodic" goes on for ever, and fills any pixel.'
    if sensor.pixel_m > min(size) and (sensor.name == DRONE or parsed.plot.boundary == "open"):
        raise InputError(
            f"expected a pixel of at most the plot's side, {min(size):g} m, but got "
            f"{sensor.pixel_m:g} m"
            f"{'' if sensor.name == DRONE else slip}",
            file=path,
            row=line_of(text, ("sensor", "pixel_m")),
            column="sensor.pixel_m",
        )
    wavelength, diffuse = (None, None) if sky_path is None else _read_sky(sky_path)
    inputs = (
        *(path, species_path, leaf_path, map_path, sky_path, soil_path, cover_map),
        *(terrain_path, sensor_path, air_path, values_path, dead_path),
        *(pattern_path, crowns_path),
        *cover_paths,
        *(row.plant for row in species),
        *(row.spectrum for row in leaves),
    )
    fractions = [_stated(getattr(parsed.ground, name), name) for name in COVER_FRACTIONS]
    wet = 1.0 if parsed.ground.soil == "wet" else None
    # The default is learned with the shipped bark in place of dead tissue.
    wood = parsed.ground.wood_brightness
    wood = 1.0 if wood is None and dead_path is not None else wood
    moisture = wet if parsed.ground.moisture is None else parsed.ground.moisture
    calibration = parsed.calibration
    plot = Plot(
        file=path,
        name=parsed.plot.name,
        size_m=size,
        voxel_m=parsed.plot.voxel_m,
        structure_m=parsed.plot.structure_m,
        boundary=parsed.plot.boundary,
        species=species,
        leaves=leaves,
        probability_map=map_path,
        terrain=terrain_path,
        map_origin_m=parsed.plot.map_origin_m,
        sun=plot_sun(parsed.sun, path, text),
        sky=Sky(
            parsed.sky.aerosol_optical_depth,
            wavelength,
            diffuse,
            None if pattern_path is None else _read_sky_pattern(pattern_path),
        ),
        ground=Ground(
            soil_path,
            parsed.ground.brightness,
            _stated(moisture, "moisture"),
            (fractions[0], fractions[1], fractions[2]),
            (cover_paths[0], cover_paths[1], cover_paths[2]),
            parsed.ground.patch_m,
            cover_map,
            parsed.ground.rpv,
            _stated(wood, "wood_brightness"),
        ),
        sensor=sensor,
        air=plot_air(air, air_path),
        seed=scene.seed,
        softness=scene.softness,
        softness_plants=scene.softness_plants,
        dead_tissue=dead_path,
        hot_spot=parsed.plot.hot_spot,
        parameters=values_path,
        calibration=Calibration(
            free=tuple(calibration.free),
            targets=tuple(calibration.targets),
            target_sd=calibration.target_sd,
            gain_sd=calibration.gain_sd,
            priors=dict(calibration.priors),
            max_iterations=calibration.max_iterations,
            starts=calibration.starts,
            pixel_sd=calibration.pixel_sd,
            block_m=calibration.block_m,
        ),
        inputs=tuple(p for p in inputs if p is not None),
    )
    return plot if crowns_path is None else with_crowns(plot, crowns_path)
