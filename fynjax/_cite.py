"""What to cite for the models of a run."""

from dataclasses import dataclass

from fynjax._core.errors import InputError


@dataclass(frozen=True)
class _Source:
    """An article, as BibTeX has it."""

    key: str
    author: str
    title: str
    journal: str
    year: int | None = None
    volume: str | None = None
    pages: str | None = None
    doi: str | None = None

    def bibtex(self) -> str:
        fields = ("author", "title", "journal", "year", "volume", "pages", "doi")
        known = [(name, getattr(self, name)) for name in fields]
        lines = [f"  {name} = {{{value}}}," for name, value in known if value is not None]
        return "\n".join([f"@article{{{self.key},", *lines, "}"])


_RSE = "Remote Sensing of Environment"
_SOURCES: dict[str, _Source] = {
    "scene": _Source(
        "fynbos_scene", "{The authors of the article}",
        "Construction and Validation of a High-Fidelity Virtual Scene for Low-Stature and "
        "High-Biodiversity Ecosystems - Simulating Multi-Modal Sensing Approaches",
        "Remote Sensing",
    ),
    "prospect": _Source(
        "jacquemoud1990", "Jacquemoud, S. and Baret, F.",
        "PROSPECT: A model of leaf optical properties spectra", _RSE, 1990, "34", "75--91",
        "10.1016/0034-4257(90)90100-Z",
    ),
    "prospect-5": _Source(
        "feret2008", "F{\\'e}ret, J.-B. and others",
        "PROSPECT-4 and 5: Advances in the leaf optical properties model separating "
        "photosynthetic pigments", _RSE, 2008, "112", "3030--3043", "10.1016/j.rse.2008.02.012",
    ),
    "prospect-d": _Source(
        "feret2017", "F{\\'e}ret, J.-B. and others",
        "PROSPECT-D: Towards modeling leaf optical properties through a complete lifecycle",
        _RSE, 2017, "193", "204--215", "10.1016/j.rse.2017.03.004",
    ),
    "prospect-pro": _Source(
        "feret2021", "F{\\'e}ret, J.-B. and others",
        "PROSPECT-PRO for estimating content of nitrogen-containing leaf proteins and other "
        "carbon-based constituents", _RSE, 2021, "252", "112173", "10.1016/j.rse.2020.112173",
    ),
    "sail": _Source(
        "verhoef2007", "Verhoef, W. and others",
        "Unified optical-thermal four-stream radiative transfer theory for homogeneous "
        "vegetation canopies", "IEEE Transactions on Geoscience and Remote Sensing", 2007, "45",
        "1808--1822", "10.1109/TGRS.2007.895844",
    ),
    "shoots": _Source(
        "smolander2003", "Smolander, S. and Stenberg, P.",
        "A method to account for shoot scale clumping in coniferous canopy reflectance models",
        _RSE, 2003, "88", "363--373",
    ),
    "ground": _Source(
        "rahman1993", "Rahman, H. and Pinty, B. and Verstraete, M. M.",
        "Coupled surface-atmosphere reflectance (CSAR) model: 2. Semiempirical surface model "
        "usable with NOAA advanced very high resolution radiometer data",
        "Journal of Geophysical Research", 1993, "98", "20791--20801", "10.1029/93JD02072",
    ),
    "6s": _Source(
        "vermote1997", "Vermote, E. F. and others",
        "Second Simulation of the Satellite Signal in the Solar Spectrum, 6S: an overview",
        "IEEE Transactions on Geoscience and Remote Sensing", 1997, "35", "675--686",
        "10.1109/36.581987",
    ),
    "spctrl2": _Source(
        "bird1986", "Bird, R. E. and Riordan, C.",
        "Simple solar spectral model for direct and diffuse irradiance on horizontal and tilted "
        "planes at the Earth's surface for cloudless atmospheres",
        "Journal of Climate and Applied Meteorology", 1986, "25", "87--97",
        "10.1175/1520-0450(1986)025<0087:SSSMFD>2.0.CO;2",
    ),
    "emcee": _Source(
        "foremanmackey2013", "Foreman-Mackey, D. and others", "emcee: The MCMC Hammer",
        "Publications of the Astronomical Society of the Pacific", 2013, "125", "306--312",
        "10.1086/670067",
    ),
    "nuts": _Source(
        "hoffman2014", "Hoffman, M. D. and Gelman, A.",
        "The No-U-Turn Sampler: Adaptively Setting Path Lengths in Hamiltonian Monte Carlo",
        "Journal of Machine Learning Research", 2014, "15", "1593--1623",
    ),
}  # fmt: skip

_TOGETHER: dict[str, tuple[str, ...]] = {
    "prospect": ("prospect", "prospect-5", "prospect-d", "prospect-pro"),
    "prospect-5": ("prospect", "prospect-5"),
    "prospect-d": ("prospect", "prospect-d"),
    "prospect-pro": ("prospect", "prospect-pro"),
}


def cite(*components: str) -> str:
    """BibTeX of the articles behind what was used.

    **Arguments:** `components`, such as "scene", "prospect", "prospect-d", "6s", "spctrl2",
    "shoots", "ground", "emcee" or "nuts"; all if none is given. "prospect" is every version, and
    one version brings the first article too.

    **Returns:** the entries, each once. Author lists of more than two are given as "and others".

    **Raises:** `InputError` for an unknown component.

    >>> import fynjax as fx
    >>> print(fx.cite("emcee").splitlines()[0])
    @article{foremanmackey2013,
    """
    wanted: dict[str, None] = {}
    for component in components or tuple(_SOURCES):
        name = component.lower()
        if name not in _SOURCES:
            raise InputError(
                f"`components` must be among {', '.join(_SOURCES)}, but one is {component!r}"
            )
        wanted |= dict.fromkeys(_TOGETHER.get(name, (name,)))
    return "\n\n".join(_SOURCES[name].bibtex() for name in wanted)
