"""Tussocks of green culms: Restio and other restioids, sedges and grasses."""

import numpy as np

from fynjax.canopy._elements import Foliage, Shoots, along_shoots, free_shoots, individual_of
from fynjax.canopy._form import FormPrior, GrowthForm, MeshLeaf, MeshRecipe, Taxa
from fynjax.canopy._lines import STEM_POINTS, Skeleton, shoot_paths

_CULMS = 13  # stream of random numbers


def culms(form: GrowthForm, diameter: float, height: float, n_culms: int, seed: int) -> Skeleton:
    """Culms that fan out and divide in two above the middle, and dead sheaths at their base."""
    shoots = form.shoots
    assert shoots is not None
    plant = individual_of(form, seed, 1)
    drawn, arch = free_shoots(shoots, seed, n_culms)
    paths = shoot_paths(drawn, arch, diameter, height, seed)
    paths = plant.widened(paths.reshape(-1, 3)).reshape(paths.shape)
    rng = np.random.default_rng([seed, _CULMS])
    # A second branch leaves each culm above its middle and ends beside its tip.
    joint = rng.integers(STEM_POINTS // 2, STEM_POINTS - 4, n_culms)
    part = np.linspace(0.0, 1.0, STEM_POINTS // 2)
    place = joint[:, None] + part * (STEM_POINTS - 1 - joint)[:, None]
    low = np.minimum(place.astype(int), STEM_POINTS - 2)
    share = (place - low)[..., None]
    row = np.arange(n_culms)[:, None]
    second = (1 - share) * paths[row, low] + share * paths[row, low + 1]
    aside = rng.normal(0.0, 0.10 * height, (n_culms, 3)) * [1.0, 1.0, 0.4]
    second = second + part[None, :, None] ** 1.3 * (aside * [1, 1, 0.5])[:, None, :]
    second[..., 2] = np.minimum(second[..., 2], height)
    thickness = np.linspace(1.0, 0.7, STEM_POINTS)
    green = [
        (paths, np.broadcast_to(thickness, paths.shape[:2])),
        (second, np.broadcast_to(np.linspace(0.8, 0.6, len(part)), second.shape[:2])),
    ]
    # Dead sheaths: stubs round the foot, shorter outside.
    n_stubs = max(6, n_culms // 6)
    turn = rng.uniform(0.0, 2.0 * np.pi, n_stubs)
    distance = shoots.base_radius * diameter * np.sqrt(rng.random(n_stubs))
    level = height * rng.uniform(0.05, 0.16, n_stubs)
    s = np.linspace(0.0, 1.0, 4)
    out = distance[:, None] * (1.0 + 0.5 * s)
    stubs = np.stack(
        [out * np.cos(turn)[:, None], out * np.sin(turn)[:, None], level[:, None] * s], axis=-1
    )
    return Skeleton(
        stems=[(stubs, np.broadcast_to([1.0, 1.1, 1.0, 0.7], (n_stubs, 4)))], green=green
    )


FORM = GrowthForm(
    description="Leafless green culms that fan out from a small base and arch over, some more "
    "than others, longer to one side; counted as leaf. Dead stubs at the base are wood, spikelets "
    "at the tips are flowers.",
    sources="Dead tissue, leaf area, clumping: means of the shipped prior (18 BioSCape plots), to "
    "two digits. Leaf diameter: mean over its taxa in `leaf_sizes`. Leaf mass, water, share of "
    "stands: the species of this form on those plots (doi:10.5281/zenodo.14198989). All else: "
    "assumed.",
    leaf_area_index=4.4,
    wood_area_index=0.05,
    flower_fraction=0.03,
    shoot_clumping=0.10,
    dead_fraction=0.67,
    leaf_angle="erectophile",
    leaf_diameter=0.0024,
    prior=FormPrior(
        dead_fraction=(0.45, 0.2475), leaf_area_index=(2.0, 1.0), shoot_clumping=(0.2, 0.1)
    ),
    diameter=0.5,
    height=0.5,
    size_source="mean of 1 taxa of this form in the shipped table of a plot burnt in 2006",
    shoots=Shoots(48, 0.12, (0.05, 0.50), (0.55, 1.00), 1.6, 0.3),
    foliage=Foliage(48, 0.0, 0.0, outline=0.45, uneven=0.0, bare=0.0),
    leaf_elements=along_shoots(0.0, 1.0),
    wood_elements=along_shoots(0.0, 0.3),
    flower_elements=along_shoots(0.85, 1.0),
    mesh=MeshRecipe(MeshLeaf("culm", width=0.0012), culms, green_sides=4),
    leaf_mass_per_area=395.0,
    water_content=0.52,
    round_leaves=True,
    stand_share=1.0,
    chlorophyll=50.0,
    carotenoids=10.0,
    flat_leaved=Taxa(
        genera="Corymbium",
        families="Amaryllidaceae Asparagaceae Asphodelaceae Haemodoraceae Hyacinthaceae Iridaceae "
        "Orchidaceae Poaceae Tecophilaeaceae",
    ),
    round_leaved=Taxa(genera="Bobartia", families="Cyperaceae Juncaceae Restionaceae"),
)
