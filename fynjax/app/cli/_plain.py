"""Commands that compute nothing: they write a plot's first files, or print what they find."""

import sys
import webbrowser
from collections.abc import Sequence
from pathlib import Path
from typing import Literal

import typer

from fynjax._core.arguments import Seed
from fynjax._core.errors import InputError

_PAGE = "report.html"


def init(
    folder: str | Path | None = None,
    *,
    output: str | Path | None = None,
    table: str | Path | None = None,
    place: tuple[float, float] | None = None,
    image: str | Path | None = None,
    leaves: str | Path | None = None,
    example: Literal["heath", "fynbos"] | None = None,
    burnt: int | None = None,
    prior: str | Path | None = None,
    seed: Seed = 0,
    json: bool = False,
    quiet: bool = False,
) -> None:
    """Write a commented plot file, of your own table or of an example, that builds as it is.

    Never overwrites a file. Without a table: `fynjax init my_plot && fynjax build
    my_plot/plot.toml`.

    **Arguments:**

    - `folder`: folder to make.
    - `output`: folder to make, as the argument DIR.
    - `table`: table of plants of your own (CSV or Excel), its columns in your own words: name,
      cover, and what is known of height, crown diameter, growth or life form, family.
    - `place`: latitude and longitude of the plot [degrees], such as 43.75,3.70, south and west
      negative; left out, those of the image.
    - `image`: image of the plot: its place, time, camera and pixel become the plot's.
    - `leaves`: folder of leaf spectra, named after their taxon; it is copied.
    - `example`: without a table: a wet heath in Brittany (if left out), or the fynbos plot of the
      article with its leaves and what the drone measured.
    - `burnt`: year of the fynbos plot's last fire. 2006, if left out, is the published plot; 2016,
      2019 and others are built on assumptions about recovery, which their files state.
    - `prior`: population whose means and spreads the files state: the name of a shipped one, a file
      that `fynjax bioscape learn` wrote, or none. Left out: of the fynbos plot the shipped one; of
      others only which plants are meant, by their place.
    - `seed`: seed of every random number of the plot.
    - `json`: print a summary as JSON on stdout, and nothing else.
    - `quiet`: no text.
    """
    from fynjax.app.cli._runtime import show
    from fynjax.app.io.plot import DEFAULT_PRIOR, HEATH_PLACE, HEATH_TABLE
    from fynjax.app.jobs import init_from_table
    from fynjax.studies import fynbos_2006

    if folder is not None and output is not None and Path(folder) != Path(output):
        raise InputError(f"expected one folder, but got {str(folder)!r} and {str(output)!r}")
    target = Path(folder or output or "fynjax_plot")
    given = {"--place": place, "--image": image, "--leaves": leaves}
    with_table = [flag for flag, value in given.items() if value is not None]
    if table is None and with_table:
        raise InputError(
            f"expected `--table`, your table of plants, with `{with_table[0]}`, but got none"
        )
    of_example = {"--example": example, "--burnt": burnt}
    stated = [flag for flag, value in of_example.items() if value is not None]
    if table is not None and stated:
        raise InputError(f"expected `--table` or `{stated[0]}`, but got both: leave one out")
    if example == "heath" and burnt is not None:
        raise InputError("expected `--example fynbos` with `--burnt`, but got heath")
    if example == "fynbos" or burnt is not None:
        burnt = fynbos_2006.PUBLISHED if burnt is None else burnt
        result = fynbos_2006.init(target, burnt=burnt, prior=prior or DEFAULT_PRIOR, seed=seed)
    elif table is None:
        result = init_from_table(
            target, HEATH_TABLE, place=HEATH_PLACE, prior=prior, seed=seed, name="Wet heath, Glomel"
        )
    else:
        result = init_from_table(
            target, table, place=place, image=image, leaves=leaves, prior=prior, seed=seed
        )
    if json:
        print(result.model_dump_json(indent=2))
        return
    for line in result.warnings:
        if not any(line in said for said in result.headline):
            print(f"fynjax: warning: {line}", file=sys.stderr)
    if not quiet:
        show(result)
        print(f"Next: fynjax build {target / 'plot.toml'}")


