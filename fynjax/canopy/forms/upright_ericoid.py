"""Upright shrubs with small leaves: Metalasia, Passerina, Anthospermum, many Erica."""

from fynjax.canopy._elements import Crown, Foliage, Shoots
from fynjax.canopy._form import FormPrior, GrowthForm, LeafGeometry, Taxa

FORM = GrowthForm(
    description="Broom-like: crown widens upwards to 70 % of the height, long ascending shoots of "
    "uneven height with gaps between, small leaves pressed along them, flowers at their ends.",
    sources="Dead tissue, leaf area, clumping: means of the shipped prior (18 BioSCape plots), to "
    "two digits. Shrublands at large: leaf area that of 5 shrublands, 2.1 with standard "
    "deviation 1.6 green (Asner et al. 2003, Global Ecology and Biogeography 12:191), over "
    "crowns on three quarters of the ground; dead tissue that of chaparral 10 to 40 years "
    "old by mass (Rothermel and Philpot 1973, Journal of Forestry 71:640), and the twig "
    "that bears small leaves; clumping as in fynbos, assumed, with twice its spread. Leaf "
    "diameter: mean over its taxa in `leaf_sizes`, without Clutia, whose leaves are those "
    "of no ericoid shrub. Leaf mass, water, share of stands: the species of this form on "
    "those plots (doi:10.5281/zenodo.14198989). All else: assumed.",
    leaf_area_index=3.7,
    wood_area_index=0.40,
    flower_fraction=0.05,
    shoot_clumping=0.18,
    dead_fraction=0.63,
    leaf_angle="erectophile",
    leaf_diameter=0.0015,
    prior=FormPrior(
        dead_fraction=(0.40, 0.24), leaf_area_index=(2.5, 1.25), shoot_clumping=(0.5, 0.25)
    ),
    generic=FormPrior(
        dead_fraction=(0.25, 0.15), leaf_area_index=(3.5, 2.6), shoot_clumping=(0.18, 0.19)
    ),
    diameter=0.2375,
    height=1.125,
    size_source="mean of 4 taxa of this form in the shipped table of a plot burnt in 2006",
    crown=Crown(0.12, 0.70, 1.6, 2.5, height_power=2.0, shell_power=1.0),
    shoots=Shoots(12, 0.03, (0.05, 0.40), (0.75, 0.95), 1.4, 0.7),
    foliage=Foliage(34, 0.085, 0.45, outline=0.40, uneven=0.25, bare=0.08),
    leaf=LeafGeometry("blade", "linear", 0.006, 0.0008),
    leaf_mass_per_area=185.0,
    water_content=0.49,
    round_leaves=True,
    stand_share=1.0,
    flat_leaved=Taxa(
        genera="Amphithalea Anthospermum Calicotome Clutia Colletia Cytisus Genista "
        "Nassauvia Polygala Psoralea Rafnia Spartium Ulex",
        families="Peraceae Polygalaceae Rosaceae Rubiaceae Rutaceae",
    ),
    round_leaved=Taxa(
        genera="Adenostoma Andromeda Aspalathus Aulax Calluna Casuarina Cyclopia "
        "Daboecia Disparago Elytropappus Ephedra Erica Leptospermum Melaleuca "
        "Metalasia Phylica Stoebe Thesium",
        families="Bruniaceae Ephedraceae Ericaceae Grubbiaceae Rhamnaceae Santalaceae "
        "Stilbaceae Thymelaeaceae",
    ),
)
