"""Tussocks of green culms: Restio and other restioids, sedges and grasses."""

from fynjax.canopy._elements import Foliage, Shoots, along_shoots
from fynjax.canopy._form import FormPrior, GrowthForm, LeafGeometry, Taxa

FORM = GrowthForm(
    description="Leafless green culms that fan out from a small base and arch over, some more "
    "than others, longer to one side; counted as leaf. Dead stubs at the base are wood, spikelets "
    "at the tips are flowers.",
    sources="Dead tissue, leaf area, clumping: means of the shipped prior (18 BioSCape plots), to "
    "two digits. Shrublands at large: leaf area that of grasslands, 1.7 with standard "
    "deviation 1.2 green (Asner et al. 2003, Global Ecology and Biogeography 12:191), over "
    "tussocks on three quarters of the ground; dead tissue as assumed before any spectrum; "
    "clumping as in fynbos, assumed, with twice its spread. Leaf diameter: mean over its "
    "taxa in `leaf_sizes`. Leaf mass, water, share of stands: the species of this form on "
    "those plots (doi:10.5281/zenodo.14198989). All else: assumed.",
    leaf_area_index=3.5,
    wood_area_index=0.05,
    flower_fraction=0.03,
    shoot_clumping=0.10,
    dead_fraction=0.68,
    leaf_angle="erectophile",
    leaf_diameter=0.0024,
    prior=FormPrior(
        dead_fraction=(0.45, 0.2475), leaf_area_index=(2.0, 1.0), shoot_clumping=(0.2, 0.1)
    ),
    generic=FormPrior(
        dead_fraction=(0.45, 0.25), leaf_area_index=(4.0, 2.8), shoot_clumping=(0.1, 0.09)
    ),
    diameter=0.5,
    height=0.5,
    size_source="mean of 1 taxa of this form in the shipped table of a plot burnt in 2006",
    shoots=Shoots(48, 0.12, (0.05, 0.50), (0.55, 1.00), 1.6, 0.3),
    foliage=Foliage(48, 0.0, 0.0, outline=0.45, uneven=0.0, bare=0.0),
    leaf_elements=along_shoots(0.0, 1.0),
    wood_elements=along_shoots(0.0, 0.3),
    flower_elements=along_shoots(0.85, 1.0),
    leaf=LeafGeometry("culm", width=0.0012),
    leaf_mass_per_area=395.0,
    water_content=0.52,
    round_leaves=True,
    stand_share=1.0,
    chlorophyll=50.0,
    carotenoids=10.0,
    flat_leaved=Taxa(
        genera="Agrostis Allium Ampelodesmos Arrhenatherum Asphodelus Avena "
        "Brachypodium Bromus Cortaderia Corymbium Dactylis Danthonia "
        "Deschampsia Festuca Holcus Hyparrhenia Koeleria Melica Molinia Nardus "
        "Phragmites Poa Sesleria Stipa Triodia",
        families="Amaryllidaceae Asparagaceae Asphodelaceae Haemodoraceae Hyacinthaceae "
        "Iridaceae Orchidaceae Poaceae Tecophilaeaceae Typhaceae "
        "Xanthorrhoeaceae",
    ),
    round_leaved=Taxa(
        genera="Bobartia Carex Eriophorum Juncus Luzula Lygeum Schoenus Scirpus Trichophorum",
        families="Cyperaceae Juncaceae Restionaceae",
    ),
)
