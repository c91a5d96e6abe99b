"""Which growth form the plants of a genus or of a family mostly have."""

from dataclasses import dataclass

from fynjax.canopy.forms import FORMS


@dataclass(frozen=True)
class FormOfTaxon:
    """Growth form of a genus or family, and the shape of its leaves."""

    growth_form: str
    """Name of the form, as in `FORMS`."""
    source: str
    """'genus' or 'family', whichever said so."""
    round_leaves: bool
    """Whether leaves are needles, culms or rolled."""


def form_of_taxon(genus: str, family: str = "") -> FormOfTaxon | None:
    """The growth form that a genus mostly has, else that of a family.

    **Arguments:** `genus`, `family`: names as in floras; either may be empty.

    **Returns:** `FormOfTaxon`, or `None` where no form names either (`GrowthForm.flat_leaved`,
    `GrowthForm.round_leaved`).

    >>> from fynjax.canopy import form_of_taxon
    >>> form_of_taxon("Quercus").growth_form, form_of_taxon("Lygos", "Poaceae").source
    ('broad_leaved', 'family')
    """
    for kind, name, source in (("genera", genus, "genus"), ("families", family, "family")):
        for growth_form, form in FORMS.items():
            for taxa, round_leaves in ((form.round_leaved, True), (form.flat_leaved, False)):
                if name and name in getattr(taxa, kind).split():
                    return FormOfTaxon(growth_form, source, round_leaves)
    return None
