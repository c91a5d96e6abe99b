"""Plants found in pixels: weights by slopes, whole stands by jumps, and what is made of them."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.special import gammaln
from scipy.stats import t as student

import fynjax as fx
from fynjax._core.errors import InputError
from fynjax.app.io.plot import Place, write_crowns
from fynjax.inversion import FoundPlants, PlacesSettings, _found, find_places
from fynjax.inversion._found import _together
from fynjax.inversion._places import candidates, descend, free_early, places_model, standing_height
from fynjax.inversion._stands import Jumps, WholeStand
from fynjax.radiation import Illumination, OpticalClasses, VoxelScene
from fynjax.scene import Placement, aim, projected_cover
from fynjax.sensors import Gains, shipped_sensor
from tests.heard import hearing

SIDE = 1.2
ROWS = [
    {"taxon": "Erica irregularis", "growth_form": "rounded_shrub", "mean_diameter_cm": 45,
     "cover_percent": 22, "height_max_m": 0.6},
    {"taxon": "Metalasia muricata", "growth_form": "upright_ericoid", "mean_diameter_cm": 30,
     "cover_percent": 15, "height_max_m": 0.8},
    {"taxon": "Restio eleocharis", "growth_form": "tussock", "mean_diameter_cm": 35,
     "cover_percent": 12, "height_max_m": 0.5},
]  # fmt: skip
SETTINGS = PlacesSettings(steps=50, rounds=6, chains=1, gains=Gains(0.1), seed=4)


def plot(seed, rows=ROWS):
    return fx.Scene.from_table(rows, size=SIDE, structure=0.05, seed=seed)


@pytest.fixture(scope="module")
def twin():
    """(the true scene, the model of the table with its image)."""
    truth, table = plot(1), plot(1001)
    image = np.asarray(fx.observe(truth, "mavic_3m", pixel=0.05).reflectance, float)
    image *= 1.0 + 0.01 * np.random.default_rng(0).normal(size=image.shape)
    image *= np.array([1.05, 0.95, 1.02, 0.98])[:, None, None]
    camera = aim(table, table.parameters, shipped_sensor("mavic_3m"), Placement(pixel=0.05))
    space = fx.free(table, "ground.brightness")
    return truth, places_model(table, image, camera, space, SETTINGS)


def crown_map(instances, cell=0.25):
    """Share of cells of about `cell` under crowns."""
    fine = projected_cover(instances, cell=0.025).top >= 0
    count = round(SIDE / cell)
    k = len(fine) // count
    return fine[: k * count, : k * count].reshape(count, k, count, k).mean(axis=(1, 3))


def test_a_twin_is_found_from_its_pixels(twin):
    """Shapes, turns and leans of its plants are not those of the search."""
    truth, model = twin
    soft = descend(model, model.start(), SETTINGS.steps, free_early(model.space))
    chain = Jumps(model, soft, 3)
    chain.plant()
    chain.render()
    chain.follow(16, 1.0)
    for _ in range(30):
        chain.jump()
    chain.follow(12, 0.6)
    stand = chain.crowns()
    found = FoundPlants(
        plot(1001), [stand], model.space, model.camera, None, None, None, float(model.together)
    ).instances(stand)
    real = fx.scene.hard_instances(truth, truth.parameters)
    there = crown_map(real)
    # Chance: the same crowns, moved as a whole.
    moved = [np.roll(crown_map(found), (i, j), (0, 1)) for i in range(4) for j in range(4)]
    close = [np.corrcoef(there.ravel(), one.ravel())[0, 1] for one in moved]
    assert close[0] > 0.8
    assert close[0] > np.mean(close[1:]) + 3.0 * np.std(close[1:])
    gap = np.stack([real.x[:, None] - found.x, real.y[:, None] - found.y])
    gap -= SIDE * np.round(gap / SIDE)
    near = np.hypot(*gap)
    hit = near.argmin(axis=1)[near.min(axis=1) < 0.25 * real.diameter]
    mine = np.flatnonzero(near.min(axis=1) < 0.25 * real.diameter)
    assert len(mine) >= 0.75 * len(real)
    assert np.mean(found.species[hit] == real.species[mine]) >= 0.75
    assert np.abs(found.diameter[hit] / real.diameter[mine] - 1.0).mean() < 0.2
    # What bands are off by is found too; what all are, the ground's brightness may be.
    factor = np.exp(np.asarray(model.root @ chain.v.band))
    np.testing.assert_allclose(factor / factor.mean(), [1.05, 0.95, 1.02, 0.98], atol=0.03)
    assert chain.misfit < 2.0


def test_pixels_of_known_crowns_are_as_wrong_as_their_shapes_make_them():
    """Crowns are known, lobes and shoots are not."""
    drawn = plot(1)
    stand = fx.scene.hard_instances(drawn, drawn.parameters)
    feet = np.stack([stand.x, stand.y], axis=1)
    crowns = fx.scene.Crowns(stand.species, feet, stand.diameter, stand.height)
    truth, mapped = (drawn.with_plants(crowns, seed=seed) for seed in (21, 22))
    image = fx.observe(truth, "mavic_3m", pixel=0.05).reflectance
    free = fx.free(mapped, "ground.brightness", "species.Erica*.diameter")
    times = []
    for sd in (None, 0.05):
        data = fx.Data.from_pixels(image, pixel=0.05, pixel_sd=sd, gains=Gains(0.1))
        found = fx.fit(mapped, data, free, error="none")
        times.append(found.misfit / found.degrees)
        rows = found.table().set_index("name")
        ground, wide = rows.loc["ground.brightness"], rows.loc["species.Erica irregularis.diameter"]
        assert abs(ground["estimate"] - 1.0) < 3.0 * ground["sd"] or sd is not None
        # Of one plant 7 % by its outline.
        least = 0.07 * wide["estimate"] / np.sqrt(np.sum(stand.species == 0))
        assert (wide["sd"] > 0.95 * least) == (sd is None)
    assert 0.3 < times[0] < 2.0
    assert times[1] > 4.0


def test_weights_of_one_and_none_are_whole_plants(twin):
    _, model = twin
    known, start = model.candidates, model.start()
    chosen = np.array([5, 60, 130])
    weight = np.zeros(len(known.site), np.float32)
    weight[chosen] = 1.0
    moved = dataclasses.replace(start, width=start.width + 0.5, tall=start.tall - 0.5)
    scene = model.stand(moved, jnp.asarray(weight))
    whole = dataclasses.replace(scene, shares=None, planting=scene.planting.only(weight > 0))
    bands = model.camera.sensor.bands
    each = [model.camera.image(s.voxels(s.parameters, bands))[0] for s in (scene, whole)]
    np.testing.assert_allclose(each[0], each[1], rtol=2e-4)
    # A plant in part is as large, and thinner: its outline is there.
    half = model.stand(moved, jnp.asarray(0.5 * weight))
    area = [s.area_density(s.parameters) for s in (half, whole)]
    share = float(half.crown_share(half.parameters) / whole.crown_share(whole.parameters))
    np.testing.assert_allclose(area[0], 0.5 * share * area[1], atol=1e-4)


def test_large_crowns_keep_a_quarter_of_their_area_elements():
    """Of as few as small ones they would be clumpier, and less like what is seen."""
    large = {"taxon": "Euclea racemosa", "growth_form": "broad_leaved", "mean_diameter_cm": 60,
             "cover_percent": 25, "height_max_m": 1.2}  # fmt: skip
    table = plot(3, [large, ROWS[2]])
    own = [int(table.planting.count[table.planting.species == i].max()) for i in (0, 1)]
    known = candidates(table, SETTINGS)
    of_each = np.asarray(known.scene.planting.count)
    of_large, of_small = (of_each[known.species[known.owner] == i].max() for i in (0, 1))
    assert own[0] > 4 * SETTINGS.elements > 4 * of_small
    assert of_large == pytest.approx(own[0] / 4, rel=0.05)


def test_branches_of_a_plant_are_one_crown():
    """Cover over the area of a crown, of however many branches each is (eq. 10 of the article)."""
    of_three = {"branches": 3, "packing_percent": 0, "fill_percent": 100}
    three = candidates(plot(3, [ROWS[0] | of_three]), SETTINGS)
    assert float(three.number[0]) == pytest.approx(0.22 * SIDE**2 / (np.pi / 4 * 0.45**2))
    assert len(three.owner) == 3 * len(three.site)
    few = three.only(np.array([1, 2]))
    assert np.bincount(few.owner)[:2].tolist() == [3, 3]


def test_few_of_the_candidates_are_seen_as_among_all(twin):
    """Image, height, slopes and prior of a stand do not depend on what does not stand; more plants
    take another size once."""
    _, model = twin
    known = model.candidates
    chain = Jumps(model, model.start(), 3)
    standing = np.array([3, 50, 100, len(known.site) - 1])
    chain.stands[chain.site[standing]] = standing
    few, own = chain.places()
    assert few.candidates.species.shape == (chain.most,)
    logit = np.full(len(known.site), -14.0, np.float32)
    logit[standing] = 14.0
    among_all = dataclasses.replace(own, logit=jnp.asarray(logit))

    def seen(model, v):
        image, height = model.image(v, model.weights(v.logit)[0])
        prior = model.prior(v, *model.weights(v.logit))
        return image, height, prior, eqx.filter_grad(lambda v: model.loss(v)[0])(v)

    *one, slope = eqx.filter_jit(seen)(few, own)
    *other, whole = eqx.filter_jit(seen)(model, among_all)
    for a, b in zip(one, other, strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-3, atol=1e-4 * float(jnp.abs(b).max()))
    for name in ("shift", "width", "tall", "u", "band"):
        a, b = getattr(slope, name), getattr(whole, name)
        np.testing.assert_allclose(a, b, atol=2e-3 * float(jnp.abs(b).max()))
    most = chain.most
    chain.stands[:] = -1
    chain.stands[: most + 1] = np.unique(chain.site, return_index=True)[1][: most + 1]
    assert len(chain.places()[1].logit) == most + most // 2


def test_slopes_are_those_of_differences(twin):
    _, model = twin
    random = np.random.default_rng(1)
    draw = lambda x: jnp.asarray(random.normal(size=x.shape), x.dtype)  # noqa: E731
    v = jax.tree.map(lambda x: x + 0.3 * draw(x), model.start())
    tint = jnp.asarray(random.normal(size=model.target.shape), model.target.dtype)

    @jax.jit
    def shown(v, model):
        image, height = model.image(v, model.weights(v.logit)[0])
        return jnp.sum(tint * image) + jnp.sum(height) + model.prior(v, *model.weights(v.logit))

    slope = jax.grad(shown)(v, model)
    for name in ("logit", "shift", "width", "tall", "u", "band"):
        along = jax.tree.map(jnp.zeros_like, v)
        along = dataclasses.replace(along, **{name: draw(getattr(v, name))})
        step = 4e-3
        up, down = (
            float(shown(jax.tree.map(lambda a, b, s=s: a + s * b, v, along), model))
            for s in (step, -step)
        )
        expected = sum(
            float(jnp.vdot(a, b))
            for a, b in zip(jax.tree.leaves(slope), jax.tree.leaves(along), strict=True)
        )
        assert (up - down) / (2.0 * step) == pytest.approx(expected, rel=0.05, abs=0.3), name


@pytest.mark.parametrize("finer", [1, 2])
def test_heights_are_where_a_line_of_sight_meets_what_leaves_show(finer):
    """Of even leaves to a height h the mean over lines is h - (1 - e^-k) h / k, with k what they
    show over the ground: flat ones all of their area, all directions alike half of it."""
    top, area, layers = 1.0, 1.6, 200
    density = np.full((2, layers, 1, 1), area / top)
    density[0], density[1] = 0.75 * density[0], 0.25 * density[1]
    optics = jnp.full((2, 1), 0.1)
    angles = (fx.canopy.leaf_angle("spherical"), fx.canopy.EllipsoidalLeafAngle(1e4))
    structure = None
    if finer > 1:  # half of the cells hold all
        even = np.full((finer * layers, finer, finer), area / top)
        structure = jnp.asarray(even * np.array([[2.0, 0.0], [0.0, 2.0]]))
    voxels = VoxelScene(
        jnp.asarray(density), OpticalClasses(optics, optics, angles, (0, 1)), jnp.zeros(1),
        Illumination(jnp.zeros(()), jnp.zeros(()), jnp.ones(1), jnp.zeros(1)), 0.5, top / layers,
        structure=structure,
    )  # fmt: skip
    shown = area * (0.75 * 0.5 + 0.25 * 1.0) * finer
    expected = (top - top * (1.0 - np.exp(-shown)) / shown) / finer
    assert float(standing_height(voxels)[0, 0]) == pytest.approx(expected, rel=5e-3)


def test_each_chain_has_its_own_start_and_shapes_at_the_same_sites(twin):
    model = twin[1]
    first, second = (candidates(plot(7), SETTINGS, chain) for chain in (0, 1))
    np.testing.assert_array_equal(first.place, second.place)
    np.testing.assert_array_equal(first.scene.planting.species, second.scene.planting.species)
    turned = [np.asarray(known.scene.planting.azimuth) for known in (first, second)]
    assert np.mean(turned[0] != turned[1]) > 0.9
    starts = [model.start(chain) for chain in (0, 1, 2)]
    assert not np.any(starts[0].u)
    assert all(np.all(np.abs(start.band) <= 2.0) for start in starts)
    assert len({float(start.band[0]) for start in starts}) == 3


def test_a_search_takes_a_start_and_shapes_of_its_own_for_each_chain(twin, monkeypatch):
    model, begun = twin[1], []

    def recorded(model, v, *args, **options):
        begun.append((model.candidates.scene.planting.azimuth, v.band))
        return v

    settings = dataclasses.replace(SETTINGS, chains=2, rounds=2, jumps=1)
    monkeypatch.setattr(_found, "descend", recorded)
    with hearing() as heard:
        found = find_places(plot(1001), model.target, model.camera, model.space, settings)
    assert [stand.chain for stand in found.stands] == [0, 1]
    (one, first), (other, second) = begun
    assert np.mean(np.asarray(one) != np.asarray(other)) > 0.9
    assert not np.any(first)
    assert np.all(second != 0.0)
    assert heard.count == 4  # rounds


def unseen(twin, rows=ROWS):
    """A model without pixels: the table alone speaks."""
    model = twin[1]
    known = candidates(plot(7, rows), SETTINGS)
    return dataclasses.replace(model, candidates=known)


def test_without_pixels_the_table_is_what_is_found(twin):
    """At the table's weights the slopes of prior and entropy are those of its numbers alone."""
    model = crowded(unseen(twin))
    v = model.start()
    number = np.bincount(model.candidates.species, model.weights(v.logit)[0], 3)
    np.testing.assert_allclose(number, model.candidates.number, rtol=0.1)

    def cost(v):
        parts = model.weights(v.logit)
        return float(model.prior(v, *parts) + sum(jnp.sum(w * jnp.log(w + 1e-9)) for w in parts))

    # Twice the plants of a species cost more than chance says of so many sites.
    more = dataclasses.replace(v, logit=v.logit + jnp.log(2.0) * (model.candidates.species == 1))
    fewer = dataclasses.replace(v, logit=v.logit - 9.0 * (model.candidates.species == 1))
    assert cost(more) > cost(v) + 1.0
    assert cost(fewer) > cost(v) + 1.0


