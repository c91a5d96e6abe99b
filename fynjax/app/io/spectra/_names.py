"""What the names of spectra and of their files say: reflectance, transmittance, or no leaf."""

import re
from collections.abc import Collection, Iterable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from fynjax._core.errors import InputError
from fynjax.app.io.spectra._record import MeasuredSpectrum, in_windows

_BEFORE = r"(^|[ _.\-(]|(?<=\d)(?=[a-z]{3}))"
"""Before a mark; of several letters a number may stand there too, as in LEAF01refl."""
_AFTER = r"(?=$|[ _.\-)%]|\d{3,5}$)"
_MARKS = {
    "transmittance": re.compile(
        _BEFORE + r"(t|trans?|tr[nm]|trans?mi[a-z]*|transm|tau)" + _AFTER, re.I
    ),
    "reflectance": re.compile(_BEFORE + r"(r|ref|rfl|r[eé]fl[^\W\d_]*|rho)" + _AFTER, re.I),
}
_OTHER = str.maketrans("RTrt", "TRtr")
_LETTER = re.compile(
    r"((?<=[ _.\-(\d])[RTrt]|(?<=[a-z])[RT])(?=\d*($|[ _.\-)]))"
    r"|(?<![^ _.\-(\da-z])[RT](?=[a-z]\d*($|[ _.\-)]))|(?<![^ _.\-(\d])[rt](?=s($|[ _.\-)]))"
)
_LAST = re.compile(r"(?P<stem>.+)[ _.\-](?P<mark>[RTrt])(?P<more>[a-z]?\d*)")
_FIRST = re.compile(r"[Tt](?=\d+($|[ _.\-]))")
_FOLDERS = {
    "transmittance": re.compile(r"t|tran.*|tau", re.I),
    "reflectance": re.compile(r"r|refl.*|rho", re.I),
}
_NO_LEAF = re.compile(
    r"(mean|average|avg|median|min(imum)?|max(imum)?|n|count|se( ?\(mean)?|sem|cv|rsd|var(iance)?"
    r"|diff(erence)?|error|uncertainty|rmse|iqr|mittel(wert)?|mw|moyenne|m[ée]dia|promedio|gemiddelde"
    r"|(q|p)\d+|.*\b(percentile|quantile|confidence)\b.*|(95 ?%? )?ci( \w+)?"
    r"|(lower|upper)( ?(ci|bound|limit))?|wr|panel|spectralon"
    r"|white (standard|panel)|(white )?ref(erence)?"
    r"|(.*[ (])?(sd|std|stdev|std ?dev|st dev|standard deviation|standard error|std ?err(or)?|stabw"
    r"|σ|sigma|standardabweichung|standardfehler|[ée]cart type|desviaci[oó]n|desvio)([ (].*)?)",
    re.I,
)
_ERROR = re.compile(
    r"se( ?\(mean)?|sem|cv|rsd|var(iance)?|error|uncertainty|rmse|iqr|n|count"
    r"|(.*[ (])?(sd|std|stdev|std ?dev|st dev|standard deviation|standard error|std ?err(or)?|stabw"
    r"|σ|sigma|standardabweichung|standardfehler|[ée]cart type|desviaci[oó]n|desvio)([ (].*)?",
    re.I,
)
"""Names of errors and counts, which are no spectrum even where they stand alone with a mean."""
_MEAN = re.compile(
    r"(?P<of>.*?)[ _.\-]*\b(mean|average|avg|mittel(wert)?|moyenne|m[ée]dia|promedio|gemiddelde)"
    r"\b[ _.\-]*(?P<also>.*)",
    re.I,
)
_LONG_WORDS = (
    r"(absorptan|absorban|(ir)?radian)(ce|z|[cç]ia)|absorption|absorp([cç]ión|ção)|emittance"
    r"|emissi?vi(ty|tät|té|dad)|fluorescence|derivative|continuum|(convex )?hull (removed|quotient)"
    r"|fwhm|bandwidth"
)
_OTHER_QUANTITY = re.compile(
    rf"{_LONG_WORDS}|(^|[ (])(abs|log ?\(?1/r\)?|dn|raw|r ?\+ ?t|t ?\+ ?r)($|[ )])"
    r"|^(rad|irr)$",
    re.I,
)
_RADIANT = re.compile(r"[LE] (target|tgt|down\w*|up\w*|sky|sun|panel|ref\w*|white)", re.ASCII)
"""Radiance and irradiance by their signs."""
_STATED = r"(?P<{}>trans(mission|mittance)|refle(ction|ctance|xion|xão)|{})"
_STATEMENT = re.compile(
    rf"\W*{_STATED.format('start', _LONG_WORDS)}\W*($|(of|data|spectr\w+)\b.*)"
    rf"|.*?\b{_STATED.format('end', _LONG_WORDS)}( data| spectr\w+| mode)?\W*(\([^)]*\)\W*|%\W*)?$",
    re.I,
)
_REMARK = re.compile(r"\W*(comment|remark|note|operator|lamp|light|source|path|file ?name)", re.I)
_NODE = re.compile(r"Data from (.*) Node")
SUFFIXES = {
    **{".trm": "transmittance", ".abs": "absorbance", ".irr": "irradiance", ".rad": "radiance"}
}
"""Quantities by the endings of files."""
_BOUND = re.compile(
    r"(?P<of>.+?)[ _.\-]*[ _.\-(](lower|upper|lwr|upr|min|max|cv|rsd|sem?|var|n|ci|ll|ul|q\d+)\)?",
    re.I,
)
_QUANTILE, _MEDIAN = re.compile(r"p(\d+)", re.I), 50
_BLUE, _RED, _BRIGHT = (445.0, 455.0), (640.0, 680.0), (780.0, 900.0)
_DARK_BLUE, _PLATEAU = 0.02, 0.3
"""Reflectance at 450 nm that the surface of a fresh leaf exceeds, and that of its near infrared: of
1050 leaves of ANGERS, LOPEX, NASA FFT, Di Vittorio's and California's needles and leaves 2 are
below and above these, of 907 transmittances of four of these sets 496."""
_USUAL = {0, 1, 2, 3, 5, 10, 16, 20, 25, 50, 75, 80, 84, 90, 95, 97, 98, 99, 100}
"""Percentiles that people take; of them one at least is the median or above."""


