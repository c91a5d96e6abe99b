"""Which leaf spectra of a folder are of which taxon: by the names of files, or by a table."""

import re
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

from pydantic import Field

from fynjax._core.errors import InputError, names_file
from fynjax.app.io.text import NamedFile, Strict, read_rows
from fynjax.scene import check_taxa


class LeafFileRow(Strict):
    """One row of the table of leaf spectra: a file and its taxon."""

    unique = "file"

    file: Annotated[Path, NamedFile("a leaf spectrum")]
    """File of leaf spectra, all of one taxon; a path from the table's folder."""
    taxon: str = Field(min_length=1)
    """Name as in the species table."""


@names_file
def spectra_by_taxon(
    path: Path, taxa: Sequence[str], within: Path | None = None
) -> dict[str, tuple[Path, ...]]:
    """Files of leaf spectra of each taxon that has some.

    **Arguments:**

    - `path`: a folder, in which the name of a file, or of a folder above it, begins with that of
      its taxon, in letters of any size and with any signs for the blank
      ("calluna_vulgaris_00012.asd", "Calluna vulgaris/leaf 3.asd"), an author behind the epithet
      left out or not; or a table of `LeafFileRow`.
    - `taxa`: names in the species table.
    - `within`: folder in which the files must lie; None allows all.

    **Raises:** `InputError` for a folder in which no name begins with a taxon or that has links out
    of `within`, and a table with an unknown taxon or a file that is missing. Warns of files that
    are of no taxon.
    """
    found: dict[str, list[Path]] = {}
    if path.is_file():
        rows = read_rows(path, LeafFileRow, "a table of leaf spectra", within=within)
        check_taxa(rows, taxa, path)
        for _, row in rows:
            found.setdefault(row.taxon, []).append(row.file)
        return {taxon: tuple(files) for taxon, files in found.items()}
    others = []
    # The longest name first: "Erica cinerea" before "Erica".
    named = [*((_letters(taxon), taxon) for taxon in taxa), *_without_authors(taxa).items()]
    wanted = sorted(named, key=lambda w: -len(w[0]))
    for file in sorted(p for p in path.rglob("*") if p.is_file()):
        parts = file.relative_to(path).parts
        if any(part.startswith(".") for part in parts):
            continue
        if within is not None and not file.resolve().is_relative_to(within.resolve()):
            raise InputError(
                "expected a leaf spectrum in the plot file's folder or below, but this link leads "
                "out of it. Copy it there, or allow other places: --allow-outside "
                "(`allow_outside`)",
                file=file,
            )
        names = [_letters(part) for part in reversed(parts)]
        taxon = next((t for n in names for w, t in wanted if f"{n} ".startswith(f"{w} ")), None)
        if taxon is None:
            others.append(file.name)
        else:
            found.setdefault(taxon, []).append(file)
    if not found:
        example = next(iter(taxa), "Calluna vulgaris")
        raise InputError(
            f"expected leaf spectra whose names begin with a taxon, such as {example!r}, or in "
            f"folders named so, but {'it is empty' if not others else f'has {others[0]!r}'}. A CSV "
            "table with the columns file and taxon does as well: name it in place of the folder."
        )
    if others:
        warnings.warn(
            f"{path}: files whose names begin with no taxon of the species table are left out "
            f"({len(others)}), such as {others[0]!r}",
            stacklevel=4,
        )
    return {taxon: tuple(files) for taxon, files in found.items()}


def _without_authors(taxa: Sequence[str]) -> dict[str, str]:
    """Taxa by genus and epithet, of those with an author behind: "Erica cinerea L."."""
    found: dict[str, list[str]] = {}
    for taxon in taxa:
        if match := re.match(r"([^\W\d_]+ [^\W\d_]{3,}) \(?[^\W\d_a-z]", taxon):
            found.setdefault(_letters(match[1]), []).append(taxon)
    return {short: same[0] for short, same in found.items() if len(same) == 1}


def _letters(name: str) -> str:
    """The words of a name in small letters, one blank apart; digits after letters are a word."""
    return " ".join(re.findall(r"[^\W\d_]+|\d+", name.casefold()))