class Blind(Jumps):
    """Jumps that see nothing."""

    def render(self):
        self.image = np.zeros(self.model.target.shape)
        self.pixels, self.heights = np.zeros(self.image.shape[1:]), np.zeros((1, 1))


def test_jumps_without_pixels_draw_from_the_prior(twin):
    """Numbers of plants, sizes and places as the prior has them, whatever proposals prefer."""
    model = unseen(twin, [ROWS[0] | {"cover_percent": 66}])
    # Covers may be what they will: then plants stand by the chance of each site.
    model = dataclasses.replace(
        crowded(model), settings=dataclasses.replace(SETTINGS, cover_sd=1e6)
    )
    soft = model.start()
    random = np.random.default_rng(5)
    bent = {n: getattr(soft, n) + 1.0 for n in ("width", "tall")}
    lean = soft.logit + jnp.asarray(random.normal(size=soft.logit.shape), soft.logit.dtype)
    chain = Blind(model, dataclasses.replace(soft, logit=lean, **bent), 11)
    chain.render()
    counts, widths = [], []
    for turn in range(20_000):
        chain.jump()
        if turn > 1000 and turn % 5 == 0:
            at = np.flatnonzero(chain.stands >= 0)
            counts.append(len(at))
            widths.append(chain.of["width"][at])
    n, sites = np.arange(len(chain.site) + 1), len(chain.site)
    log = gammaln(sites + 1) - gammaln(n + 1) - gammaln(sites - n + 1) + n * chain.odds[0]
    chance = np.exp(log - log.max())
    expected = n @ chance / chance.sum()
    spread = np.sqrt((n - expected) ** 2 @ chance / chance.sum())
    assert np.mean(counts) == pytest.approx(expected, abs=0.15 * spread + 0.05)
    assert np.std(counts) == pytest.approx(spread, rel=0.15)
    every = np.concatenate(widths)
    assert np.mean(every) == pytest.approx(0.0, abs=0.15)
    assert np.std(every) == pytest.approx(1.0, rel=0.1)