def other_quantity(name: str) -> str:
    """Quantity that the `name` of a column or file states for its values, where it is neither
    reflectance nor transmittance, such as "radiance"; else empty."""
    plain = re.sub(r"[_.\-]+", " ", name).strip()
    ending = re.search(r"(?<=\.)(rad|irr)$", name, re.I)  # as ASD's program calls columns
    found = _OTHER_QUANTITY.search(plain) or _RADIANT.fullmatch(plain) or ending
    return found[0].strip(" ()") if found else ""


def stated_quantity(lines: Iterable[str]) -> str:
    """Quantity of a file's numbers by the lines above them: "reflectance", "transmittance" or
    empty, where they state none.

    **Raises:** `InputError` for another quantity, such as radiance, where none says reflectance.
    """
    said = {}
    for line in lines:
        if (node := _NODE.match(line)) and (words := other_quantity(node[1]) or node[1]):
            line = "reflectance" if re.search("refle", node[1], re.I) else words
            line = "transmittance" if re.search("transmi", node[1], re.I) else line
        if not _REMARK.match(line) and (match := _STATEMENT.fullmatch(line[:200].strip())):
            word = (match["start"] or match["end"]).lower()
            quantity = {"r": "reflectance", "t": "transmittance"}.get(word[0], word)
            said[quantity if "radian" not in word else word] = line.strip()
    for quantity in ("reflectance", "transmittance"):
        if quantity in said:
            return quantity
    for quantity, line in said.items():
        raise another(quantity, f"the file says {line!r:.80}")
    return ""


