"""What people call the columns of a table of plants, in several languages, and what they write for
growth forms and for ground without plants."""

import re
import tomllib
import unicodedata
from dataclasses import dataclass
from pathlib import Path

_WORDS = {
    kind: {what: re.split(r";\s*", " ".join(words.split())) for what, words in table.items()}
    for kind, table in tomllib.loads(
        (Path(__file__).parent / "data" / "column_words.toml").read_text("utf-8")
    ).items()
}
"""Words of columns, units, growth forms and ground, by what they stand for."""
_SCALE_OF = {word: scale for scale, words in _WORDS["scales"].items() for word in words}
_NUMBERED = re.compile(r"\b(diam|diameter|diametre|diametro|durchmesser)(\d)\b")
_NO_CLASSES = re.compile(r"%|\b(percent\w*|pct|mid|midpoints?|middles?|mitte|mittel\w*)\b")
METRES = {"m": 1.0, "dm": 0.1, "cm": 0.01, "mm": 0.001, "ft": 0.3048, "in": 0.0254}
"""Metres in each unit of length that a column may have."""

_RAUNKIAER = {
    **dict.fromkeys(("ph", "p", "np", "nph", "mp"), "broad_leaved"),
    **dict.fromkeys(("ch", "h", "t", "th", "g"), "rounded_shrub"),
}
"""Letters of life forms after Raunkiaer."""


def words_of(text: str) -> str:
    """Text in small letters, without accents, its words one blank apart."""
    plain = unicodedata.normalize("NFKD", re.sub("[Øø⌀]", " diam ", text.replace("ß", "ss")))
    plain = "".join(c for c in plain if not unicodedata.combining(c)).casefold()
    return " ".join(re.findall(r"[a-z0-9%]+", plain))


_OF_UNIT = {word: unit for unit, words in _WORDS["units"].items() for word in words}
_ROLE_OF = {word: role for role, words in _WORDS["columns"].items() for word in words}
_NOT_OF_CROWNS = re.compile(r"\b(stem|trunk|basal|base|dbh|dbasal|tronc|stamm|tallo|fusto|leaf)\b")


@dataclass(frozen=True)
class Heading:
    """What the heading of a column says."""

    role: str
    """Quantity that the column holds, such as "cover"; empty where no word of its heading says."""
    unit: str
    """Its unit, such as "cm" or "%"; empty where none is stated."""
    exact: bool
    """Whether the whole heading is a known name, not only part of it."""
    scale: str | None = None
    """Scale of classes, such as "Braun-Blanquet"; empty of classes of some scale, and None where
    the heading says of none."""


def heading(name: str) -> Heading:
    """What a column holds by its heading: "Hauteur (cm)" is a height in cm.

    **Arguments:** `name`, as the table has it.
    """
    unit = ""
    for bracket in re.findall(r"[(\[{]([^)\]}]*)[)\]}]", name):
        unit = unit or _OF_UNIT.get(words_of(bracket), "")
    name = re.sub(r"([a-z])([A-Z])", r"\1 \2", name)
    scale = _scale(name)
    plain = words_of(re.sub(r"[(\[{][^)\]}]*[)\]}]", " ", name))
    for word in (plain.rpartition(" ")[2], plain.partition(" ")[0]):
        if not unit and " " in plain and word in _OF_UNIT:
            unit = _OF_UNIT[word]
    if "%" in plain:
        unit = unit or "%"
    bare = plain.replace("%", " ")
    words = bare.split()
    while len(words) > 1 and words[-1] in _OF_UNIT:
        words.pop()
    while len(words) > 1 and words[0] in _OF_UNIT:
        words.pop(0)
    bare = _NUMBERED.sub(r"\1 \2", " ".join(words))
    if bare in _ROLE_OF:
        return Heading(_ROLE_OF[bare], unit, True, scale)
    if _NOT_OF_CROWNS.search(bare):
        return Heading("", unit, exact=False)
    padded, found = f" {bare} ", ("", 0)
    for word, role in _ROLE_OF.items():
        if len(word) > max(found[1], 3) and f" {word} " in padded:
            found = role, len(word)
    return Heading(found[0] or ("cover" if scale else ""), unit, False, scale)


def _scale(name: str) -> str | None:
    """The scale of classes that a heading names, as `Heading` has it."""
    padded = f" {words_of(name)} "
    if "%" in name or _NO_CLASSES.search(padded):
        return None
    return next((scale for word, scale in _SCALE_OF.items() if f" {word} " in padded), None)


def form_of_words(text: str) -> str:
    """The growth form that a life form or habit stands for, in any of several languages; empty of
    words that name none.

    **Arguments:** `text`, such as "chaméphyte", "Zwergstrauch", "Ch" or "tall shrub".
    """
    plain = words_of(text)
    if plain in _RAUNKIAER:
        return _RAUNKIAER[plain]
    padded, best = f" {plain} ", ("", 0)
    for form, words in _WORDS["forms"].items():
        for word in words:
            # Of long words the beginning of one will do: chamaephyte, chamaephytes.
            there = f" {word}" in padded if len(word) > 3 else f" {word} " in padded
            if there and len(word) > best[1]:
                best = form, len(word)
    if not best[0] and len(parts := plain.split()) > 1:
        return next((_RAUNKIAER[one] for one in parts if len(one) == 2 and one in _RAUNKIAER), "")
    return best[0]


def ground_of_words(text: str) -> str:
    """What of the ground a row of a table is: "litter", "rock", "char", "bare", or "total" of a
    sum; empty of a plant."""
    plain = words_of(text)
    return next((kind for kind, words in _WORDS["ground"].items() if plain in words), "")
