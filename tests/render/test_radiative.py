"""Pictures by radiative transfer: against the exact solver, pixel by pixel and light by light."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import irisjax as ij
from common import slowly
from irisjax.measure.colour import illuminant_power
from irisjax.render.albedo import Matt, lambert_error
from irisjax.render.bands import spectral_bands
from irisjax.render.camera import Camera
from irisjax.render.illumination import Illumination
from irisjax.render.integrator import solve_response
from irisjax.render.integrators import INTEGRATORS, integrator_name
from irisjax.render.lights import Lights
from irisjax.render.picture import draw
from irisjax.render.project import project
from irisjax.render.radiative import RadiativeIntegrator
from irisjax.render.shading import camera_share, flux_at, incident_flux
from irisjax.tissue.maps import IrisMaps, Scales
from irisjax.tissue.pigments import extinction
from render.small_scenes import BARE, CLOSE, LIGHT, scene

X = np.array([430.0, 550.0, 650.0])
INDEX = BARE.aqueous_index
EXACT = ij.RadiativeExact(16, 8, 1)
# One structure for all tables of this file: irides whose ABL is up to four times as dark, and whose
# stroma is a half to double. One program.
RANGES = Scales(abl=jnp.array([0.2, 4.0]), stroma=jnp.array([0.5, 2.0]))


def even(iris=LIGHT):
    """Maps that leave an iris as it is, where both layers may vary."""
    layers = {"abl_depth": iris.abl_thickness, "stroma_depth": iris.stroma_thickness}
    return IrisMaps(**{name: jnp.full((4, 3), depth) for name, depth in layers.items()})


@jax.jit
def solved(layers, incidence, exits, azimuths):
    return EXACT.solve(layers, ij.Light(incidence, ij.Directions(exits, azimuths)))


def number(value):
    """A number or numbers as `solved` is compiled for."""
    return jnp.asarray(value, float)


@jax.jit
def scaled(iris, abl=1.0, stroma=1.0, scattering=1.0):
    """Layers of an iris, ABL and stroma so many times as deep, the stroma's albedo as given."""
    found = iris.layers(extinction(X), INDEX)
    whole, albedo = found.extinction * stroma, found.albedo * scattering
    depths = found.abl_absorption * abl, whole * (1 - albedo), whole * albedo
    return ij.Layers(*depths, indices=found.indices, order=found.order)


@pytest.fixture(scope="module")
def response():
    integrator, bands = RadiativeIntegrator(), spectral_bands(X, "E")
    made = integrator.prepare(LIGHT, INDEX, bands, RANGES)
    solve_response(made, LIGHT, INDEX, bands, RANGES)  # compiled
    return lambda iris: solve_response(made, iris, INDEX, bands, RANGES)


brdf_of = eqx.filter_jit(lambda response, *directions: response.brdf(*directions))


@pytest.mark.parametrize("level", ["low", "high"])
def test_brdf_of_texels_is_the_exact_solver_s(response, level):
    """To 1 % out to 75°, at three incidences; of texels much darker than others the error is one of
    the brightest.
    """
    iris = ij.Iris.of_level(level)
    found = response(iris)
    assert float(found.error) < 4e-3
    exits, azimuths = np.cos(np.radians([0.0, 30.0, 55.0, 75.0])), np.array([0.3, 1.7, 2.9, 0.0])
    pairs = jnp.asarray(exits), jnp.asarray(azimuths)
    brightest = 0.0
    for abl, stroma in ((0.2, 2.0), (1.0, 1.0), (3.5, 0.6)):
        for incidence in np.cos(np.radians([0.0, 40.0, 70.0])):
            true = solved(scaled(iris, abl, stroma), number(incidence), *pairs).brdf
            brightest = max(brightest, float(true.max()))
            scales = Scales(number([abl] * 4), number([stroma] * 4))
            given = brdf_of(found, scales, number([incidence] * 4), *pairs)
            np.testing.assert_allclose(given, true, atol=2 * float(found.error) * brightest)
            if abl <= 1:
                np.testing.assert_allclose(given, true, rtol=1e-2)


@pytest.mark.parametrize("eye", [BARE, slowly(CLOSE)], ids=["bare", "cornea"])
def test_each_pixel_is_its_brdf_times_its_light(eye):
    """Two lights, a camera off the axis: every pixel's directions by themselves."""
    lights = Lights.distant(0.4, 1.0, 2.0) + Lights.distant(0.9, -2.0, 3.0)
    camera = Camera(polar=0.5, azimuth=0.3, size=(6, 4), width=10.0)
    parts = {"eye": eye, "camera": camera, "integrator": RadiativeIntegrator()}
    given = draw(scene(lights=lights, maps=even(), wavelengths=tuple(X.tolist()), **parts))
    seen = project(eye, camera).iris
    normal = np.asarray(eye.iris_normal(jnp.stack(seen.point, -1)))
    view = -np.stack(seen.direction, -1)
    expected = np.zeros((24, 3))
    if eye is CLOSE:
        # Refraction at a cornea bends light and lines of sight: the integrator's own field.
        tables = Illumination.build(eye, caustics=False)
        field = incident_flux(lights, eye, tables)
        fluxes = [np.asarray(flux_at(f, eye.iris_radius, seen.point)).T for f in field]
    else:
        fluxes = [
            -np.outer(np.ones(24), np.asarray(towards) * float(power))
            for towards, power in zip(lights.towards, lights.irradiance, strict=True)
        ]
    share, layers = np.asarray(camera_share(seen, eye)), scaled(LIGHT)
    for pixel in np.flatnonzero(share > 0):
        n, out = normal[pixel], view[pixel]
        for flux in fluxes:
            power = np.linalg.norm(flux[pixel])
            towards = flux[pixel] / max(power, 1e-300)
            incidence = -towards @ n
            if incidence <= 0:
                continue
            along = towards + incidence * n, out - (out @ n) * n
            lengths = np.linalg.norm(along[0]) * np.linalg.norm(along[1])
            azimuth = np.arccos(np.clip(along[0] @ along[1] / lengths, -1, 1))
            parts = (jnp.asarray(v) for v in (incidence, [out @ n] * 4, [azimuth] * 4))
            value = np.asarray(solved(layers, *parts).brdf)[:, 0]
            expected[pixel] += value * incidence * power * share[pixel]
    expected = expected * illuminant_power("D65", X)
    lit = expected.max(1) > 0
    assert lit.sum() > 6
    found = np.asarray(given).reshape(24, 3)
    np.testing.assert_allclose(found[lit], expected[lit], atol=3e-3 * expected.max())


