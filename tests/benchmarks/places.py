"""How well plants are found in the pixels of an orthophoto, on twins whose plants are known.

`python -m tests.benchmarks.places --size 3 --taxa 8 --seeds 1 2`: the truth is a plot of the table
with leaves, sizes and leaf areas drawn from their priors, drawn with another seed than the search
has; its image has pixels of 2.5 cm, noise of 1 % and gains of 10 %. Covers are the table's, but for
whole plants, or with `--covers` off by 25 %, as the search takes them. With `--known` leaves and
gains are those of the table, which tells what the search loses from what is not known. With
`--explicit` the truth is not the model's: stands of other crowns, of single leaves, in an image by
path tracing (`tests.benchmarks.other_truths`) with pixels of 5 cm.
"""

import time

import jax.numpy as jnp
import numpy as np
from scipy.optimize import linear_sum_assignment

import fynjax as fx
from fynjax._core.memory import peak_memory
from fynjax.app.assembly import FREE_OF_PLANTS, blocks_of
from fynjax.canopy import table1_2006
from fynjax.inversion import PlacesSettings, find_places
from fynjax.scene import Instances, Placement, aim, hard_instances, projected_cover, with_values
from fynjax.sensors import Gains, shipped_sensor
from tests.benchmarks import other_truths
from tests.benchmarks._measure import options

EIGHT = [
    ("Erica irregularis", "rounded_shrub", 45, 14, 0.67),
    ("Metalasia muricata", "upright_ericoid", 35, 10, 1.2),
    ("Restio eleocharis", "tussock", 40, 10, 0.6),
    ("Passerina corymbosa", "upright_ericoid", 50, 10, 1.33),
    ("Indigofera brachystachya", "rounded_shrub", 40, 8, 0.67),
    ("Euclea racemosa", "broad_leaved", 70, 8, 1.6),
    ("Pterocelastrus tricuspidatus", "broad_leaved", 90, 7, 2.0),
    ("Hermannia ternifolia", "rounded_shrub", 25, 4, 0.5),
]
COLUMNS = ("taxon", "growth_form", "mean_diameter_cm", "cover_percent", "height_max_m")
PIXEL, NOISE, GAIN = 0.025, 0.01, Gains(0.1)


def rows_of(taxa):
    """Rows of a species table of 3, 8 or 13 taxa."""
    if taxa == 13:
        return table1_2006().to_dict("records")
    return [dict(zip(COLUMNS, row, strict=True)) for row in EIGHT[:taxa]]


def explicit(number, size, samples):
    """(scene of the table, parameters that are free, plants, image) of a truth of single leaves."""
    what = other_truths.known(number, size)
    truth = other_truths.truth(what, number, samples=samples)
    table = fx.Scene.from_table(
        other_truths.TABLE, size=size, structure=0.05, seed=1000 + number,
        light=what.scene.parameters.light,
    )  # fmt: skip
    foot, diameter, height = (np.concatenate(parts) for parts in zip(*truth.plants, strict=True))
    species = np.repeat(np.arange(len(table.taxa)), [len(p.foot) for p in truth.plants])
    flat = np.zeros(len(foot))
    plants = Instances(
        table.taxa, (size, size), species, *foot.T, flat, flat, flat, diameter, height
    )
    return table, fx.free(table, *FREE_OF_PLANTS), plants, np.asarray(truth.image.reflectance)


