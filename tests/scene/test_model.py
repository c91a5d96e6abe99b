"""The scene model: whole plants, common random numbers, conservation, bare ground."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pandas as pd
import pytest

from fynjax._core.errors import InputError
from fynjax.scene import background_spectrum, named_values, with_values
from fynjax.scene._optics import _shoot_optics
from fynjax.scene._spectra import band_wavelengths
from fynjax.sensors import mavic_3m
from fynjax.sensors.air import clear_sky_diffuse_fraction
from tests.scene.plots import TAXA, densities, render, small_parameters, small_plot


def leaf_area(model, parameters):
    """Area on the grid of each class [m2]."""
    return np.asarray(densities(model, parameters)).sum(axis=(1, 2, 3)) * 1e-3


def test_hard_scene_plants_whole_plants_of_equation_10():
    """Rounded up, the wood of deadwood is that of ceil(n) plants of their drawn sizes."""
    parameters = small_parameters()
    model = small_plot(rounding="up")
    species = parameters.species
    radius = np.asarray(species.diameter) / 2
    share = (1 - np.asarray(species.packing)) * np.asarray(species.fill)
    area = np.pi * radius**2 * share
    count = np.ceil(1.6**2 * np.asarray(species.cover) / area).astype(int)
    planting = model.planting
    size = [
        np.asarray(planting.size)[np.asarray(planting.species) == i][: count[i]] for i in range(3)
    ]
    crowns = np.array([np.pi * r**2 * (s**2).sum() for r, s in zip(radius, size, strict=True)])
    # Crowns overlap, and are stated as seen from above: each leaves its part of the ground free.
    each = np.concatenate([np.pi * r**2 * s**2 for r, s in zip(radius, size, strict=True)])
    seen = crowns * (1 - np.prod(1 - each / 1.6**2)) / (crowns.sum() / 1.6**2)
    found = leaf_area(model, parameters)
    assert found[0] == pytest.approx(3.0 * (1 - 0.4) * seen[0], rel=1e-9)
    assert found[-2] == pytest.approx(np.asarray(species.wood_area_index) @ seen, rel=1e-9)


def test_a_shoot_scatters_as_its_leaves_do_among_themselves():
    """Against the series: a photon that a leaf scatters meets the next one with probability p."""
    r, t, p = np.array([[0.05, 0.48, 0.5]]), np.array([[0.03, 0.45, 0.5]]), 0.4
    found = _shoot_optics(jnp.asarray(r), jnp.asarray(t), jnp.array([[p]]))
    out, inside = np.zeros_like(r), np.ones_like(r)
    for _ in range(2000):
        scattered = inside * (r + t)
        out += (1 - p) * scattered
        inside = p * scattered
    np.testing.assert_allclose(found[0] + found[1], out, rtol=1e-12)
    np.testing.assert_allclose(found[0] / found[1], r / t, rtol=1e-12)  # faces keep their shares
    assert float(found[0][0, 2] + found[1][0, 2]) == pytest.approx(1.0)  # nothing absorbs: no loss


def test_clumped_leaves_hide_behind_each_other():
    """The grid holds what is seen from outside the shoots; nothing else moves."""
    parameters = small_parameters()
    share = 1 - parameters.species.shoot_clumping
    sparse = eqx.tree_at(
        lambda p: (p.species.shoot_clumping, p.species.leaf_area_index),
        parameters,
        (jnp.zeros(3), parameters.species.leaf_area_index * share),
    )
    pair = [densities(small_plot(), p) for p in (parameters, sparse)]
    np.testing.assert_allclose(*pair, rtol=1e-12)


def test_moving_one_cover_leaves_the_other_plants_alone():
    model, parameters = small_plot(), small_parameters()
    more = eqx.tree_at(lambda p: p.species.cover, parameters, jnp.array([0.35, 0.15, 0.06]))
    # Crowns that come overlap those that stand, and all give the same share of their area to them.
    before, after = (
        np.asarray(densities(model, p)) / float(model.crown_share(p)) for p in (parameters, more)
    )
    np.testing.assert_allclose(after[1], before[1], rtol=1e-12)  # the restio's culms
    assert after[0].sum() > 1.3 * before[0].sum()
    assert np.all(after[0] >= before[0] - 1e-12)  # the old plants still stand there


def test_area_follows_the_parameters_at_any_resolution():
    parameters = small_parameters()
    areas = [leaf_area(small_plot(voxel=v), parameters) * (v / 0.1) ** 3 for v in (0.05, 0.1, 0.2)]
    cover = np.array([0.25, 0.15, 0.06]) / [0.9 * 0.9, 0.95 * 0.8, 0.98 * 0.95]  # packing and fill
    each = np.pi / 4 * np.asarray(parameters.species.diameter) ** 2 / 1.6**2  # of crowns, at random
    free = np.prod((1 - each) ** (cover / each))
    crowns = 1.6**2 * cover[0] * (1 - free) / cover.sum()  # seen from above
    for area in areas:
        # Sizes vary among plants; leaves of a shoot hide 0.4 of their area from outside.
        assert area[0] == pytest.approx(3.0 * 0.6 * crowns, rel=0.06)
        assert area == pytest.approx(areas[0], rel=1e-5)


def test_a_plot_without_plants_is_the_bare_ground():
    model, parameters = small_plot(), small_parameters()
    bare = eqx.tree_at(lambda p: p.species.cover, parameters, jnp.zeros(3))
    bands = mavic_3m()
    wavelength = band_wavelengths(bands)
    soil, litter, *_ = np.asarray(model.ground_spectra(bare, wavelength))
    share = float(bare.ground.litter_fraction)
    mixed = (1 - share) * soil + share * litter
    ground = np.asarray(bands.weights(wavelength)) @ mixed
    image = np.asarray(render(model, bare))
    np.testing.assert_allclose(
        image, np.broadcast_to(ground[:, None, None], image.shape), rtol=1e-9
    )


def test_names_and_values_are_inverse():
    parameters = small_parameters()
    named = named_values(parameters, TAXA)
    assert "species.Restio eleocharis.leaf.chlorophyll" in named
    changed = with_values(parameters, TAXA, {"species.Restio eleocharis.leaf.chlorophyll": 22.0})
    assert np.asarray(changed.leaf.chlorophyll).tolist() == [55.0, 22.0, 30.0]
    again = named_values(with_values(parameters, TAXA, {}), TAXA)
    assert {k: float(v) for k, v in again.items()} == {k: float(v) for k, v in named.items()}


def test_the_same_seed_draws_the_same_plot():
    first, second, other = small_plot(), small_plot(), small_plot(seed=4)
    assert np.array_equal(first.planting.foot, second.planting.foot)
    assert not np.array_equal(first.planting.foot[:50], other.planting.foot[:50])


def test_a_stride_samples_the_same_image():
    model, parameters = small_plot(), small_parameters()
    whole, part = (np.asarray(render(model, parameters, s)) for s in (1, 4))
    # Angular functions are interpolated over the field of view, which is a little smaller.
    np.testing.assert_allclose(part, whole[:, ::4, ::4], rtol=1e-3)


def test_voxels_that_do_not_divide_the_plot_are_refused():
    with pytest.raises(InputError, match="divide"):
        small_plot(voxel=0.3)


def test_background_spectra_are_reflectances():
    for name in ("dry_soil", "wet_soil", "bark", "litter", "char"):
        values = background_spectrum(name, np.arange(400.0, 2501.0, 10.0))
        assert np.all((values > 0.005) & (values < 0.7))


def test_diffuse_fraction_against_6s(shared_data):
    """Outside gas bands, within 0.03 of the 6S radiative transfer code (AOT 0.1, sun 30 deg)."""
    table = pd.read_csv(
        shared_data / "eco" / "atmosphere" / "sixs_v11_wv2.0_aot0.10_sza30_H3km.csv", comment="#"
    )
    columns = {c.lower(): c for c in table.columns}
    wave = table[next(c for k, c in columns.items() if "wav" in k or k.startswith("wl"))].to_numpy()
    wave = wave * (1000.0 if wave.max() < 100 else 1.0)
    direct = table[next(c for k, c in columns.items() if "dir" in k)].to_numpy()
    diffuse = table[next(c for k, c in columns.items() if "dif" in k)].to_numpy()
    ours = np.asarray(
        clear_sky_diffuse_fraction(jnp.asarray(wave), jnp.asarray(30.0), jnp.asarray(0.1))
    )
    for band in (450, 500, 560, 650, 780, 860, 1020, 1240, 1640):
        near = np.abs(wave - band) < 12
        real = diffuse[near].sum() / (direct[near] + diffuse[near]).sum()
        assert abs(ours[near].mean() - real) < 0.03, band
