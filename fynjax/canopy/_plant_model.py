"""Plant models of the growth forms of low-stature shrubland, drawn from parametric crowns.

All shapes are stated assumptions (`fynjax.canopy.forms`), meant to be replaced by meshes
(`plant_model_from_mesh`) where there are some.
"""

from collections.abc import Mapping
from types import MappingProxyType

import jax.numpy as jnp
import numpy as np

from fynjax._core.errors import InputError
from fynjax.canopy._elements import individual_of, quasi_random, split_elements
from fynjax.canopy._form import FORMS_SHOWN
from fynjax.canopy._plant import Organ, PlantModel
from fynjax.canopy.forms import FORMS

_SHARE = {Organ.LEAF: 0.75, Organ.WOOD: 0.17, Organ.FLOWER: 0.08}


def plant_model(
    form: str,
    n_elements: int,
    *,
    seed: int,
    share: Mapping[Organ, float] = MappingProxyType(_SHARE),
) -> PlantModel:
    """The plant model of a growth form, as area elements in crown coordinates.

    **Arguments:**

    - `form`: a key of `FORMS`; `FORMS[form].description` describes its shape.
    - `n_elements`: number of area elements, at least 3. Where a form has several organs about 75 %
      are leaf, 17 % wood and 8 % flower, whatever their areas: the areas are the scene's.
    - `seed`: the same seed gives the same plant.
    - `share`: of the elements that each organ gets, in any unit, instead of these. Organs that the
      form does not have count for nothing.

    The outline of the crown departs from a circle by lobes, and has its area. Leaves stand in
    bunches at the ends of shoots, with gaps between; some shoots are bare. Flowers stand on the
    highest. Leaf normals follow the form's leaf angle distribution, those of stems and culms are
    perpendicular to them, flowers are planophile. Azimuths are uniform.

    **Returns:** a `PlantModel`. Its shape is fixed: there is nothing to differentiate in.

    **Raises:** `InputError` for another form, or fewer than 3 elements.

    >>> from fynjax.canopy import Organ, plant_model
    >>> plant = plant_model("rounded_shrub", 100, seed=1)
    >>> plant.position.shape, int((plant.organ == Organ.LEAF).sum())
    ((100, 3), 75)
    >>> round(float(plant.area_fraction[plant.organ == Organ.LEAF].sum()), 6)
    1.0
    """
    if form not in FORMS:
        raise InputError(
            f"`form` must be one of {', '.join(FORMS)}, but is {form!r}. {FORMS_SHOWN}"
        )
    if n_elements < 3:
        raise InputError(f"`n_elements` must be at least 3, one an organ, but is {n_elements}")
    made = FORMS[form]
    elements = {
        organ: places
        for organ, area, places in (
            (Organ.LEAF, made.leaf_area_index, made.leaf_elements),
            (Organ.WOOD, made.wood_area_index, made.wood_elements),
            (Organ.FLOWER, made.flower_fraction, made.flower_elements),
        )
        if area > 0.0
    }
    counts = split_elements(n_elements, {organ: share[organ] for organ in elements})
    plant = individual_of(made, seed, max(counts.get(Organ.LEAF, 1), 1))
    # Own stream for each organ: the leaves stay where they are if the stems change.
    drawn = [
        elements[organ](made, quasi_random(count, 6, [seed, int(organ)]), seed, plant)
        for organ, count in counts.items()
    ]
    position, normal = (np.concatenate(parts) for parts in zip(*drawn))
    return PlantModel(
        jnp.asarray(position),
        jnp.asarray(np.concatenate([np.full(n, 1.0 / n) for n in counts.values()])),
        jnp.asarray(np.where(normal[:, 2:] < 0.0, -normal, normal)),
        jnp.asarray(np.repeat([int(o) for o in counts], list(counts.values())), jnp.int32),
    )