def test_jumps_have_the_prior_of_the_search_by_slopes(twin):
    """Covers, sites, sizes, and the distance that plants keep."""
    model = unseen(twin)
    random = np.random.default_rng(2)
    soft = model.start()
    chain = Blind(model, dataclasses.replace(soft, width=soft.width + 0.3), 1)
    ends = np.flatnonzero(np.r_[True, np.diff(np.sort(chain.site)) > 0])
    first = np.argsort(chain.site, kind="stable")[ends]
    cost, density = [], []
    for count in (3, 6, 6):
        chain.stands[:] = -1
        chosen = random.choice(chain.sites, count, replace=False)
        chain.stands[chosen] = first[chosen]
        for value in chain.of.values():
            value[chosen] = random.normal(size=value[chosen].shape)
            value[chain.stands < 0] = 0.0
        few, v = chain.places()
        cost.append(float(few.prior(v, *few.weights(v.logit))))
        near = chain._feet_now(chosen)[:, None] - chain._feet_now(chosen)
        close = np.maximum(1.0 - np.hypot(*np.moveaxis(chain._gap(near), -1, 0)) / chain.apart, 0)
        # A pair of those that change counts from both sides, but once in the density of all.
        density.append(chain._prior(list(chosen)) + 10.0 * np.triu(close, 1).sum())
    np.testing.assert_allclose(np.diff(density), -np.diff(cost), rtol=2e-3, atol=0.05)


