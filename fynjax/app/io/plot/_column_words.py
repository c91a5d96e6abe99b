"""What people call the columns of a table of plants, in several languages, and what they write for
growth forms and for ground without plants."""

import re
import unicodedata
from dataclasses import dataclass

COLUMNS: dict[str, str] = {
    "taxon": "taxon;taxa;taxon name;species;species name;scientific name;latin name;accepted name;"
    "plant;plant name;espece;especes;nom scientifique;nom latin;nom de l espece;plante;"
    "art;artname;arten;pflanze;pflanzenart;wissenschaftlicher name;especie;especies;"
    "nombre cientifico;nome scientifico;nome cientifico;specie;planta;pianta;soort;soortnaam;"
    "wetenschappelijke naam;spesie;spesienaam;plantspesie;name;nom;nombre;naam;nome",
    "cover": "cover;coverage;cover percent;percent cover;percentage cover;cover class;cov;"
    "projected cover;foliar cover;canopy cover;crown cover;braun blanquet;cover abundance;"
    "recouvrement;taux de recouvrement;couverture;abondance dominance;abondance;coefficient;"
    "deckung;deckungsgrad;deckungsanteil;artmachtigkeit;artmaechtigkeit;cobertura;recubrimiento;"
    "abundancia;abundancia dominancia;copertura;ricoprimento;abundancia cobertura;bedekking;"
    "bedekkingsgraad;dekking;kroonbedekking",
    "diameter": "diameter;mean diameter;crown diameter;mean crown diameter;canopy diameter;"
    "plant diameter;crown width;canopy width;plant width;width;diametre;diametre moyen;"
    "diametre de couronne;diametre couronne;diametre du houppier;diametre houppier;largeur;"
    "durchmesser;kronendurchmesser;kronenbreite;breite;diametro;diametro medio;"
    "diametro de copa;ancho;ancho de copa;diametro chioma;diametro della chioma;larghezza;largura;"
    "diametro da copa;kroondiameter;kruindiameter;deursnee;kroondeursnee;breedte;diam;crown diam",
    "height": "height;max height;maximum height;height max;greatest height;plant height;"
    "mean height;canopy height;top height;hauteur;hauteur max;hauteur maximale;hauteur moyenne;"
    "hohe;hoehe;wuchshohe;wuchshoehe;pflanzenhohe;pflanzenhoehe;maximale hohe;maximale hoehe;"
    "altura;altura maxima;altura media;altezza;altezza massima;altezza media;hoogte;"
    "maximale hoogte;hoogte max;hmax;h max;ht",
    "form": "growth form;growthform;life form;lifeform;habit;plant type;functional group;"
    "functional type;physiognomy;forme biologique;type biologique;forme de vie;forme de croissance;"
    "port;raunkiaer;raunkiaer life form;lebensform;wuchsform;forma biologica;forma de vida;"
    "forma vital;forma de crecimiento;biotipo;habito;forma di crescita;forma vitale;"
    "forma de crescimento;levensvorm;groeivorm;lewensvorm;type;tipo;typ",
    "family": "family;famille;familie;familia;famiglia;plant family",
    "genus": "genus;genre;gattung;genero;genere;geslacht",
    "epithet": "epithet;specific epithet;species epithet;epithete;artepitheton;epiteto",
    "layer": "layer;stratum;strata;strate;schicht;estrato;strato;laag;vegetation layer",
    "plot": "plot;plot id;plot name;plot number;releve;releve id;releve number;numero de releve;"
    "quadrat;site;station;aufnahme;aufnahmenummer;parcela;parcelle;placette;inventario;rilievo;"
    "opname;perseel",
}
"""Names of columns, without accents, marks and units, by what they hold."""

