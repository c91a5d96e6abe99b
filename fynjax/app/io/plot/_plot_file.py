"""`plot.toml` and its tables, read into plain, validated records.

`read_plot` is the only door: whatever it returns is complete, in SI units and within range.
"""

from collections.abc import Callable, Iterable, Sequence
from fnmatch import fnmatchcase
from importlib.resources import files
from pathlib import Path

from fynjax._core.errors import InputError, names_file
from fynjax.app.io.plot._crowns import with_crowns
from fynjax.app.io.plot._leaf_spectra import spectra_by_taxon
from fynjax.app.io.plot._place import placed_by
from fynjax.app.io.plot._plot import Plot
from fynjax.app.io.plot._plot_tables import PlotFile
from fynjax.app.io.plot._rows import read_sky, read_sky_pattern
from fynjax.app.io.plot._sensor import DRONE, named_sensor, sensor_place
from fynjax.app.io.text import existing_file, line_of, read_rows, read_toml
from fynjax.canopy import FORMS
from fynjax.scene import (
    CoverDefinition,
    LeafRow,
    SpeciesRow,
    check_materials,
    check_species,
    check_taxa,
    cover_definition_of,
)


def example_folder() -> Path:
    """Folder of the shipped example plot: table 1 of the paper, burnt in 2006."""
    return Path(str(files("fynjax.app.io.plot") / "data" / "plot_2006"))


HEATH_TABLE = Path(str(files("fynjax.app.io.plot") / "data" / "heath.csv"))
"""Table of plants of a wet heath at Glomel, Brittany, in the words of those who wrote it."""
HEATH_PLACE = (48.22, -3.42)
"""Latitude and longitude of that heath [degree]."""


@names_file
def _read_species(
    path: Path,
    within: Path | None,
    size: tuple[float, float],
    cover_definition: CoverDefinition | None,
) -> tuple[SpeciesRow, ...]:
    rows = read_rows(path, SpeciesRow, "a species table", within=within)
    check_species(rows, path, cover_definition)
    for number, row in rows:
        if row.diameter > min(size):
            raise InputError(
                f"expected a crown smaller than the plot ({min(size):g} m), but got "
                f"{100 * row.diameter:g} cm",
                row=number,
                column="mean_diameter_cm",
            )
        if row.groups > min(size):
            raise InputError(
                f"expected groups of plants smaller than the plot ({min(size):g} m), but got a "
                f"radius of {row.groups:g} m. Centimetres?",
                row=number,
                column="clumping_m",
            )
    return tuple(row for _, row in rows)


@names_file
def _read_leaves(
    path: Path, within: Path | None, species: Sequence[SpeciesRow], measured: Iterable[str] = ()
) -> tuple[LeafRow, ...]:
    rows = read_rows(path, LeafRow, "a leaf table", within=within)
    check_taxa(rows, [*(row.taxon for row in species), "*"], path)
    check_materials(rows, path)
    named = {row.taxon for _, row in rows if not row.material or row.taxon != "*"} | set(measured)
    for i, (number, row) in enumerate(rows):
        if row.taxon in measured and not row.material:
            words = f"the plot's leaf_spectra have leaves of {row.taxon!r} too: leave one out"
            raise InputError(words, row=number, column="taxon")
        if row in [earlier for _, earlier in rows[:i]]:
            raise InputError(
                f"this leaf of {row.taxon!r} is there twice. Of several leaves of a taxon each "
                "plant has one: they must differ.",
                row=number,
                column="taxon",
            )
    for one in species:
        if not named & {one.taxon, "*"} and FORMS[one.growth_form].leafy:
            raise InputError(
                f"expected leaf optics for {one.taxon!r}, but it has no row. Add one, or a row "
                "'*' for all that have none.",
                column="taxon",
            )
    return tuple(row for _, row in rows)


def as_plot(plot: Plot | str | Path) -> Plot:
    """`plot` as it is, or read from its file by `read_plot`, whose errors are raised."""
    return plot if isinstance(plot, Plot) else read_plot(plot)


_Refused = Callable[[str, str], InputError]
"""Makes the error of a key of the plot file, from the key and what is wrong."""


def _check_table(parsed: PlotFile, refused: _Refused) -> None:
    """Refuse sides that voxels do not divide, and what is stated twice."""
    table = parsed.plot
    for side in table.size_m:
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
    placed = table.latitude_deg is not None and table.longitude_deg is not None
    if placed and parsed.sun.place is not None:
        raise refused(
            "plot.latitude_deg",
            "expected the place under [plot] or, with a time, under [sun], but got both: leave "
            "it out here",
        )