def crowded(model):
    """The model with plants that may stand at one place."""
    known = dataclasses.replace(model.candidates, apart=jnp.asarray(1e-6))
    return dataclasses.replace(model, candidates=known)


def stand(*plants):
    """A stand of (species, x, y, diameter)."""
    kind, x, y, d = np.array(plants, float).reshape(-1, 4).T
    none = np.zeros(0)
    return WholeStand(
        kind.astype(int), np.arange(len(kind)), np.stack([x, y], 1), d, 2.0 * d, none, none, 1.0
    )


def test_crowns_of_stands_that_are_one_plant_are_counted_as_one():
    found = FoundPlants(
        plot(3),
        [
            stand((0, 0.02, 0.6, 0.5), (1, 0.6, 0.3, 0.2)),
            stand((0, 1.14, 0.6, 0.6), (2, 0.6, 0.3, 0.22)),
            stand((0, 1.16, 0.6, 0.4), (2, 0.61, 0.3, 0.2), (1, 0.3, 1.0, 0.1)),
            stand((0, 0.0, 0.6, 0.5), (2, 0.6, 0.32, 0.2)),
        ],
        None, None, None, None, None, 1.0,
    )  # fmt: skip
    rows = found.crowns()
    assert list(rows["presence"]) == [1.0, 1.0, 0.25]
    assert list(rows["taxon"]) == ["Erica irregularis", "Restio eleocharis", "Metalasia muricata"]
    assert rows["p_Restio eleocharis"][1] == 0.75
    assert rows["taxon_probability"][1] == 0.75
    # Over the edge of a plot that repeats itself.
    assert rows["x_m"][0] == pytest.approx(SIDE - 0.02, abs=1e-6)
    assert rows["x_m"].between(0.0, SIDE).all()
    assert rows["diameter_cm"][0] == pytest.approx(50.0)
    table = found.table().set_index("name")
    assert table.loc["Erica irregularis", "plants"] == 1.0
    assert table.loc["all", "plants_q95"] > 2.5
    assert table.loc["Erica irregularis", "cover_percent"] == pytest.approx(
        100 * np.pi / 4 * np.quantile([0.25, 0.36, 0.16, 0.25], 0.5) / SIDE**2
    )
    assert table.loc["tussock", "cover_percent"] == table.loc["Restio eleocharis", "cover_percent"]
    maps = found.maps(cell=0.05)
    assert maps.crown[12, 0] == 1.0
    assert maps.species[2][6, 12] == 0.75
    kind, doubt = maps.likeliest
    assert (kind[6, 12], doubt[6, 12]) == (2, 0.25)
    assert kind[0, 0] == -1
    np.testing.assert_allclose(maps.height[1, 12, 0], 1.0)


