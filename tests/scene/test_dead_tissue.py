"""Dead tissue in live shoots: what it is mixed of, its limits, its energy and its spectrum; and the
sizes of leaves."""

import dataclasses

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

from fynjax._core.errors import InputError
from fynjax.leaf import prospect
from fynjax.radiation import fluxes, solve_light
from fynjax.scene import Species, Spectrum, background_spectrum
from fynjax.scene._optics import _shoot_optics, optical_classes
from fynjax.sensors import mavic_3m
from tests.helpers import assert_gradients
from tests.scene.plots import EXACT, FORMS, small_parameters, small_plot

WAVE = np.array([450.0, 670.0, 860.0, 1650.0, 2200.0])
BARK = background_spectrum("bark", WAVE)
SPECIES = [Species(form, form) for form in FORMS]


def with_dead(*fraction):
    parameters = small_parameters()
    return eqx.tree_at(lambda p: p.species.dead_fraction, parameters, jnp.array(fraction))


def spectra(parameters, tissue=BARK):
    classes = optical_classes(SPECIES, parameters, jnp.eye(len(WAVE)), WAVE, tissue)
    return np.asarray(classes.reflectance), np.asarray(classes.transmittance)


def test_live_shoots_are_leaves_and_all_dead_ones_bark():
    parameters = with_dead(0.0, 1.0, 0.0)
    reflectance, transmittance = spectra(parameters)
    leaf = prospect(dataclasses.replace(parameters.leaf, **{
        f.name: getattr(parameters.leaf, f.name)[0] for f in dataclasses.fields(parameters.leaf)
    }), WAVE)  # fmt: skip
    clumping = parameters.species.shoot_clumping[:, None]
    alive = _shoot_optics(leaf.reflectance[None], leaf.transmittance[None], clumping[:1])
    np.testing.assert_allclose(reflectance[0], alive[0][0], rtol=1e-12)
    np.testing.assert_allclose(transmittance[0], alive[1][0], rtol=1e-12)
    bark = np.clip(0.9 * BARK, 0, 1)  # `wood_brightness`
    np.testing.assert_allclose(reflectance[1], bark * 0.8 / (1 - 0.2 * bark), rtol=1e-12)
    np.testing.assert_allclose(transmittance[1], 0.0, atol=1e-15)
    np.testing.assert_allclose(reflectance[2], bark, rtol=1e-12)  # wood itself


def test_half_dead_shoots_scatter_what_both_halves_do():
    """Single scattering by area, then among themselves: by the closed form of the shoot."""
    (live, through), (half, less) = (spectra(with_dead(f, 0.0, 0.0)) for f in (0.0, 0.5))
    p = 0.4

    def alone(albedo):
        return albedo / (1 - p + p * albedo)

    bark = 0.9 * BARK
    mixed = 0.5 * alone(live[0] + through[0]) + 0.5 * bark
    np.testing.assert_allclose(half[0] + less[0], (1 - p) * mixed / (1 - p * mixed), rtol=1e-12)
    np.testing.assert_allclose(half[1], live[1], rtol=1e-12)  # the other species


def test_optics_have_derivatives_in_the_dead_fraction():
    average = jnp.eye(len(WAVE))

    @eqx.filter_jit
    def optics(values):
        parameters = with_dead(0.3, 0.45, 0.0)
        species = dataclasses.replace(
            parameters.species,
            dead_fraction=values[:3],
            shoot_clumping=jnp.append(values[3:5], 0.0),
        )
        ground = dataclasses.replace(parameters.ground, wood_brightness=values[5])
        plot = dataclasses.replace(parameters, species=species, ground=ground)
        classes = optical_classes(SPECIES, plot, average, WAVE, BARK)
        return jnp.stack([classes.reflectance[:2], classes.transmittance[:2]])

    assert_gradients(optics, jnp.array([0.3, 0.45, 0.0, 0.4, 0.2, 0.9]), rtol=1e-5)


def test_no_light_is_lost_where_shoots_are_partly_dead():
    model = small_plot()

    @eqx.filter_jit
    def shares(parameters):
        return fluxes(solve_light(model.voxels(parameters, mavic_3m()), EXACT))

    for fraction in ((0.0, 0.0, 0.0), (0.6, 0.9, 0.0)):
        share = shares(with_dead(*fraction))
        total = share.albedo + share.absorbed.sum(axis=1) + share.ground_absorbed
        np.testing.assert_allclose(total, 1.0, atol=1e-5)


def test_a_spectrum_of_the_user_must_cover_the_bands():
    grey = Spectrum.of(np.array([400.0, 700.0]), np.array([0.3, 0.3]), "a dead tissue spectrum")
    model = small_plot(dead_tissue=grey)
    with pytest.raises(InputError, match="dead tissue spectrum must cover"):
        model.voxels(small_parameters(), mavic_3m())
    wide = Spectrum.of(np.array([400.0, 2500.0]), np.array([0.3, 0.3]), "a dead tissue spectrum")
    model = small_plot(dead_tissue=wide)
    given = model.voxels(with_dead(1.0, 1.0, 0.0), mavic_3m()).classes.reflectance
    np.testing.assert_allclose(given[1], 0.27 * 0.8 / (1 - 0.2 * 0.27), rtol=1e-9)


@pytest.mark.parametrize(
    ("wavelength", "values", "text"),
    [
        ([2500.0, 400.0], [0.1, 0.3], "wavelengths that do not rise"),
        ([400.0, 2500.0], [0.1, 0.2, 0.3], "3 values for 2 wavelengths"),
        ([400.0, 2500.0], [0.1, np.nan], "finite numbers"),
    ],
)
def test_a_spectrum_is_one_number_at_each_rising_wavelength(wavelength, values, text):
    with pytest.raises(InputError, match=text):
        Spectrum.of(np.array(wavelength), np.array(values), "dead tissue")


def test_leaves_have_the_size_of_their_form_where_a_hot_spot_is_asked_for():
    plain, sized = (
        small_plot(hot_spot=asked).voxels(small_parameters(), mavic_3m()).classes
        for asked in (False, True)
    )
    assert plain.leaf_diameter is None
    diameters = np.asarray(sized.leaf_diameter)[list(sized.sizes)]
    np.testing.assert_allclose(diameters, [0.004, 0.0024, 0.005, 0.005])  # dome, tussock; the rest
    np.testing.assert_allclose(sized.reflectance, plain.reflectance)