_UNITS = {
    "m": ("m", "metre", "metres", "meter", "meters", "metro", "metros", "metri"),
    "dm": ("dm",),
    "cm": ("cm", "centimetre", "centimetres", "centimeter", "centimeters", "zentimeter"),
    "mm": ("mm", "millimetre", "millimetres", "millimeter", "millimeters"),
    "ft": ("ft", "feet", "foot"),
    "in": ("in", "inch", "inches"),
    "%": ("%", "percent", "pct", "pourcent", "pourcentage", "prozent", "por ciento", "per cento"),
    "fraction": ("fraction", "0 1", "proportion", "share", "anteil", "fraccion", "frazione"),
}
METRES = {"m": 1.0, "dm": 0.1, "cm": 0.01, "mm": 0.001, "ft": 0.3048, "in": 0.0254}
"""Metres in each unit of length that a column may have."""

_FORM_WORDS = (
    ("deadwood", "dead wood;deadwood;standing dead;bois mort;totholz;madera muerta;legno morto"),
    ("moss_layer", "moss;mosses;bryophyt;lichen;mousse;moos;flechte;musgo;liquen;muschi;muschio;"
     "korstmos;mos"),
    ("climber", "climb;liana;liane;vine;grimpant;kletter;schling;trepador;rampicant;klimplant;"
     "klimmer;parasit"),
    ("column", "columnar;cactus;cactac;kaktus;stem succulent"),
    ("succulent", "succulent;sukkulent;suculent;crassulesc;vetplant"),
    ("cushion", "cushion;coussin;polster;cojin;pulvin;kussenplant"),
    ("rosette", "rosette;rosulat;agavoid;rosetten"),
    ("mat", "mat;mat forming;prostrate;creeping;rampant;tapissant;teppich;kriech;rastrer;rasteir;"
     "strisciant;kruipend;carpet;tapis"),
    ("sward", "sward;meadow;lawn;pasture;turf;pelouse;prairie;gazon;rasen;wiese;cesped;pradera"),
    ("tussock", "tussock;grass;graminoid;gramin;sedge;rush;reed;restio;restioid;herbe graminoide;"
     "poace;cyperace;juncace;gras;graser;grasartige;seggen;binsen;horst;junco;zegge;rus"),
    ("upright_ericoid", "ericoid;heath;heather;broom;bruyere;heide;brezo;erica;ginst;genet"),
    ("broad_leaved", "tree;arbre;baum;arbol;albero;arvore;boom;phanerophyt;fanerofit;"
     "sclerophyll;broad leaved;broadleaf;feuillu;tall shrub;macrophanerophyt;nanophanerophyt;"
     "proteoid"),
    ("rounded_shrub", "shrub;dwarf shrub;subshrub;sub shrub;bush;arbuste;arbrisseau;buisson;"
     "ligneux;strauch;zwergstrauch;halbstrauch;arbusto;matorral;cespuglio;suffrutice;struik;"
     "dwergstruik;bossie;chamaephyt;chamephyt;camefit;herb;herbe;herbacee;kraut;krautige;hierba;erba;kruid;"
     "forb;annual;perennial;annuelle;vivace;hemicryptophyt;hemicriptofit;emicriptofit;therophyt;"
     "terofit;geophyt;geofit;fern;fougere;farn;helecho;felce;varen;legume"),
)  # fmt: skip
_RAUNKIAER = {
    **dict.fromkeys(("ph", "p", "np", "nph", "mp"), "broad_leaved"),
    **dict.fromkeys(("ch", "h", "t", "th", "g"), "rounded_shrub"),
}
"""Letters of life forms after Raunkiaer."""

_GROUND = {
    "litter": "litter;litiere;streu;hojarasca;lettiera;strooisel;dead leaves;mulch;necromasse",
    "rock": "rock;rocks;stone;stones;bare rock;rocher;roche;roche nue;cailloux;pierres;fels;stein;"
    "steine;roca;piedra;piedras;roccia;pietre;rots;steen;gravel;rocha",
    "char": "ash;char;charcoal;burnt ground;cendre;charbon;asche;ceniza;carbon;cenere",
    "bare": "bare;bare ground;bare soil;open ground;soil;sol;sol nu;boden;offener boden;"
    "nackter boden;suelo;suelo desnudo;suolo;suolo nudo;solo nu;kale grond;kale bodem;sand;sable;"
    "kaal grond",
}
_TOTAL = "total;totals;sum;summe;somme;suma;somma;totaal;gesamt;total cover;gesamtdeckung;"\
    "recouvrement total;cobertura total"  # fmt: skip


