"""`plot.toml` and its tables, read into plain, validated records.

`read_plot` is the only door: whatever it returns is complete, in SI units and within range.
"""

import warnings
from importlib.resources import files
from pathlib import Path

from fynjax._core.errors import InputError
from fynjax.canopy import FORMS
from fynjax.io.plot._crowns import with_crowns
from fynjax.io.plot._plot import LeafSource, Plot, Species
from fynjax.io.plot._plot_tables import PlotFile
from fynjax.io.plot._rows import LeafRow, SpeciesRow
from fynjax.io.plot._sensor import DRONE, named_sensor, sensor_place
from fynjax.io.plot._sky import read_sky, read_sky_pattern
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
    parsed, text = read_toml(path, PlotFile, within=within)
    table, size = parsed.plot, parsed.plot.size_m

    def refused(key: str, message: str) -> InputError:
        return InputError(message, file=path, row=line_of(text, tuple(key.split("."))), column=key)

    for side in size:
        count = round(side / table.voxel_m)
        if count < 1 or abs(side / table.voxel_m - count) > 1e-6 * max(count, 1):
            raise refused(
                "plot.size_m",
                f"expected a whole number of voxels of {table.voxel_m:g} m, but got {side:g} m. "
                f"The nearest is {max(count, 1) * table.voxel_m:g} m.",
            )
    if parsed.ground.rpv is not None and table.terrain is not None:
        raise refused(
            "ground.rpv",
            "expected rpv or a terrain, but got both: ground with a shape of its own must be level",
        )
    species_path, leaf_path = table.species_table, table.leaf_table
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
    if parsed.sky.table is not None:
        read_sky(parsed.sky.table)
    if parsed.sky.pattern is not None:
        read_sky_pattern(parsed.sky.pattern)
    in_tables = [*(s.plant for s in species), *(leaf.spectrum for leaf in leaves.values())]
    plot = Plot.model_construct(  # of parts that are checked
        **dict(table),
        **dict(parsed.scene),
        file=path,
        species=tuple(species),
        sun=parsed.sun.position,
        sky=parsed.sky,
        ground=parsed.ground,
        sensor=named_sensor(parsed.sensor),
        air=parsed.atmosphere,
        calibration=parsed.calibration,
        inputs=(path, *parsed.named_files, *(p for p in in_tables if p is not None)),
    )
    altitude, pixel = sensor_place(plot)
    tallest = max(s.height_m for s in species)
    if altitude <= tallest:
        raise refused(
            "sensor.altitude_m",
            f"expected a sensor above the plants ({tallest:g} m), but got {altitude:g} m",
        )
    # A drone's pixel as wide as the plot is a slip, a satellite's is not: the plot goes on.
    slip = '. A plot with boundary = "periodic" goes on for ever, and fills any pixel.'
    if pixel > min(size) and (plot.sensor.name == DRONE or table.boundary == "open"):
        raise refused(
            "sensor.pixel_m",
            f"expected a pixel of at most the plot's side, {min(size):g} m, but got {pixel:g} m"
            f"{'' if plot.sensor.name == DRONE else slip}",
        )
    return plot if table.crowns is None else with_crowns(plot, table.crowns)