def another(quantity: str, why: str) -> InputError:
    """The error of a file of another quantity."""
    return InputError(
        f"expected reflectance or transmittance, but {why}, which is another quantity "
        f"({quantity}): convert it to reflectance in the instrument's program"
    )


def marked(name: str, among: Collection[str] = ()) -> tuple[str, str, str]:
    """Quantity that a name is marked with, and the name without the mark.

    **Arguments:** `name`, such as "oak01_R" or "oak trans 3"; `among`, all names: where "oak01T" is
    one of them, the last letter of "oak01R" is a mark too, and that of "oak_R2" beside "oak_T2".

    **Returns:** "reflectance", "transmittance" or "" of a name without a mark; the rest of the
    name; and the mark. Where a name has several, as "leaf R 3_T", the last one counts.
    """
    found = [
        (match.start(2), quantity, match)
        for quantity, pattern in _MARKS.items()
        for match in pattern.finditer(name)
    ]
    if not found:
        for match in _LETTER.finditer(name):
            if _swapped(name, match) in among:
                return _quantity_of(match[0]), name[: match.start()] + name[match.end() :], match[0]
        alike = _alike(name, among)
        if len(alike) == 1 and not alike[0]["more"]:
            mark = alike[0]["mark"].translate(_OTHER)
            return _quantity_of(mark), alike[0]["stem"], mark
        return "", name, ""
    _, quantity, match = max(found, key=lambda one: one[0])
    rest = name[: match.start()] + name[match.end() :]
    return quantity, rest.strip(" _.-()"), match[2]


def unsure(among: Collection[str]) -> set[str]:
    """Names in which a letter T, as in "T101" beside "C101", is no sure mark of transmittance: no
    name has the R for it, and no other T of the table goes with an R.

    **Arguments:** `among`, the names of all columns.
    """
    about = {name: marked(name, among) for name in among}
    letters = {n: stem for n, (q, stem, m) in about.items() if q == "transmittance" and len(m) == 1}
    reflected = {stem.lower() for q, stem, _ in about.values() if q != "transmittance"}
    if any(stem.lower() in reflected for stem in letters.values()):
        return set()
    others = any(quantity != "transmittance" for quantity, _, _ in about.values())
    numbered = {name for name, stem in letters.items() if re.fullmatch(r"[\d_ .\-]+", stem)}
    return {name for name, stem in letters.items() if stem} if others else numbered


def _quantity_of(letter: str) -> str:
    return "reflectance" if letter in "rR" else "transmittance"


def _alike(name: str, among: Collection[str]) -> list[re.Match[str]]:
    """Names that differ from `name` in the R or T that ends it, and in a letter or number behind;
    empty where the name does not end so, or another has its own letter."""
    last = _LAST.fullmatch(name)
    if last is None:
        return []
    near = {n for n in among if n.startswith(last["stem"])}
    found = [m for m in map(_LAST.fullmatch, near) if m and m["stem"] == last["stem"]]
    own = last["mark"].lower()
    alone = sum(m["mark"].lower() == own for m in found) == 1
    return [m for m in found if m["mark"].lower() != own] if alone else []


def _swapped(name: str, match: re.Match[str]) -> str:
    """The name with the R for a T, or the T for an R."""
    return name[: match.start()] + match[0].translate(_OTHER) + name[match.end() :]


def is_no_leaf(
    name: str, wavelength: np.ndarray, values: np.ndarray | None, among: Collection[str] = ()
) -> bool:
    """Whether a column of a table is a statistic of the others, or a copy of the wavelengths.

    **Arguments:** `among`, names of all in small letters: a bound such as "oak_upper" stands beside
    its "oak".
    """
    if _NO_LEAF.fullmatch(re.sub(r"[_.\-]+", " ", name).strip(" ()")):
        return True
    around = _BOUND.fullmatch(name)
    if around and around["of"].lower() in among:
        return True
    if values is None or not np.isfinite(values).all():
        return False
    return any(np.allclose(values * factor, wavelength, rtol=1e-3) for factor in (1.0, 1e3))