@pytest.mark.slow  # a minute and a half of compiling
def test_traced_pictures_are_the_others():
    """Kept mixtures of directions or all of them; and a derivative by the light's direction."""

    def picture(polar):
        lights = Lights.distant(polar, 0.7, 2.0)
        return draw(
            scene(
                lights=lights,
                integrator=RadiativeIntegrator(degrees=(2, 2, 2, 2), angular=(2, 1, 1)),
            )
        )

    plain, traced = picture(0.6), jax.jit(picture)(0.6)
    np.testing.assert_allclose(plain, traced, atol=5e-4 * float(traced.max()))
    mean = jax.jit(lambda polar: picture(polar).mean())  # all that is wanted for a derivative
    slope = jax.jit(jax.grad(mean))(0.6)
    difference = (mean(0.6 + 1e-4) - mean(0.6 - 1e-4)) / 2e-4
    assert abs(float(slope)) > 1e-4
    assert float(slope) == pytest.approx(float(difference), rel=1e-4)


def test_layers_beyond_the_table_are_solved_exactly_or_refused():
    bands, deep = spectral_bands(X, "E"), Scales(stroma=(0.5, 40.0))
    thick = LIGHT.replace(scattering_scale=300.0)
    made = RadiativeIntegrator().prepare(thick, INDEX, bands, deep)
    assert isinstance(made.solver, ij.RadiativeExact)
    table = RadiativeIntegrator().prepare(LIGHT, INDEX, bands, Scales()).solver
    assert isinstance(table, ij.RadiativeTabulated)
    other = RadiativeIntegrator().prepare(LIGHT, jnp.asarray(1.376), bands, Scales()).solver
    assert isinstance(other, ij.RadiativeExact)
    with pytest.raises(ValueError, match="outside the range"):
        solve_response(RadiativeIntegrator(solver=table), thick, INDEX, bands, RANGES)


@pytest.fixture(scope="module")
def matt():
    return Matt.build(LIGHT, even(), BARE, spectral_bands(X, "E"), RadiativeIntegrator())


@eqx.filter_jit
def hemispherical(response, incidence):
    return response.hemispherical(Scales(jnp.ones(1), jnp.ones(1)), incidence)


def test_the_matt_iris_of_the_hand_over(matt):
    """Albedo and BRDF as the exact solver has them. What leaves in all directions is the
    reflectance, but for light that is never scattered.
    """
    one, turn = number([0.9] * 4), number([0.5] * 4)
    for incidence in (0.4, 1.0):
        whole, clear = (
            solved(scaled(LIGHT, scattering=s), number(incidence), one, turn) for s in (1.0, 0.0)
        )
        albedo = np.asarray(whole.reflectance - clear.reflectance)
        found = hemispherical(matt.response, number(incidence))[:, 0]
        np.testing.assert_allclose(found, albedo, rtol=2e-3 if incidence == 1 else 3e-3)
    np.testing.assert_allclose(matt.albedo()[0, 0], found, rtol=1e-12)
    true = solved(scaled(LIGHT), number(0.6), one, turn).brdf
    found = matt.brdf(jnp.asarray([0.6]), one[:1], turn[:1])
    np.testing.assert_allclose(found[0, 0, 0], np.asarray(true)[:, 0], rtol=3e-3)


def test_the_matt_iris_errs_by_as_much_as_it_says(matt):
    whole = solved(scaled(LIGHT), number(1.0), number([0.9] * 4), number([0.5] * 4))
    ratio = matt.albedo()[0, 0] / np.pi / np.asarray(whole.brdf)[:, 0] - 1
    error = matt.error()
    assert (np.abs(error.most) >= 0.99 * np.abs(ratio)).all()
    assert (error.rms < np.abs(error.most)).all() and (error.rms > 0.02).all()


def test_distance_from_lamberts_law():
    """Of a BRDF that is everywhere a tenth brighter, or brighter and darker by turns."""
    flat, weight = np.full((3, 2), 0.01), np.array([0.25, 0.75])
    share = np.array([0.4, 0.6])
    brighter = np.full((2, 2, 3, 3, 2), 0.011)
    found = lambert_error(flat, weight, (brighter, share), (brighter, share), brighter)
    np.testing.assert_allclose(found.rms, 1 - 1 / 1.1)
    np.testing.assert_allclose(found.most, 1 / 1.1 - 1)
    np.testing.assert_allclose(found.texels, 1 - 1 / 1.1)
    np.testing.assert_allclose(found.hemisphere, 0.1 / 1.1)
    turns = brighter.copy()
    turns[0] = 0.009
    found = lambert_error(flat, weight, (brighter, share), (turns, share), brighter)
    np.testing.assert_allclose(found.hemisphere, 0.1 / (0.4 * 0.9 + 0.6 * 1.1))


def test_integrators_by_name():
    for name, kind in INTEGRATORS.items():
        assert integrator_name(kind()) == name
