"""Rounded shrubs: Erica irregularis, Chironia, Indigofera, Hermannia, and most others."""

from fynjax.canopy._elements import Crown, Foliage, Shoots
from fynjax.canopy._form import FormPrior, GrowthForm, LeafGeometry, Taxa

FORM = GrowthForm(
    description="Dome resting near the ground, foliage in many small tufts in its outer shell, "
    "many fine stems.",
    sources="Dead tissue, leaf area, clumping: means of the shipped prior (18 BioSCape plots), to "
    "two digits. Shrublands at large: leaf area that of 5 shrublands, 2.1 with standard "
    "deviation 1.6 green (Asner et al. 2003, Global Ecology and Biogeography 12:191), over "
    "crowns on three quarters of the ground; dead tissue that of chaparral 10 to 40 years "
    "old by mass (Rothermel and Philpot 1973, Journal of Forestry 71:640); clumping as in "
    "fynbos, assumed, with twice its spread. Leaf diameter: mean over its taxa in "
    "`leaf_sizes`. Leaf mass, water, share of stands: the species of this form on those "
    "plots (doi:10.5281/zenodo.14198989). All else: assumed.",
    leaf_area_index=3.2,
    wood_area_index=0.50,
    flower_fraction=0.05,
    shoot_clumping=0.23,
    dead_fraction=0.56,
    leaf_angle="spherical",
    leaf_diameter=0.004,
    prior=FormPrior(
        dead_fraction=(0.30, 0.21), leaf_area_index=(3.0, 1.5), shoot_clumping=(0.4, 0.2)
    ),
    generic=FormPrior(
        dead_fraction=(0.2, 0.14), leaf_area_index=(3.5, 2.6), shoot_clumping=(0.23, 0.24)
    ),
    diameter=0.3,
    height=0.585,
    size_source="mean of 4 taxa of this form in the shipped table of a plot burnt in 2006",
    crown=Crown(0.0, 0.35, 2.5, 2.2, height_power=0.3, shell_power=1.5),
    shoots=Shoots(20, 0.03, (0.05, 0.42), (0.35, 0.90), 1.1, 0.7),
    foliage=Foliage(70, 0.085, 0.18, outline=0.30, uneven=0.12, bare=0.03),
    leaf=LeafGeometry("blade", "linear", 0.004, 0.0008),
    leaf_mass_per_area=100.0,
    water_content=0.74,
    stand_share=0.1,
    flat_leaved=Taxa(
        genera="Artemisia Baccharis Bupleurum Cistus Coriaria Coronilla Diastella "
        "Dorycnium Encelia Eriogonum Euphorbia Euryops Gaultheria Halimione "
        "Halimium Helichrysum Hypericum Lavandula Ononis Phlomis Potentilla "
        "Pteridium Retama Rosmarinus Rubus Ruscus Salvia Santolina "
        "Sarcopoterium Satureja Scorzonera Spiraea Thymelaea Vaccinium",
        families="Amaranthaceae Apiaceae Apocynaceae Asteraceae Boraginaceae "
        "Brassicaceae Campanulaceae Caryophyllaceae Cistaceae Dennstaedtiaceae "
        "Euphorbiaceae Fabaceae Geissolomataceae Gentianaceae Geraniaceae "
        "Hypericaceae Lamiaceae Malvaceae Penaeaceae Plantaginaceae "
        "Plumbaginaceae Polygonaceae Ranunculaceae Roridulaceae "
        "Scrophulariaceae Solanaceae Verbenaceae Zygophyllaceae",
    ),
    round_leaved=Taxa(
        genera="Paranomus Serruria Sorocephalus Spatalla", families="Aizoaceae Crassulaceae"
    ),
)
