"""`fynjax sensors`."""

from typing import Annotated

import typer


def sensors(
    json: Annotated[bool, typer.Option("--json", help="Print the table as JSON.")] = False,
) -> None:
    """List the shipped sensors: cameras, imaging spectrometers and LiDAR systems.

    Any of their names goes into a plot file (`[sensor]`) or to `fynjax simulate --sensor`.

    Example:  fynjax simulate plot.toml --sensor scanning_lidar
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