def view(run: str | Path, *, print_path: bool = False) -> None:
    """Open the report page of a run in the browser.

    Where there is no browser its path is printed.

    **Arguments:**

    - `run`: folder of a finished run, or its page.
    - `print_path`: print the path of the page and open nothing.
    """
    from fynjax.app.io.text import existing_file

    run = Path(run)
    if run.is_dir() and not (run / _PAGE).is_file():
        written = sorted(p.name for p in run.iterdir() if p.is_file())
        raise InputError(
            f"expected the folder of a run with {_PAGE}, but this has "
            + (f"{', '.join(written[:8])}" if written else "no files"),
            file=run,
        )
    page = existing_file(run / _PAGE if run.is_dir() else run, "a report page").resolve()
    if print_path or not webbrowser.open(page.as_uri()):
        print(page)


def sensors(*, json: bool = False) -> None:
    """List the shipped sensors: cameras, imaging spectrometers and LiDAR systems.

    Any of their names goes into a plot file (`[sensor]`) or to `fynjax simulate --sensor`.

    **Arguments:**

    - `json`: print the table as JSON.
    """
    from rich.console import Console
    from rich.table import Table

    from fynjax.sensors import sensor_reference

    known = sensor_reference()
    if json:
        print(known.to_json(orient="records"))
        return
    table = Table(box=None)
    for heading in ("name", "kind", "bands", "nm", "pixel, m", "from, m"):
        table.add_column(heading, no_wrap=True)
    for row in known.to_dict("records"):
        ends = dict.fromkeys(f"{row[end]:.0f}" for end in ("lower_nm", "upper_nm"))
        height = "" if row["altitude_m"] != row["altitude_m"] else f"{row['altitude_m']:g}"
        cells = str(row["bands"]), " to ".join(ends), f"{row['pixel_m']:.2g}", height
        table.add_row(str(row["name"]), str(row["kind"]), *cells)
    Console().print(table)


def identify(files: Sequence[str | Path], *, json: bool = False) -> None:
    """Say what a file is taken for, and why: format, layout, unit, quantity, place, number.

    Spectra, images, cubes, point clouds, plot files and tables of plants, as every command reads
    them. Nothing is written. Exit status 1 if no reader takes one of the files.

    **Arguments:**

    - `files`: files to look at.
    - `json`: print what was found as JSON.
    """
    from fynjax.app.jobs import identify as identified

    found = [identified(file) for file in files]
    if json:
        from json import dumps

        print(dumps([one.model_dump() for one in found], indent=2))
    for one in () if json else found:
        print(f"{one.file}: {one.kind}")
        for name, value in one.facts.items():
            print(f"  {name + ':':<13}{value}")
        for line in one.evidence:
            print(f"  {line}")
        for other in one.rejected:
            print(f"  not {other.kind}: {other.reason}")
    if any(one.kind == "unknown" for one in found):
        raise typer.Exit(1)


def doctor(*, json: bool = False, clear: bool = False) -> None:
    """Check that this machine computes what fynjax relies on, and say the way out where not.

    Sums, products, an image and a gradient against other ways to them, 64 bits, memory, and the
    folder of compiled programs. Exit status 1 if anything is wrong.

    **Arguments:**

    - `json`: print the checks as JSON.
    - `clear`: remove what runs have kept for later ones instead: compiled programs, fits of leaves,
      and that sums were right.
    """
    from importlib.metadata import version

    if clear:
        _clear(json)
        return

    import jax

    from fynjax.app.jobs import doctor as checks_of_backend

    checks = checks_of_backend()
    if json:
        from json import dumps

        print(dumps([check._asdict() for check in checks]))
    else:
        print(f"fynjax {version('fynjax')}, JAX {version('jax')}, {jax.devices()[0].device_kind}")
        for check in checks:
            advice = "" if check.passed else f". {check.advice[0].upper()}{check.advice[1:]}."
            print(f"{'right' if check.passed else 'WRONG'}  {check.name}: {check.found}{advice}")
    if not all(check.passed for check in checks):
        raise typer.Exit(1)


def _clear(as_json: bool) -> None:
    """Remove what is kept, and say how much it was."""
    from fynjax._core import store

    files, size = store.clear()
    folder = store.cache_folder()
    if as_json:
        from json import dumps

        print(dumps({"folder": str(folder), "files": files, "bytes": size}))
    else:
        print(f"Removed {files} files, {size / 2**20:.1f} MiB, from {folder}")
