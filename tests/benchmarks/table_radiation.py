"""The accuracy of the radiation layer in one table: `python -m tests.benchmarks.table_radiation`.

One row per figure: the tolerance asked, the figure at accuracy chosen for the test, and the same
at the defaults. Tests without their reference or peer say so and are left out. Times are CPU time
of all threads, after compilation; memory is what XLA plans. `--plots` draws how errors fall.

`FYNJAX_SHARED_DATA` names the folder of references, `FYNJAX_MITSUBA_PYTHON` an interpreter that
has Mitsuba 3, if the running one has not.
"""

import argparse
import os
import sys
import time
import traceback
from collections.abc import Callable, Iterator
from pathlib import Path

import jax

jax.config.update("jax_enable_x64", True)

from tests.benchmarks.radiation import (  # noqa: E402
    closed_forms,
    convergence,
    cost,
    gradients,
    head_to_head,
    mesh,
    plants,
    references,
    spectrum,
)
from tests.benchmarks.radiation.report import HEAD, Row, Setting, line, write  # noqa: E402

TESTS: dict[str, Callable[[Setting], Iterator[Row]]] = {
    "closed-forms": closed_forms.closed_forms,
    "energy": closed_forms.energy,
    "slabs": references.slabs,
    "het01": references.het01,
    "discs": references.discs,
    "rami4pilps": references.rami4pilps,
    "head-to-head": head_to_head.head_to_head,
    "mesh": mesh.mesh_shrub,
    "plants": plants.plants,
    "gradients": gradients.gradients,
    "image": cost.image,
    "value-and-gradient": cost.value_and_gradient,
    "example-plot": cost.example_plot,
    "many-bands": spectrum.many_bands,
    "area": cost.cost_against_area,
    "hectare": cost.hectare,
    "convergence": convergence.convergence,
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", nargs="+", choices=TESTS, metavar="NAME", help=", ".join(TESTS))
    parser.add_argument("--quick", action="store_true", help="fewer cases, coarser grids")
    parser.add_argument("--json", type=Path, help="file for the rows")
    parser.add_argument("--plots", type=Path, help="folder for charts of convergence")
    arguments = parser.parse_args()
    setting = Setting(arguments.quick, arguments.plots)
    rows: list[Row] = []
    failed: list[str] = []
    print(f"{jax.devices()[0].device_kind}, {os.cpu_count()} cores, jax {jax.__version__}")
    print(HEAD, flush=True)
    for name in arguments.only or TESTS:
        start = time.perf_counter()
        try:
            for row in TESTS[name](setting):
                rows.append(row)
                print(line(row), flush=True)
        except FileNotFoundError as missing:
            print(f"{name}: left out, {missing}", flush=True)
        except Exception:
            # The other tests are worth their figures; the exit status tells of this one.
            traceback.print_exc()
            failed.append(name)
        print(f"{'':24s} ({name}: {time.perf_counter() - start:.0f} s)", flush=True)
        if arguments.json is not None:
            write(arguments.json, rows)
    short = [row for row in rows if row.verdict == "SHORT"]
    print(f"{len(rows)} figures, {len(short)} short of their tolerance")
    if failed:
        sys.exit(f"failed: {', '.join(failed)}")


if __name__ == "__main__":
    main()
