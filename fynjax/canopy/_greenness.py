"""How green a spectrum is: what orders clusters of pixels by vegetation."""

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from fynjax._core.errors import InputError, listed

_RANGES = {
    "blue": (430.0, 520.0, 475.0),
    "green": (520.0, 600.0, 560.0),
    "red": (620.0, 700.0, 660.0),
    "nir": (760.0, 1000.0, 840.0),
}
"""Lowest and highest centre of a band of this name, and the one preferred [nm]."""

_WORDS = {
    "nearinfrared": "nir",
    "nearir": "nir",
    "nir1": "nir",
    "r": "red",
    "g": "green",
    "grn": "green",
    "b": "blue",
    "n": "nir",
    "rededge": "red_edge",
    "re": "red_edge",
    "edge": "red_edge",
    "gre": "green",
    "reg": "red_edge",
    "msg": "green",
    "msr": "red",
    "msre": "red_edge",
    "msnir": "nir",
    "grün": "green",
    "rot": "red",
    "blau": "blue",
}
_EXTRA = re.compile(
    r"\bb(?:and)?\W*\d{1,2}\b(?=\W*[a-z]{3})|(?<!\d)\d{3,4}(\.\d+)?(?!\d)|nm\b|nanomet\w+|\b(band|reflectance)\b|[\W_]"
)
"""What programs write around the name of a band: its number, wavelength, unit, these words."""


def band_word(name: str) -> str:
    """A band's name in one spelling: "red_edge" of "Red edge (717 nm)", "nir" of "NIR-842".

    **Arguments:** `name`, as a file has it.

    **Returns:** "blue", "green", "red", "red_edge" or "nir" where it means one of these; else the
    name in small letters, without what stands for a wavelength.
    """
    plain = _EXTRA.sub("", re.sub(r"[_\-]", " ", name.lower()))
    return _WORDS.get(plain, plain)


@dataclass(frozen=True)
class Greenness:
    """A number that grows with vegetation, for spectra of an image's bands."""

    name: str
    """Short name, for an axis or a table."""
    formula: str
    """Formula of the index, in the names of the bands used."""
    function: Callable[[Float[np.ndarray, "*pixel band"]], Float[np.ndarray, "*pixel"]]
    """Greenness of spectra, the bands last; NaN where it is not defined."""


def _divide(a: np.ndarray | float, b: np.ndarray | float) -> np.ndarray:
    """a / b, NaN where b is not positive."""
    out = np.full(np.broadcast(a, b).shape, np.nan)
    return np.divide(a, b, out=out, where=np.asarray(b) > 0.0)


def band_roles(
    names: Sequence[str], wavelengths: Sequence[float | None] | None = None
) -> dict[str, int]:
    """Which band of an image is blue, green, red and near infrared, as far as is known.

    **Arguments:**

    - `names`: of the bands, in the image's order. A band called "blue", "green", "red" or "nir"
      has that role.
    - `wavelengths`: centres of the bands [nm], `None` where not known; they decide where names do
      not, by the nearest band within the range of the colour.

    **Returns:** index of the band of each role that is known, from 0.

    **Raises:** `InputError` where names and wavelengths differ in number.
    """
    plain = [band_word(name) for name in names]
    waves = [None] * len(plain) if wavelengths is None else list(wavelengths)
    if len(waves) != len(plain):
        raise InputError(
            f"`wavelengths` must have one value for each of {len(plain)} bands, but has "
            f"{len(waves)}"
        )
    index_of_role = {}
    for role, (low, high, best) in _RANGES.items():
        if role in plain:
            index_of_role[role] = plain.index(role)
            continue
        near = [
            (abs(wave - best), k)
            for k, wave in enumerate(waves)
            if wave is not None and low <= wave <= high
        ]
        if near:
            index_of_role[role] = min(near)[1]
    return index_of_role


def choose_greenness(
    names: Sequence[str], wavelengths: Sequence[float | None] | None = None, *, index: str = "auto"
) -> Greenness:
    """The greenness that an image's bands allow.

    **Arguments:**

    - `names`: of the bands, in the image's order.
    - `wavelengths`: centres of the bands [nm], `None` where not known.
    - `index`: one of
        - "ndvi": (NIR - red) / (NIR + red), Rouse et al. (1974);
        - "excess_green": (2 green - red - blue) / (red + green + blue), Woebbecke et al. (1995);
        - the name or number (from 1) of a band that is brighter where plants are, or, after a
          minus, of one that is darker there, such as "-red";
        - "auto": NDVI where red and near infrared are known, else excess green.

    **Returns:** a `Greenness`: its name, its formula and its function of spectra.

    **Raises:** `InputError` where the bands needed are not known.

    >>> import numpy as np
    >>> from fynjax.canopy import choose_greenness
    >>> ndvi = choose_greenness(["green", "red", "nir"])
    >>> ndvi.formula, round(float(ndvi.function(np.array([0.05, 0.04, 0.36]))), 2)
    ('(nir - red) / (nir + red)', 0.8)
    """
    role = band_roles(names, wavelengths)
    shown = listed(names)
    if index == "auto":
        if {"red", "nir"} <= set(role):
            index = "ndvi"
        elif {"red", "green", "blue"} <= set(role):
            index = "excess_green"
        else:
            raise InputError(
                "expected bands known as red and near infrared, or as red, green and blue, but "
                f"the image has {shown}. Name the bands in order (--bands green,red,nir or their "
                "wavelengths in nm), or state which band is brighter where plants are (--greenness "
                "NAME; -NAME if darker)."
            )
    needed = {"ndvi": ("red", "nir"), "excess_green": ("red", "green", "blue")}.get(index)
    if needed is None:
        return _of_one_band(names, index)
    absent = [name for name in needed if name not in role]
    if absent:
        raise InputError(
            f"{index} needs the bands {', '.join(needed)}, but no band of the image ({shown}) is "
            f"known as {absent[0]}. Name the bands in order, for example --bands green,red,nir."
        )
    used = [role[name] for name in needed]
    if index == "ndvi":
        red, nir = used
        return Greenness(
            "NDVI",
            f"({names[nir]} - {names[red]}) / ({names[nir]} + {names[red]})",
            lambda s: _divide(s[..., nir] - s[..., red], s[..., nir] + s[..., red]),
        )
    red, green, blue = used
    return Greenness(
        "Excess green",
        f"(2 {names[green]} - {names[red]} - {names[blue]}) / their sum",
        lambda s: _divide(
            2.0 * s[..., green] - s[..., red] - s[..., blue],
            s[..., red] + s[..., green] + s[..., blue],
        ),
    )


def _of_one_band(names: Sequence[str], index: str) -> Greenness:
    sign, wanted = (-1.0, index[1:]) if index.startswith("-") else (1.0, index)
    known = [name.lower() for name in names]
    if wanted.strip().lower() in known:
        k = known.index(wanted.strip().lower())
    elif wanted.isdigit() and 1 <= int(wanted) <= len(names):
        k = int(wanted) - 1
    else:
        raise InputError(
            f"greenness must be auto, ndvi, excess_green, or a band of the image "
            f"({', '.join(names)}, or its number from 1), but is {index!r}"
        )
    name = names[k] if sign > 0 else f"-{names[k]}"
    return Greenness(name, name, lambda s: sign * np.asarray(s[..., k], float))
