"""Shrubs and small trees with large leaves: Euclea, Pterocelastrus, Protea."""

from fynjax.canopy._elements import Crown, Foliage, Shoots
from fynjax.canopy._form import FormPrior, GrowthForm, LeafGeometry, Taxa

FORM = GrowthForm(
    description="Ellipsoidal crown on a few stout stems, foliage in large clumps in its outer "
    "shell, oblique leaves.",
    sources="Dead tissue, leaf area, clumping: means of the shipped prior (18 BioSCape plots), to "
    "two digits. Shrublands at large: leaf area that of 5 shrublands, 2.1 with standard "
    "deviation 1.6 green (Asner et al. 2003, Global Ecology and Biogeography 12:191), over "
    "crowns on three quarters of the ground; dead tissue that of chaparral 10 to 40 years "
    "old by mass (Rothermel and Philpot 1973, Journal of Forestry 71:640); clumping as in "
    "fynbos, assumed, with twice its spread. Leaf diameter: mean over its taxa in "
    "`leaf_sizes`. Leaf mass, water, share of stands: the species of this form on those "
    "plots (doi:10.5281/zenodo.14198989). All else: assumed.",
    leaf_area_index=4.6,
    wood_area_index=0.50,
    flower_fraction=0.01,
    shoot_clumping=0.12,
    dead_fraction=0.40,
    leaf_angle="plagiophile",
    leaf_diameter=0.023,
    prior=FormPrior(
        dead_fraction=(0.25, 0.1875), leaf_area_index=(3.5, 1.75), shoot_clumping=(0.2, 0.1)
    ),
    generic=FormPrior(
        dead_fraction=(0.2, 0.14), leaf_area_index=(3.5, 2.6), shoot_clumping=(0.12, 0.09)
    ),
    diameter=0.675,
    height=2.445,
    size_source="mean of 2 taxa of this form in the shipped table of a plot burnt in 2006",
    crown=Crown(0.12, 0.60, 2.0, 2.0, height_power=0.3, shell_power=1.5),
    shoots=Shoots(8, 0.04, (0.10, 0.40), (0.60, 0.90), 1.5, 0.6),
    foliage=Foliage(24, 0.15, 0.24, outline=0.45, uneven=0.15, bare=0.05),
    leaf=LeafGeometry("blade", "obovate", 0.025, 0.0115),
    leaf_mass_per_area=235.0,
    water_content=0.61,
    stand_share=0.6,
    chlorophyll=65.0,
    carotenoids=13.0,
    flat_leaved=Taxa(
        genera="Acacia Acer Adenocarpus Alnus Amelanchier Arbutus Arctostaphylos "
        "Atriplex Banksia Betula Buddleja Buxus Carpinus Castanea Ceanothus "
        "Celtis Ceratonia Cercocarpus Chamaerops Citrus Cornus Corylus Cotinus "
        "Cotoneaster Crataegus Daphne Dodonaea Elaeagnus Escallonia Eucalyptus "
        "Euonymus Fagus Ficus Fontanesia Frangula Fraxinus Garrya Heteromeles "
        "Hippophae Ilex Jasminum Kageneckia Larrea Laurus Ligustrum Lithraea "
        "Malosma Malus Myrica Myrtus Nerium Nothofagus Olea Osteospermum Ostrya "
        "Osyris Phillyrea Photinia Pistacia Pittosporum Podalyria Populus "
        "Prosopis Prunus Pyrus Quercus Quillaja Rhamnus Rhododendron Rhus Rosa "
        "Salix Sambucus Schinus Sorbus Symphoricarpos Tamarix Terminalia Ulmus "
        "Umbellularia Viburnum Virgilia Vitex Ziziphus",
        families="Adoxaceae Altingiaceae Anacardiaceae Aquifoliaceae Araliaceae "
        "Betulaceae Buxaceae Caprifoliaceae Celastraceae Cornaceae Cunoniaceae "
        "Ebenaceae Elaeagnaceae Fagaceae Juglandaceae Lauraceae Moraceae "
        "Myricaceae Myrtaceae Oleaceae Pittosporaceae Primulaceae Proteaceae "
        "Salicaceae Sapindaceae Sapotaceae Tamaricaceae Ulmaceae Viburnaceae",
    ),
    round_leaved=Taxa(
        genera="Abies Cedrus Cupressus Hakea Juniperus Picea Pinus Taxus Tetraclinis",
        families="Cupressaceae Pinaceae Taxaceae",
    ),
)