def _level(spectrum: MeasuredSpectrum, window: tuple[float, float]) -> float:
    """Median of the reflectance in a window [nm]; NaN where it has no band there."""
    values = spectrum.reflectance
    if values is None:
        return np.nan
    values = values[in_windows(spectrum.wavelength, (window,))]
    values = values[np.isfinite(values)]
    return float(np.median(values)) if values.size else np.nan


def _absorbs(spectrum: MeasuredSpectrum) -> bool:
    """Whether the values of a spectrum are absorptance, of which a leaf has more in red."""
    red = _level(spectrum, _RED)
    return red > 0.5 and _level(spectrum, _BRIGHT) < 0.5 * red


def leaves_only(spectra: Sequence[MeasuredSpectrum], stem: str = "") -> list[MeasuredSpectrum]:
    """Spectra of a table without its columns that are no leaves, which the first one notes.

    A mean that stands alone is a spectrum like others. `stem` is the file's name, which a column
    without one has.

    **Raises:** `InputError` where all are of another quantity, such as radiance.
    """
    whole = [s for s in spectra if s.reflectance is not None and s.transmittance is not None]
    absorbed = {f"{s.name}{mark}a".lower() for s in whole for mark in " _"}
    other = [
        s
        for s in spectra
        if (s.name != stem and other_quantity(s.name)) or s.name.lower() in absorbed or _absorbs(s)
    ]
    if other and len(other) == len(spectra):
        why = ": it is more in red than in the near infrared, as absorptance"
        raise InputError(
            f"expected reflectance or transmittance, but {other[0].name!r} is another quantity"
            f"{why if _absorbs(other[0]) else ''}"
        )
    among = {s.name.lower() for s in spectra}
    left = []
    for s in spectra:
        values = s.transmittance if s.reflectance is None else s.reflectance
        name = "" if s.name == stem else s.name
        if any(s is one for one in other) or is_no_leaf(name, s.wavelength, values, among):
            left.append(s)
    numbers = [int(m[1]) for s in left if (m := _QUANTILE.fullmatch(s.name))]
    if not set(numbers) <= _USUAL or max(numbers, default=_MEDIAN) < _MEDIAN:  # plants P1, P2, ...
        left = [s for s in left if not _QUANTILE.fullmatch(s.name)]
    kept = [s for s in spectra if not any(s is one for one in left)]
    if not kept:  # a mean with its least or its error: the mean is a spectrum
        kept = [s for s in spectra if _MEAN.fullmatch(s.name) or s.name.lower() == "median"]
        left = [s for s in spectra if not any(s is one for one in kept)]
    if not kept:
        left = [s for s in left if _ERROR.fullmatch(re.sub(r"[_.\-]+", " ", s.name).strip(" ()"))]
        kept = [s for s in spectra if not any(s is one for one in left)]
    if not kept or not left:
        return list(spectra)
    names = ", ".join(repr(s.name) for s in left)
    why = f"left out of the table, since they are no leaves: {names}"
    return [kept[0].noted(why, meta={"left_out": names}), *kept[1:]]


