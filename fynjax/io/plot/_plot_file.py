"""`plot.toml` and its tables, read into plain, validated records.

`read_plot` is the only door: whatever it returns is complete, in SI units and within range.
"""

import warnings
from importlib.resources import files
from pathlib import Path

import numpy as np

from fynjax._core.errors import InputError
from fynjax.canopy import FORMS
from fynjax.io.plot._crowns import with_crowns
from fynjax.io.plot._plot import Calibration, Floats, Ground, LeafSource, Plot, Sky, Species
from fynjax.io.plot._plot_tables import COVER_FRACTIONS, PlotFile
from fynjax.io.plot._rows import LeafRow, SkyPatternRow, SkyRow, SpeciesRow
from fynjax.io.plot._sensor import DRONE, plot_air, plot_sensor, plot_sun
from fynjax.io.text import did_you_mean, existing_file, line_of, named_file, read_rows, read_toml
from fynjax.leaf import structure_from_dry_matter
from fynjax.scene import LEAF_FIELDS, PARAMETERS


def example_folder() -> Path:
    """Folder of the shipped example plot: table 1 of the paper, burnt in 2006."""
    return Path(str(files("fynjax.io.plot") / "data" / "plot_2006"))


def shipped_growth_forms() -> dict[str, str]:
    """Growth form of each taxon of the shipped species table."""
    rows = read_rows(example_folder() / "species.csv", SpeciesRow, "a species table")
    return {row.taxon: str(row.growth_form) for _, row in rows}


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


def _read_species(path: Path) -> list[tuple[int, SpeciesRow]]:
    rows = read_rows(path, SpeciesRow, "a species table")
    row_of: dict[str, int] = {}
    for number, row in rows:
        if row.taxon in row_of:
            raise InputError(
                f"{row.taxon!r} is in row {row_of[row.taxon]} already. Add the covers up, or give "
                "the two layers different names.",
                file=path,
                row=number,
                column="taxon",
            )
        row_of[row.taxon] = number
    total = sum(row.cover_percent for _, row in rows)
    if total > 300:
        raise InputError(
            f"expected covers that sum to at most 300 % (layers may overlap), but they sum to "
            f"{total:g} %. Are these counts?",
            file=path,
            column="cover_percent",
        )
    largest = max(row.cover_percent for _, row in rows)
    if 0 < largest <= 1 and total <= 1.5:
        warnings.warn(
            f"{path}: the largest cover is {largest:g} %. Are these fractions? Percent is "
            f"expected: {largest:g} would be {largest * 100:g}.",
            stacklevel=3,
        )
    return rows


def _growth_form(row: SpeciesRow, shipped: dict[str, str], path: Path, number: int) -> str:
    form = row.growth_form or shipped.get(row.taxon)
    if form is None:
        raise InputError(
            f"expected a growth form for {row.taxon!r}, which is not in the shipped table."
            f"{did_you_mean(row.taxon, shipped)} Add a column growth_form with one of "
            f"{', '.join(FORMS)}.",
            file=path,
            row=number,
            column="growth_form",
        )
    return form


def _read_leaves(path: Path, taxa: list[str], within: Path | None) -> dict[str, LeafSource]:
    sources: dict[str, LeafSource] = {}
    for number, row in read_rows(path, LeafRow, "a leaf table"):
        if row.taxon != "*" and row.taxon not in taxa:
            raise InputError(
                f"unknown taxon {row.taxon!r}: it is not in the species table."
                f"{did_you_mean(row.taxon, taxa)}",
                file=path,
                row=number,
                column="taxon",
            )
        if row.taxon in sources:
            raise InputError(f"{row.taxon!r} is there twice", file=path, row=number, column="taxon")
        if row.spectrum is not None:
            spectrum = named_file(
                path, row.spectrum, "a leaf spectrum", within=within, row=number, column="spectrum"
            )
            sources[row.taxon] = LeafSource(None, spectrum)
        else:
            values = {name: _stated(getattr(row, name), name) for name in LEAF_FIELDS}
            if row.structure is None:
                values["structure"] = float(structure_from_dry_matter(values["dry_matter"]))
            sources[row.taxon] = LeafSource(values, None)
    return sources


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

    rows = _read_species(species_path)
    shipped, taxa = shipped_growth_forms(), [row.taxon for _, row in rows]
    leaves = {} if leaf_path is None else _read_leaves(leaf_path, taxa, within)
    species = []
    for number, row in rows:
        form = _growth_form(row, shipped, species_path, number)
        diameter = _stated(row.mean_diameter_cm, "diameter")
        if diameter > min(size):
            raise InputError(
                f"expected a crown smaller than the plot ({min(size):g} m), but got "
                f"{row.mean_diameter_cm:g} cm",
                file=species_path,
                row=number,
                column="mean_diameter_cm",
            )
        leaf = leaves.get(row.taxon, leaves.get("*"))
        if leaf_path is not None and leaf is None and form != "deadwood":
            raise InputError(
                f"expected leaf optics for {row.taxon!r}, but it has no row. Add one, or a row "
                "'*' for all that have none.",
                file=leaf_path,
                column="taxon",
            )
        species.append(
            Species(
                taxon=row.taxon,
                diameter_m=diameter,
                cover=_stated(row.cover_percent, "cover"),
                height_m=row.height_max_m,
                growth_form=form,
                leaf=None if form == "deadwood" else leaf,
                packing=_stated(row.packing_percent, "packing"),
                fill=_stated(row.fill_percent, "fill"),
                branches=row.branches,
                rotation_spread_deg=row.rotation_spread_deg,
                minimum_object_area_m2=row.minimum_object_area_m2,
                leaf_area_index=row.leaf_area_index,
                wood_area_index=row.wood_area_index,
                plant=named_file(
                    species_path, row.plant, "a plant", within=within, row=number, column="plant"
                )
                if row.plant
                else None,
                shoot_clumping=row.shoot_clumping,
                dead_fraction=row.dead_fraction,
            )
        )
    sensor = plot_sensor(parsed.sensor, sensor_path, path, text)
    tallest = max(s.height_m for s in species)
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
    spectra = [leaf.spectrum for leaf in leaves.values()]
    inputs = (
        *(path, species_path, leaf_path, map_path, sky_path, soil_path, cover_map),
        *(terrain_path, sensor_path, air_path, values_path, dead_path),
        *(pattern_path, crowns_path),
        *cover_paths,
        *(entry.plant for entry in species),
        *spectra,
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
        species=tuple(species),
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