def _check_priors(patterns: Iterable[str], taxa: Sequence[str], refused: _Refused) -> None:
    """Refuse priors of species that the plot does not have."""

    def is_there(pattern: str) -> bool:
        words = pattern.removeprefix("species.").split(".")
        starts = [".".join(words[: k + 1]) for k in range(len(words))]
        return any(fnmatchcase(taxon, start) for taxon in taxa for start in starts)

    absent = [p for p in patterns if p.startswith("species.") and not is_there(p)]
    if absent:
        more = f" So it is of {', '.join(map(repr, absent[1:]))}." if absent[1:] else ""
        raise refused(
            f"calibration.priors {absent[0]}",
            "no taxon of the species table has this name. Delete the line, or name one that is "
            f"there.{more}",
        )


def _check_sensor(plot: Plot, refused: _Refused) -> None:
    """Refuse a sensor among the plants, and a pixel that is wider than the plot."""
    altitude, pixel = sensor_place(plot)
    tallest = max(row.height for row in plot.species)
    if altitude <= tallest:
        raise refused(
            "sensor.altitude_m",
            f"expected a sensor above the plants ({tallest:g} m), but got {altitude:g} m",
        )
    # A drone's pixel as wide as the plot is a slip, a satellite's is not: the plot goes on.
    slip = '. A plot with boundary = "periodic" goes on for ever, and fills any pixel.'
    side, drone = min(plot.size_m), plot.sensor.name == DRONE
    if pixel > side and (drone or plot.boundary == "open"):
        raise refused(
            "sensor.pixel_m",
            f"expected a pixel of at most the plot's side, {side:g} m, but got {pixel:g} m"
            f"{'' if drone else slip}",
        )


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

    >>> from fynjax.app.io.plot import example_folder, read_plot
    >>> plot = read_plot(example_folder() / "plot.toml")
    >>> len(plot.species), plot.species[0].taxon, plot.size_m
    (13, 'Metalasia muricata', (10.0, 10.0))
    """
    path = existing_file(path, "a plot file").resolve()
    within = None if allow_outside else path.parent
    parsed, text = read_toml(path, PlotFile, within=within)
    table, size = parsed.plot, parsed.plot.size_m

    def refused(key: str, message: str) -> InputError:
        table, blank, pattern = key.partition(" ")  # a pattern may hold points
        place = (table, pattern) if blank else tuple(key.split("."))
        return InputError(message, file=path, row=line_of(text, place), column=pattern or key)

    _check_table(parsed, refused)
    stated = parsed.sun.place
    if table.latitude_deg is not None and table.longitude_deg is not None:
        stated = table.latitude_deg, table.longitude_deg
    species_path, leaf_path = table.species_table, table.leaf_table
    species = _read_species(species_path, within, size, table.cover_definition)
    _check_priors(parsed.calibration.priors, [row.taxon for row in species], refused)
    spectra: dict[str, tuple[Path, ...]] = {}
    if table.leaf_spectra is not None:
        taxa = [row.taxon for row in species if FORMS[row.growth_form].leafy]
        spectra = spectra_by_taxon(table.leaf_spectra, taxa, within)
    leaves = () if leaf_path is None else _read_leaves(leaf_path, within, species, spectra)
    if parsed.sky.table is not None:
        read_sky(parsed.sky.table)
    if parsed.sky.pattern is not None:
        read_sky_pattern(parsed.sky.pattern)
    in_tables: list[object] = [row.plant for row in species]
    in_tables += [f for row in leaves for f in (row.spectrum, row.reflectance, row.transmittance)]
    in_tables += [file for files in spectra.values() for file in files]
    named = (file for file in parsed.named_files if file.is_file())
    plot = Plot.model_construct(  # of parts that are checked
        **dict(table) | {"cover_definition": cover_definition_of(species, table.cover_definition)},
        **dict(parsed.scene),
        file=path,
        species=species,
        leaves=leaves,
        sun=parsed.sun.position(),
        sun_table=parsed.sun,
        place_deg=stated,
        sky=parsed.sky,
        ground=parsed.ground,
        sensor=named_sensor(parsed.sensor),
        air=parsed.atmosphere,
        calibration=parsed.calibration,
        targets=tuple(parsed.target),
        leaf_files=spectra,
        inputs=(path, *named, *(p for p in in_tables if isinstance(p, Path))),
    )
    _check_sensor(plot, refused)
    plot = placed_by(plot, plot.maps.values())
    return plot if table.crowns is None else with_crowns(plot, table.crowns)