def _quantity(
    file: str, spectrum: MeasuredSpectrum, names: Collection[str]
) -> tuple[str, tuple[str, ...], bool]:
    """Quantity of a spectrum, what it has in common with the other one of its leaf, and whether its
    name, among those of all, leaves no doubt of it."""
    quantity, rest, mark = marked(spectrum.name, names)
    key: tuple[str, ...] = (rest.lower(),)
    folder = Path(file).parent.name
    of_file = False
    if not quantity:  # a column without a mark in a file with one, as in oak_T.csv
        quantity, rest, _ = marked(Path(file).stem, names)
        of_file = bool(quantity)
        key = tuple(dict.fromkeys((*key, rest.lower()))) if of_file else key
    if not quantity:
        quantity = next((q for q, known in _FOLDERS.items() if known.fullmatch(folder)), "")
        mark = folder if quantity else ""
    if spectrum.reflectance is None:
        return "transmittance", key, True
    return quantity or "reflectance", key, len(mark) > 1 and not of_file


def as_transmittance(spectrum: MeasuredSpectrum) -> MeasuredSpectrum:
    """A spectrum whose values, wherever they stand, are transmittance."""
    if spectrum.reflectance is None:
        return spectrum
    meta = {k: v for k, v in spectrum.meta.items() if k != "panel"}
    values = spectrum.reflectance
    return replace(spectrum, reflectance=None, transmittance=values, meta=meta)


def join_stated(
    read: list[tuple[str, MeasuredSpectrum]], through: list[tuple[str, MeasuredSpectrum]]
) -> list[tuple[str, MeasuredSpectrum]]:
    """Reflectance joined with transmittance that the user says is such, by the names but for their
    marks, or by the order where the names differ.

    **Raises:** `InputError` where there are not as many of both, or of other bands.
    """
    if len(read) != len(through):
        raise InputError(
            f"each leaf needs its transmittance, but of {len(read)} leaves there are {len(through)}"
        )
    names = {s.name for _, s in (*read, *through)}
    keys = [marked(s.name, names)[1].lower() for _, s in through]
    own = [marked(s.name, names)[1].lower() for _, s in read]
    if len(set(own)) == len(own) and set(keys) == set(own):
        through = [through[keys.index(key)] for key in own]
    joined = []
    for (file, leaf), (other, spectrum) in zip(read, through, strict=True):
        if leaf.transmittance is not None:
            raise InputError(
                f"the transmittance of {leaf.name!r} is in its file already", file=file
            )
        joined.append((file, _joined(leaf, other, spectrum, "as stated")))
    return joined


def _joined(
    leaf: MeasuredSpectrum, file: str, through: MeasuredSpectrum, why: str
) -> MeasuredSpectrum:
    """A leaf's reflectance with its transmittance from a file."""
    if not np.array_equal(leaf.wavelength, through.wavelength):
        raise InputError(
            f"expected the bands of the reflectance of {leaf.name!r}, but its transmittance has "
            "others",
            file=file,
        )
    name = marked(leaf.name, (leaf.name, through.name))[1] or leaf.name
    values = as_transmittance(through).transmittance
    return leaf.noted(
        f"transmittance from {Path(file).name}, {why}",
        *(f"transmittance: {sentence}" for sentence in through.meta["repairs"]),
        meta={k: v for k, v in through.meta.items() if k in ("saturated", "doubtful")},
        name=name,
        transmittance=values,
    )


