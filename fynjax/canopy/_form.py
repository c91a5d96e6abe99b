"""What a growth form is: one record, of which `fynjax.canopy.forms` has one file each."""

from dataclasses import dataclass
from typing import Literal

from fynjax.canopy._elements import (
    Crown,
    Elements,
    Foliage,
    Shoots,
    flowers_on_top,
    leaves_in_bunches,
    wood_of_stems,
)

Shrubland = Literal["fynbos", "generic"]
"""Where plants have their usual values from: 18 fynbos plots, or published shrublands at large."""


FORMS_SHOWN = "The page docs/growth-forms.md shows them; `fynjax plant NAME` draws one."
"""Where growth forms are seen, for errors of a wrong one."""


@dataclass(frozen=True)
class LeafGeometry:
    """Shape and size of one leaf, which a mesh of the plant shows."""

    kind: str
    """blade, culm, thread, stem or none. A mesh has as many blades, culms and threads as their area
    takes, and as many stems as the form has shoots, as thick as their area makes them."""
    outline: str = ""
    """Outline of a blade: linear, lanceolate, elliptic, obovate or wedge."""
    length: float = 0.0
    """Length of a blade [m]."""
    width: float = 0.0
    """Width of a blade, or diameter of a culm, thread or stem [m]."""

    @property
    def tubular(self) -> bool:
        """Whether it is a culm, thread or stem."""
        return self.kind not in ("blade", "none")


@dataclass(frozen=True)
class FormPrior:
    """Median and standard deviation of a form's shoots in a population of plots.

    Those of `GrowthForm.prior` are assumed before any spectrum: `fynjax bioscape learn` starts
    from them, and a learned population that lacks the form says them of it. There leaf areas
    lie in the range of 0.5 to 4 that shrub crowns commonly show, known to a half. Shares of
    dead tissue are near those with which the spectra of 18 BioSCape plots agree best when each
    form has one value and these leaf areas, or assumed, known to one unit of the logit.
    Clumping is that of a pine shoot, 0.44, for small leaves along a twig, and less for culms,
    threads and large leaves; nobody measured it on shoots of fynbos.
    """

    dead_fraction: tuple[float, float]
    """Share of the area of live shoots that is dead or woody [-]."""
    leaf_area_index: tuple[float, float]
    """One-sided area of leaves over the ground area of crowns [m2 m-2]."""
    shoot_clumping: tuple[float, float]
    """Probability that light which a leaf scatters meets another leaf of its shoot [-]."""


@dataclass(frozen=True)
class Taxa:
    """Genera and families, apart by blanks; a family counts for genera that no form names."""

    genera: str = ""
    """Names of genera; each belongs to one form at most."""
    families: str = ""
    """Names of families, likewise."""


@dataclass(frozen=True, kw_only=True)
class GrowthForm:
    """A growth form: shape, usual areas and leaves, and where each number is from.

    What a plant has where the user gives nothing. Its name is that of its file.
    """

    description: str
    """The shape, in words."""
    sources: str
    """Sources of the numbers of the form; what is assumed."""

    leaf_area_index: float
    """One-sided area of leaves (or of green culms and threads) over the ground area of its crowns
    as seen from above [m2 m-2]; 0 of a dead plant."""
    wood_area_index: float
    """Half the surface of stems and branches below the shoots, and of dead stubs at the base, over
    the ground area of its crowns as seen from above [m2 m-2]."""
    flower_fraction: float
    """Flower area at full bloom per leaf area [-]."""
    shoot_clumping: float
    """Probability that light which a leaf scatters meets another leaf of its shoot [-], as far
    as the voxels do not show it. 0.44 is a pine shoot (Smolander and Stenberg 2005)."""
    dead_fraction: float
    """Share of the one-sided area of live shoots that is dead or woody [-]: old leaves and bracts,
    dead culms and sheaths on live ones, the twig that bears the leaves. Leaf area counts it."""
    leaf_angle: str
    """Distribution of the leaf normals (`leaf_angle`). Elements along shoots have the normals of
    these; the name nearest to them is stated."""
    leaf_diameter: float
    """Four times the area of a leaf's outline over its perimeter [m]: the diameter of a round leaf,
    and of the disc whose overlap with itself falls as fast when it is shifted a little, so that it
    makes the same hot spot. Culms and threads count as strips."""
    prior: FormPrior | None = None
    """Priors of dead tissue, leaf area and clumping before they are learned; None of a
    form without leaves."""
    generic: FormPrior | None = None
    """Dead tissue, leaf area and clumping in shrublands at large, of a form whose own values were
    learned from fynbos; None: its own values are of no shrubland in particular."""

    diameter: float
    """Usual crown diameter [m]."""
    height: float
    """Usual greatest height in a plot [m]."""
    size_source: str = "assumed by growth form"
    """Source of the usual size."""

    crown: Crown | None = None
    """Envelope of the leaves; None of a form that is shoots or threads alone."""
    shoots: Shoots | None = None
    """Stems or culms; None of a form without. A form with blades has them: in a mesh blades sit on
    stems and twigs."""
    foliage: Foliage
    """Arrangement of leaves, and how uneven the plant is."""
    leaf_elements: Elements = leaves_in_bunches
    """Places of the area elements of leaves, and so of the leaves of a mesh."""
    wood_elements: Elements = wood_of_stems
    """Places of the area elements of wood; twigs that a mesh has besides join leaves to them."""
    flower_elements: Elements = flowers_on_top
    """Places of the area elements of flowers."""
    leaf: LeafGeometry
    """Size and shape of a leaf of a plant whose taxon has no row in `leaf_sizes`."""

    leaf_mass_per_area: float
    """Dry mass over projected area of a leaf in the stands that `fynjax train` draws, median
    [g m-2]."""
    water_content: float
    """Water over fresh mass of the same leaf, median [-]."""
    round_leaves: bool = False
    """Whether the same leaf is a needle, culm or thread, of which half the surface is pi/2
    times the projected area."""
    stand_share: float = 0.0
    """Concentration of the Dirichlet distribution of its share of the live crowns of such a
    stand [-]; positive of a form with leaves."""

    chlorophyll: float = 60.0
    """Chlorophyll of its leaves where none was measured [ug cm-2]."""
    carotenoids: float = 12.0
    """Carotenoids of its leaves where none were measured [ug cm-2]."""
    anthocyanins: float = 1.5
    """Anthocyanins of its leaves where none were measured [ug cm-2]."""
    flat_leaved: Taxa = Taxa()
    """Plants of this form with flat leaves, in tables that state no form."""
    round_leaved: Taxa = Taxa()
    """Plants of this form with rolled leaves, needles or culms, in tables that state no form."""

    def value(self, name: str, plants: Shrubland) -> float:
        """Usual value of a parameter of a species table, such as `leaf_area_index`, in fynbos or in
        shrublands at large."""
        pair = None if plants == "fynbos" else getattr(self.generic, name, None)
        return getattr(self, name) if pair is None else pair[0]

    @property
    def leafy(self) -> bool:
        """Whether it has leaves, or green culms or threads."""
        return self.leaf_area_index > 0.0