def twin(taxa, size, seed, known, covers=False):
    """(scene of the table, parameters that are free, true scene and parameters, its image)."""
    rows, random = rows_of(taxa), np.random.default_rng(seed)
    table = fx.Scene.from_table(rows, size=size, structure=0.05, seed=1000 + seed)
    if covers:
        off = 1.0 + PlacesSettings.cover_sd * np.random.default_rng([seed, 1]).normal(
            size=len(rows)
        )
        rows = [r | {"cover_percent": r["cover_percent"] * max(f, 0.1)} for r, f in zip(rows, off)]
    truth = fx.Scene.from_table(rows, size=size, seed=seed)
    parameters, space = truth.parameters, fx.free(table, *FREE_OF_PLANTS)
    gain = np.ones(4)
    if not known:
        u = random.standard_normal(len(space.names)).clip(-2.0, 2.0)
        values = np.asarray(space.physical(u), np.float32)
        named = dict(zip(space.names, jnp.asarray(values), strict=True))
        parameters = with_values(parameters, truth.taxa, named)
        gain = np.exp(random.multivariate_normal(np.zeros(4), GAIN.covariance(4)))
    image = fx.observe(truth, "mavic_3m", pixel=PIXEL, parameters=parameters).reflectance
    image = np.asarray(image, float) * gain[:, None, None]
    image *= 1.0 + NOISE * random.normal(size=image.shape)
    space = fx.free(table, "ground.brightness") if known else space
    return table, space, truth, parameters, image


def coarse(fine, cell, wide=0.25):
    """Means over cells of `wide` [m]."""
    k = round(wide / cell)
    n = len(fine) // k
    return fine[: n * k, : n * k].reshape(n, k, n, k).mean(axis=(1, 3))


def matched(real, found, size, widest=0.5):
    """Pairs of true and found crowns whose middles are within half a true radius."""
    gap = np.stack([real.x[:, None] - found["x_m"].values, real.y[:, None] - found["y_m"].values])
    gap -= size * np.round(gap / size)
    off = np.hypot(*gap) / (0.5 * real.diameter[:, None])
    ratio = np.abs(np.log(0.01 * found["diameter_cm"].values / real.diameter[:, None]))
    cost = np.where((off < widest) & (ratio < np.log(2.0)), off, 10.0)
    a, b = linear_sum_assignment(cost)
    good = cost[a, b] < 1.0
    return a[good], b[good]


def recognised(table, truth, parameters, image, known):
    """Share of pixels, mostly of one species, that linear discriminants tell the species and the
    growth form of: trained on the table's own scene, whose leaves are the table's, or on the truth
    itself, pixels of which half train."""
    forms, result = np.array(truth.forms), {}
    one = fx.pixel_truth(truth, "mavic_3m", pixel=PIXEL, parameters=parameters)
    other = fx.pixel_truth(table, "mavic_3m", pixel=PIXEL)
    own = np.asarray(fx.observe(table, "mavic_3m", pixel=PIXEL).reflectance, float)

    def pixels(truth, image):
        kind, share = truth.leading()
        clear = share > 0.6
        return np.log(np.maximum(image[:, clear], 1e-3)).T, kind[clear]

    x, y = pixels(one, image)
    for name, (train, label) in {
        "leaves of the table": pixels(other, own), "leaves of the truth": (x[::2], y[::2])
    }.items():  # fmt: skip
        kinds = [k for k in np.unique(label) if np.sum(label == k) > 5]
        mean = np.array([train[label == k].mean(axis=0) for k in kinds])
        within = np.concatenate([train[label == k] - m for k, m in zip(kinds, mean)])
        inverse = np.linalg.inv(np.cov(within.T) + 1e-6 * np.eye(4))
        prior = np.log([np.mean(label == k) for k in kinds])
        score = x @ inverse @ mean.T - 0.5 * np.einsum("ka,ab,kb->k", mean, inverse, mean) + prior
        guess = np.array(kinds)[score.argmax(axis=1)]
        result[name] = np.mean(guess == y), np.mean(forms[guess] == forms[y])
    return result


def run(taxa, size, seed, known, covers, settings):
    """One twin: everything that is asked for, as lines."""
    table, space, truth, parameters, image = twin(taxa, size, seed, known, covers)
    real = hard_instances(truth, parameters)
    search(
        f"{taxa} taxa, {'known' if known else 'off'}", table, space, real, image, PIXEL, settings
    )
    for name_of, (species, form) in recognised(table, truth, parameters, image, known).items():
        print(f"pixels told by {name_of}: species {species:.2f}, form {form:.2f}", flush=True)