def join_pairs(read: list[tuple[str, MeasuredSpectrum]]) -> list[tuple[str, MeasuredSpectrum]]:
    """Reflectance and transmittance of a leaf that stand in two files, as one spectrum.

    They belong together by their names but for a mark of the quantity (`_R` and `_T`, `refl` and
    `trans`, also of files and folders); transmittance is known by such a mark or by the file
    itself.

    **Arguments:** `read`, file and spectrum of each, whose name is that in the file.

    **Returns:** file and spectrum of each leaf, the pairs with a note.
    """
    single = [
        i for i, (_, s) in enumerate(read) if (s.reflectance is None) != (s.transmittance is None)
    ]
    names = {name for file, spectrum in read for name in (spectrum.name, Path(file).stem)}
    about = {i: _quantity(*read[i], names) for i in single}
    joined = list(read)
    waiting: dict[tuple[str, ...], list[int]] = {}
    for i in single:
        if about[i][0] == "reflectance":
            waiting.setdefault(about[i][1], []).append(i)
    gone = set()
    for i in single:
        quantity, key, sure = about[i]
        file, through = read[i]
        if quantity != "transmittance":
            continue
        partners = [
            k for k in waiting.get(key, ()) if read[k][0] != file or read[k][1].name != through.name
        ]
        grids = [k for k in partners if np.array_equal(read[k][1].wavelength, through.wavelength)]
        if len(grids) == 1:
            waiting[key].remove(grids[0])
            other, leaf = joined[grids[0]]
            joined[grids[0]] = (other, _joined(leaf, file, through, "by its name"))
            gone.add(i)
        elif through.reflectance is not None:
            alone = "the name is that of a transmittance, but no reflectance goes with it"
            alone += f": taken for {'transmittance' if sure else 'reflectance'}"
            named = through.noted(alone, meta={} if sure else {"doubtful": alone})
            joined[i] = (file, as_transmittance(named) if sure else named)
    for i in single:
        file, leaf = joined[i]
        match = _FIRST.match(leaf.name)
        if match and leaf.transmittance is None and (other := _swapped(leaf.name, match)) in names:
            doubt = f"taken for reflectance; if it is the transmittance of {other}, end names in _T"
            joined[i] = file, leaf.noted(meta={"doubtful": doubt})
    return [one for i, one in enumerate(joined) if i not in gone]


def with_doubts(read: list[tuple[str, MeasuredSpectrum]]) -> list[tuple[str, MeasuredSpectrum]]:
    """Spectra of which nothing is sure but which look like no leaf of their own or like a
    transmittance, with the doubt in `meta["doubtful"]`."""
    names = list(dict.fromkeys(spectrum.name for _, spectrum in read))
    doubted = []
    for file, spectrum in read:
        doubt = _doubt(file, spectrum, names)
        if doubt and "doubtful" not in spectrum.meta:
            spectrum = spectrum.noted(meta={"doubtful": doubt})
        doubted.append((file, spectrum))
    return doubted


def _doubt(file: str, spectrum: MeasuredSpectrum, names: Sequence[str]) -> str:
    name = spectrum.name
    mean = _MEAN.fullmatch(name.replace("_", " "))
    if mean and (mean["of"] or mean["also"] or name == Path(file).stem):
        stem = mean["of"] or mean["also"]
        others = (n for n in names if not _MEAN.fullmatch(n.replace("_", " ")))
        if members := [n for n in others if re.match(re.escape(stem) + r"(?![^\W\d_])", n, re.I)]:
            more = f" and {len(members) - 3} more" if len(members) > 3 else ""
            return (
                f"{name!r} is a mean of {', '.join(map(repr, members[:3]))}{more} by its name, and "
                "no leaf beside them: leave it out where leaves are counted"
            )
    if spectrum.reflectance is None or spectrum.transmittance is not None:
        return ""
    if quantity := other_quantity(Path(file).stem):
        return f"the name of the file says {quantity!r}: taken for reflectance, is it?"
    last = _LAST.fullmatch(name)
    if last and last["mark"] in "tT":
        stem = last["stem"]
        near = [n for n in names if n.startswith(stem)]
        if beside := [n for n in near if re.fullmatch(r"([ _.\-][rR][a-z]?\d*)?", n[len(stem) :])]:
            return (
                f"{name!r} beside {beside[0]!r} may be a transmittance, but their names differ in "
                "more than R and T: taken for reflectance"
            )
    blue, bright = _level(spectrum, _BLUE), _level(spectrum, _BRIGHT)
    if blue < _DARK_BLUE and bright > _PLATEAU and not marked(name)[0]:
        return (
            f"the reflectance of {name!r} is {blue:.3f} at 450 nm, less than the surface of a "
            "fresh leaf returns. If it is the transmittance of a leaf, end names in _R and _T"
        )
    return ""