def words_of(text: str) -> str:
    """Text in small letters, without accents, its words one blank apart."""
    plain = unicodedata.normalize("NFKD", text.replace("ß", "ss"))
    plain = "".join(c for c in plain if not unicodedata.combining(c)).casefold()
    return " ".join(re.findall(r"[a-z0-9%]+", plain))


_OF_UNIT = {word: unit for unit, names in _UNITS.items() for word in names}
_ROLE_OF = {word: role for role, words in COLUMNS.items() for word in words.split(";")}
_NOT_OF_CROWNS = re.compile(r"\b(stem|trunk|basal|base|dbh|dbasal|tronc|stamm|tallo|fusto|leaf)\b")


@dataclass(frozen=True)
class Heading:
    """What the heading of a column says."""

    role: str
    """What it holds, a key of `COLUMNS`; empty of one that no word names."""
    unit: str
    """Its unit, such as "cm" or "%"; empty where none is stated."""
    exact: bool
    """Whether the whole heading is a known name, not only part of it."""


def heading(name: str) -> Heading:
    """What a column holds by its heading: "Hauteur (cm)" is a height in cm.

    **Arguments:** `name`, as the table has it.
    """
    unit = ""
    for bracket in re.findall(r"[(\[{]([^)\]}]*)[)\]}]", name):
        unit = unit or _OF_UNIT.get(words_of(bracket), "")
    plain = words_of(
        re.sub(r"[(\[{][^)\]}]*[)\]}]", " ", re.sub(r"([a-z])([A-Z])", r"\1 \2", name))
    )
    for word in (plain.rpartition(" ")[2], plain.partition(" ")[0]):
        if not unit and " " in plain and word in _OF_UNIT:
            unit = _OF_UNIT[word]
    if "%" in plain:
        unit = unit or "%"
    bare = plain.replace("%", " ")
    words = bare.split()
    while len(words) > 1 and words[-1] in _OF_UNIT:
        words.pop()
    while len(words) > 1 and words[0] in _OF_UNIT:
        words.pop(0)
    bare = " ".join(words)
    if bare in _ROLE_OF:
        return Heading(_ROLE_OF[bare], unit, exact=True)
    if _NOT_OF_CROWNS.search(bare):
        return Heading("", unit, exact=False)
    padded, found = f" {bare} ", ("", 0)
    for word, role in _ROLE_OF.items():
        if len(word) > max(found[1], 3) and f" {word} " in padded:
            found = role, len(word)
    return Heading(found[0], unit, exact=False)


def form_of_words(text: str) -> str:
    """The growth form that a life form or habit stands for, in any of several languages; empty of
    words that name none.

    **Arguments:** `text`, such as "chaméphyte", "Zwergstrauch", "Ch" or "tall shrub".
    """
    plain = words_of(text)
    if plain in _RAUNKIAER:
        return _RAUNKIAER[plain]
    padded, best = f" {plain} ", ("", 0)
    for form, words in _FORM_WORDS:
        for word in words.split(";"):
            # Of long words the beginning of one will do: chamaephyte, chamaephytes.
            there = f" {word}" in padded if len(word) > 3 else f" {word} " in padded
            if there and len(word) > best[1]:
                best = form, len(word)
    if not best[0] and len(parts := plain.split()) > 1:
        return next((_RAUNKIAER[one] for one in parts if len(one) == 2 and one in _RAUNKIAER), "")
    return best[0]


def ground_of_words(text: str) -> str:
    """What of the ground a row of a table is: "litter", "rock", "char", "bare", or "total" of a
    sum; empty of a plant."""
    plain = words_of(text)
    if plain in _TOTAL.split(";"):
        return "total"
    return next((kind for kind, words in _GROUND.items() if plain in words.split(";")), "")
