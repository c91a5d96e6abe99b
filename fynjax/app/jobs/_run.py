"""A job at work: its folder and what was written there, its stages and their times."""

import dataclasses
import logging
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import pandas as pd

from fynjax._core.checkpoint import Journal, signature
from fynjax._core.dry_run import DryRunEnd as DryRunEnd
from fynjax._core.dry_run import dry_run as dry_run
from fynjax._core.errors import whole_number
from fynjax._core.files import note_file
from fynjax._core.memory import peak_memory
from fynjax._core.parts import Workers as Workers
from fynjax._core.progress import stage
from fynjax.app.io.raster import file_hash, provenance, write_qgis_style
from fynjax.app.io.text import table_text, write_text
from fynjax.app.jobs._result import JobResult
from fynjax.app.report.pages import Page, Part, Picture, Section, Table, write_page

if TYPE_CHECKING:
    from fynjax.app.io.plot import Plot

Result = TypeVar("Result", bound=JobResult)
_log = logging.getLogger("fynjax")


def paths_of(given: str | Path | Sequence[str | Path]) -> list[Path]:
    """One path, or several, as a list."""
    return [Path(p) for p in ([given] if isinstance(given, str | Path) else given)]


def peak_memory_mib() -> float:
    """Largest resident memory of the process so far [MiB]."""
    return peak_memory() / 2**20


class Run:
    """Where a job writes, what it has written, and how long its stages took."""

    def __init__(
        self, folder: str | Path, *, seed: int | None = None, plot: "Plot | None" = None
    ) -> None:
        """A run that writes into `folder`; its seed, if none is stated, is the plot's, or 0."""
        self.folder = Path(folder)
        usual = 0 if plot is None else plot.seed
        self.seed = whole_number("seed", usual if seed is None else seed, most=2**31 - 1)
        self.files: dict[str, str] = {}
        """Description of each file, by its name."""
        self.seconds: dict[str, float] = {}
        """Wall time by stage [s]."""
        self.doubts: list[str] = []
        """Why the measurements are to be doubted."""
        self.plants = ""
        """A line on where the values of the plants are from, for the result, its products and the
        page; empty of a job that plants nothing."""
        if plot is not None:
            from fynjax.app.io.plot import (
                plant_sources,  # late: commands without a plot need no scene
            )

            self.plants = plant_sources(plot)
        self._began = time.perf_counter()

    def doubt(self, text: str) -> None:
        """Say at once, by the logger `fynjax`, why a measurement is to be doubted; and in the
        result and on the page."""
        self.doubts.append(text)
        _log.warning("%s", text)

    @contextmanager
    def stage(self, name: str, timed_as: str = "", total: int | None = None) -> Iterator[None]:
        """A stage of `total` steps; its time is kept as `timed_as`, if that is given."""
        with stage(name, total), self.timed(timed_as):
            yield

    @contextmanager
    def timed(self, name: str) -> Iterator[None]:
        """Keep the wall time of the block as `name`, unless that is empty."""
        began = time.perf_counter()
        yield
        if name:
            self.seconds[name] = time.perf_counter() - began

    def total(self) -> float:
        """Wall time since the job began [s]; kept as 'total'."""
        self.seconds["total"] = time.perf_counter() - self._began
        return self.seconds["total"]

    def record(self, inputs: Sequence[str | Path | None]) -> dict[str, str | int]:
        """Versions, seed and the hashes of the input files, for products and the page."""
        known = dict.fromkeys(Path(path) for path in inputs if path is not None)
        for path in known:
            note_file(path)
        plants = {"plants": self.plants} if self.plants else {}
        return provenance(seed=self.seed, inputs=known) | plants

    def journal(
        self, checkpoint: str | Path | None, *signed: Any, files: Sequence[str | Path | None]
    ) -> Journal | None:
        """The journal in the folder `checkpoint`, None without one; of the same seed, of what is
        `signed` and of the content of the input `files` alone: `InputError` for another's."""
        if checkpoint is None:
            return None
        hashes = [file_hash(Path(path)) for path in files if path is not None]
        return Journal(checkpoint, signature(signed, hashes, self.seed))

    def path(self, name: str, what: str) -> Path:
        """Where to write the file `name`, which is listed as `what`."""
        self.files[name] = what
        return self.folder / name

    def table(self, name: str, table: pd.DataFrame, what: str, form: str | None = "%.6g") -> None:
        """Write a table as CSV, its numbers in the format `form`."""
        write_text(self.path(name, what), table_text(table, form))

    def picture(self, picture: Picture) -> None:
        """Write a picture that stands on no page."""
        picture.write(self.folder)
        self.files[picture.file] = picture.what

    def page(self, page: Page) -> None:
        """Write the page with its figures, doubts first, and where values of plants are from."""
        lead = " ".join(filter(None, [*self.doubts, page.lead, self.plants]))
        first, trust = page.answer["Result"], " ".join(self.doubts) or page.trust
        page = dataclasses.replace(page, lead=lead, result=first, trust=trust)
        self.files |= write_page(page, self.folder)

    def pictures(
        self,
        command: str,
        title: str,
        headline: Sequence[str],
        pictures: Sequence[Part],
        inputs: Sequence[str | Path | None] = (),
    ) -> None:
        """Write a page of pictures below what the terminal says.

        **Arguments:** `command`; `title`; `headline` of the result; `pictures`, and what else is
        there; `inputs`, files that the results come from.
        """
        parts = [*headline[1:], *pictures]
        self.page(Page(command, title, headline[0], [Section("", parts)], {}, self.record(inputs)))

    def times(self, caption: str = "Wall time.", *, folded: bool = False) -> Table:
        """The stages' times, for the page."""
        rows = pd.DataFrame({"what": list(self.seconds), "seconds": list(self.seconds.values())})
        return Table(rows, caption, folded=folded)

    def result(self, kind: type[Result], **fields: Any) -> Result:
        """The job's result: `fields`, and what the run knows itself. Rasters get their styles."""
        if self.plants:
            fields["headline"] = [*fields["headline"], self.plants]
        fields["warnings"] = [*self.doubts, *fields.get("warnings", [])]
        for name in [n for n in self.files if n.endswith(".tif")]:
            style = write_qgis_style(self.folder / name)
            self.files[style.name] = f"style of {name}, which QGIS takes by itself"
        self.total()
        return kind(
            output=str(self.folder),
            seed=self.seed,
            files=self.files,
            timings_s=self.seconds,
            peak_memory_mib=peak_memory_mib(),
            **fields,
        )