def test_intervals_of_few_chains_hold_what_chains_differ_by():
    """Chains that differ by more than their own stands: the table's intervals hold nine of ten
    covers drawn as the chains are, which quantiles of all stands do not; one chain has these."""
    random, held, scene = np.random.default_rng(4), [], plot(3)
    for _ in range(300):
        mean = 40.0 + 3.0 * random.normal(size=4)  # of the truth, and of three chains
        values = mean[:, None] + random.normal(size=(4, 12))
        stands = [
            stand((0, 0.6, 0.6, np.sqrt(0.04 * value / np.pi) * SIDE))._replace(chain=k)
            for k, chain in enumerate(values[1:])
            for value in chain
        ]
        own = FoundPlants(scene, stands, None, None, None, None, None, 1.0)
        row = own.table().iloc[-1]
        low, high = np.quantile(values[1:], (0.05, 0.95))
        truth = values[0, 0]
        held.append(
            (row["cover_percent_q05"] < truth < row["cover_percent_q95"], low < truth < high)
        )
    good, plain = np.mean(held, axis=0)
    assert 0.86 < good < 0.95
    assert plain < 0.8
    one = dataclasses.replace(own, stands=[s._replace(chain=0) for s in stands])
    assert one.table().iloc[-1]["cover_percent_q95"] == pytest.approx(high)
    assert one.table().iloc[-1]["plants_q05"] == 1.0