def search(what, table, space, real, image, pixel, settings):
    """The plants that are found in an image beside those that stand, as lines."""
    size, seed = table.grid.extent[0], settings.seed - 500
    means, block = blocks_of(image, pixel)
    camera = aim(table, table.parameters, shipped_sensor("mavic_3m"), Placement(pixel=block))
    began, cpu = time.time(), time.process_time()
    found = find_places(table, means, camera, space, settings)
    print(
        f"== {what}, {size:g} m, seed {seed}: "
        f"CPU {(time.process_time() - cpu) / 60:.1f} min, wall {(time.time() - began) / 60:.1f} "
        f"min, {peak_memory() / 2**20:.0f} MiB, misfit {found.misfit:.2f}, together "
        f"{found.together:.1f}, sd {found.pixel_sd.round(3)}"
    )
    cell = 0.025
    cover = projected_cover(real, cell=cell)
    maps = found.maps(cell)
    there, mine = coarse(cover.top >= 0.0, cell), coarse(maps.crown, cell)
    kind = np.append(real.species, -1)[cover.top]
    each = [
        np.corrcoef(coarse(kind == i, cell).ravel(), coarse(maps.species[i], cell).ravel())[0, 1]
        for i in range(len(table.taxa))
        if (kind == i).any() and maps.species[i].any()
    ]
    print(
        f"map of crowns at 25 cm: correlation {np.corrcoef(there.ravel(), mine.ravel())[0, 1]:.2f}"
        f", cover {mine.mean():.2f} of {there.mean():.2f}; of species {np.round(each, 2)}"
    )
    crowns, forms = found.crowns(), np.array(table.forms)
    drawn = hard_instances(table, table.parameters)
    by_table = np.append(drawn.species, -1)[projected_cover(drawn, cell=cell).top]
    seen = np.array([
        [100 * np.mean(np.isin(of, np.flatnonzero(forms == form))) for of in (kind, by_table)]
        + [100 * maps.species[forms == form].sum(axis=0).mean()] for form in dict.fromkeys(forms)
    ])  # fmt: skip
    off = np.abs(seen[:, 1:] - seen[:, :1]).mean(axis=0)
    print(
        f"growth forms seen from above (true, table's planting, found): {seen.round(1).tolist()}; "
        f"found off by {off[1]:.1f} points, the table's planting by {off[0]:.1f}"
    )
    crowns = crowns[crowns["presence"] >= 0.5].reset_index(drop=True)
    name = np.array([table.taxa.index(t) for t in crowns["taxon"]])
    a, b = matched(real, crowns, size)
    random, chance = np.random.default_rng(0), []
    for _ in range(20):
        moved = crowns.assign(x_m=random.random(len(crowns)) * size)
        moved["y_m"] = random.random(len(crowns)) * size
        chance.append(len(matched(real, moved, size)[0]) / len(real))
    for least in (0.4, 0.0):
        wide = real.diameter[a] >= least
        i, j, all_of = a[wide], b[wide], np.sum(real.diameter >= least)
        if not len(i):
            continue
        error = 0.01 * crowns["diameter_cm"].values[j] / real.diameter[i] - 1.0
        tall = crowns["height_m"].values[j] / real.height[i] - 1.0
        inside = [
            np.mean((low[j] <= value[i]) & (value[i] <= high[j]))
            for low, high, value in (
                (crowns["diameter_q05_cm"].values, crowns["diameter_q95_cm"].values,
                 100.0 * real.diameter),
                (crowns["height_q05_m"].values, crowns["height_q95_m"].values, real.height),
            )
        ]  # fmt: skip
        print(
            f"crowns over {100 * least:g} cm: {len(i)} of {all_of} found ({len(i) / all_of:.2f}, "
            f"chance {np.mean(chance):.2f}), diameter {error.mean():+.2f} rms "
            f"{np.sqrt(np.mean(error**2)):.2f}, height {tall.mean():+.2f} rms "
            f"{np.sqrt(np.mean(tall**2)):.2f}, species right "
            f"{np.mean(name[j] == real.species[i]):.2f}"
            f", form right {np.mean(forms[name[j]] == forms[real.species[i]]):.2f}; intervals hold "
            f"{inside[0]:.2f} of diameters, {inside[1]:.2f} of heights"
        )
    print(f"crowns in half the stands or more: {len(crowns)}, true {len(real)}, matched {len(a)}")
    table_of, size2 = found.table(), size**2
    area = np.bincount(real.species, 25.0 * np.pi * real.diameter**2 / size2, len(table.taxa))
    count = real.counts
    held = []
    for _, row in table_of.iterrows():
        which = (
            np.array(table.taxa) == row["name"] if row["level"] == "species"
            else forms == row["name"] if row["level"] == "growth form" else forms == forms
        )  # fmt: skip
        c, n = area[which].sum(), count[which].sum()
        held.append((
            row["level"], row["cover_percent_q05"] <= c <= row["cover_percent_q95"],
            row["plants_q05"] <= n <= row["plants_q95"],
            abs(row["cover_percent"] - c), abs(row["table_cover_percent"] - c), c,
        ))  # fmt: skip
        if row["level"] != "species":
            print(
                f"  {row['name']:16s} cover true {c:5.1f}, "
                f"table {row['table_cover_percent']:5.1f}, "
                f"found {row['cover_percent']:5.1f} ({row['cover_percent_q05']:.1f} to "
                f"{row['cover_percent_q95']:.1f}); plants {n}, table {row['table_plants']:.1f}, "
                f"found {row['plants']:.0f} ({row['plants_q05']:.0f} to {row['plants_q95']:.0f})"
            )
    for level in ("species", "growth form"):
        rows = [h for h in held if h[0] == level]
        print(
            f"{level}: intervals hold {np.mean([h[1] for h in rows]):.2f} of covers, "
            f"{np.mean([h[2] for h in rows]):.2f} of counts; cover off by "
            f"{np.mean([h[3] for h in rows]):.1f} points, the table by "
            f"{np.mean([h[4] for h in rows]):.1f}",
            flush=True,
        )


def main(arguments=None):
    """Find the plants of each twin."""
    parser = options(__doc__)
    parser.add_argument("--size", type=float, default=3.0)
    parser.add_argument("--taxa", type=int, default=8)
    parser.add_argument("--seeds", type=int, nargs="+", default=[1])
    parser.add_argument("--known", action="store_true")
    parser.add_argument("--covers", action="store_true")
    parser.add_argument("--explicit", action="store_true")
    parser.add_argument("--rounds", type=int, default=PlacesSettings.rounds)
    given = parser.parse_args(arguments)
    if given.explicit and (given.known or given.covers or given.taxa != 8):
        parser.error("a truth of single leaves has four taxa, and leaves and covers of its own")
    few = {}
    if given.tiny:
        given.size, given.taxa, given.rounds = 1.0, 3, 2
        few = {"steps": 4, "jumps": 2, "chains": 1}
    for one in given.seeds:
        # Not the truth's own seed, lest the first chain have the shapes of its plants.
        gains = None if given.explicit else GAIN
        settings = PlacesSettings(rounds=given.rounds, gains=gains, seed=500 + one, **few)
        if not given.explicit:
            run(given.taxa, given.size, one, given.known, given.covers, settings)
            continue
        truth = explicit(one, given.size, 2 if given.tiny else 16)
        search("4 taxa, single leaves", *truth, other_truths.PIXEL, settings)


if __name__ == "__main__":
    main()