def test_a_crown_of_uneven_chains_has_the_mean_of_chains():
    """One stand of a chain counts as its whole chain does; by hand (Rubin 1987, eq. 3.1.6)."""
    wide = (0.5, 0.52, 0.54, 0.6)
    stands = [
        stand((0, 0.6, 0.6, d))._replace(chain=k) for d, k in zip(wide, (0, 0, 0, 1), strict=True)
    ]
    row = FoundPlants(plot(3), stands, None, None, None, None, None, 1.0).crowns().iloc[0]
    within, between = 3 * np.var(wide[:3]) / 2, 1.5 * np.var([0.52, 0.6], ddof=1)
    half = student.ppf(0.95, (1 + within / between) ** 2) * np.sqrt(within + between)
    assert row["diameter_cm"] == pytest.approx(56.0)
    assert row["diameter_q95_cm"] == pytest.approx(100 * (0.56 + half))
    assert row["diameter_q05_cm"] == pytest.approx(100 * (0.56 - half))


def test_where_nothing_stands_the_tables_are_empty(tmp_path):
    found = FoundPlants(plot(3), [stand()] * 3, None, None, None, None, None, 1.0)
    rows = found.crowns()
    assert (len(rows), rows["presence"].dtype, rows["x_m"].dtype) == (0, float, float)
    write_crowns(tmp_path / "crowns.gpkg", rows, Place())
    assert found.table().set_index("name").loc["all", "plants"] == 0.0
    assert not found.maps(cell=0.1).crown.any()


def test_stands_without_a_plant_in_common_stay_apart():
    foot = np.array([[0.2, 0.2], [0.2, 0.5], [0.25, 0.2]])
    groups = _together(foot, np.array([0.3, 0.3, 0.3]), np.array([0, 1, 2]), np.full(2, np.inf))
    assert sorted(map(len, groups)) == [1, 2]
    # Nor are two of one stand one plant, however near.
    groups = _together(foot, np.array([0.3, 0.3, 0.3]), np.array([0, 1, 0]), np.full(2, np.inf))
    assert sorted(map(len, groups)) == [1, 1, 1]


def test_images_and_settings_that_do_not_fit_are_refused(twin):
    _, model = twin
    scene, image = plot(2), fx.observe(plot(1), "mavic_3m", pixel=0.1)
    with pytest.raises(InputError, match="must be positive"):
        PlacesSettings(steps=0)
    with pytest.raises(InputError, match="the whole plot and nothing else, 2 m x 2 m"):
        fx.find_plants(fx.Scene.from_table(ROWS, size=2.0, structure=0.1), image)
    with pytest.raises(InputError, match="expected bands of"):
        fx.find_plants(scene, dataclasses.replace(image, bands=tuple("abcd")))
    with pytest.raises(InputError, match="expected heights of 12 x 12"):
        places_model(
            scene, np.asarray(model.target), model.camera, model.space, SETTINGS,
            height=np.zeros((3, 3)),
        )  # fmt: skip
    with pytest.raises(InputError, match="no block of the image"):
        places_model(
            scene, np.full(model.target.shape, np.nan), model.camera, model.space, SETTINGS
        )
    bare = [row | {"cover_percent": 0} for row in ROWS]
    with pytest.raises(InputError, match="no plant to be found"):
        candidates(plot(1, bare), SETTINGS)
