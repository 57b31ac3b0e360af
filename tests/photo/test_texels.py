"""Every texel its own pigments: what a picture was drawn with comes back from its colours."""

import dataclasses
import functools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import ndimage
from window_scenes import BARE, CAMERA, EYE, LIGHTS, SHAPE, picture_of, view
from window_scenes import BASE as USUAL

from irisjax.photo.clone import usual_iris
from irisjax.photo.light import find_veil
from irisjax.photo.photograph import Ellipse
from irisjax.photo.texels import (
    FACTORS,
    PROCESS_DOUBT,
    colour_iris,
    factors_within_table,
    moved_iris,
    solve_coarse,
)
from irisjax.photo.texture import Refraction
from irisjax.render.camera import Camera
from irisjax.render.environment import Environment
from irisjax.render.picture import surroundings, texture, within_gamut
from irisjax.render.project import scatter_to_picture
from irisjax.render.radiative import RadiativeIntegrator
from irisjax.render.scene import Scene
from irisjax.render.separable import Separable
from irisjax.tissue.maps import IrisMaps, Scales, texel_layers
from irisjax.tissue.pigments import extinction
from irisjax.transport.defaults import quickest
from irisjax.transport.ilit.exact import IlitExact
from irisjax.transport.process import DEPTH_RESOLVED

# As fitted irides are, so that all pictures share a program.
BASE = USUAL.replace(pheomelanin_abl_fraction=USUAL.abl_fraction)
INTEGRATOR = Separable(degrees=(2, 6, 6, 6, 2), solver=IlitExact(6))
EXPOSURE = np.array([1.4, 1.3, 1.2])
ANGLES, RADII = 96, 16


def scene_with(maps: IrisMaps | None) -> Scene:
    return Scene(BASE, maps, BARE, LIGHTS, camera=CAMERA, integrator=INTEGRATOR)


def two_colours() -> IrisMaps:
    """A ring of pheomelanin about the pupil, and fibres of the stroma's thickness."""
    angle = np.arange(ANGLES)[:, None] * (2 * np.pi / ANGLES)
    ring = np.broadcast_to(np.arange(RADII) < 7, (ANGLES, RADII))
    depth = 0.4 * np.exp(0.4 * np.sin(6 * angle)) * np.ones((1, RADII))
    melanins = np.where(ring, 0.5, 1.5), np.where(ring, 6.0, 1.0)
    stroma, eumelanin, pheomelanin = (jnp.asarray(m, jnp.float32) for m in (depth, *melanins))
    return IrisMaps(stroma_depth=stroma, eumelanin=eumelanin, pheomelanin=pheomelanin)


def cells_of(shape) -> Refraction:
    """No cornea refracts: the camera projects along straight lines."""
    angle, out = ((np.arange(n) + 0.5) / n for n in shape)
    pupil, root = float(BARE.pupil_radius), float(BARE.iris_radius)
    radius, angle = pupil + (root - pupil) * out, 2 * np.pi * angle[:, None]
    places = radius * np.cos(angle), radius * np.sin(angle), np.full(shape, BARE.iris_depth)
    column_row = eqx.filter_jit(Camera.pixel)(CAMERA, np.stack(places, -1), BARE)
    return Refraction(*(np.asarray(c, np.float32) for c in column_row), np.ones(shape, bool))


def draw(scene) -> np.ndarray:
    return picture_of(view(bare=True), scene)


@functools.cache
def drawn():
    """The iris of two colours."""
    return draw(scene_with(two_colours()))


def radii():
    iris = view(bare=True).iris
    return scatter_to_picture(iris, np.hypot(*map(np.asarray, iris.point[:2])), SHAPE)


def coarse(picture, known, iris=BASE, exposure=EXPOSURE, shaded=None):
    scene = scene_with(None).replace(iris=iris)
    shaded = np.zeros(SHAPE, bool) if shaded is None else shaded
    numbers = shaded, np.zeros(SHAPE), scene, view(bare=True), None, exposure
    return solve_coarse(picture, known, *numbers)


def solved(reflection: bool, wrong: float = 0.0, by_another_process: bool = False):
    """The drawn iris, its visible pixels, those of a reflection on it, and what is found."""
    radius = radii()
    inner, outer = float(BARE.pupil_radius) + 0.2, min(float(BARE.iris_radius), 5.5) - 0.3
    known = (radius > inner) & (radius < outer)
    target = drawn()
    if by_another_process:
        target = draw(scene_with(two_colours()).replace(integrator=RadiativeIntegrator()))
    target = target.copy()
    window = np.zeros(SHAPE, bool)
    window[20:26, 20:26] = known[20:26, 20:26] & reflection
    target[window] += np.array([0.02, 0.05, 0.4])
    shown = known | ((radius > inner - 0.15) & (radius < outer))
    start = coarse(target * np.exp(wrong), known, exposure=EXPOSURE * np.exp(-wrong))
    processes = PROCESS_DOUBT if by_another_process else np.zeros((3, 3))
    doubts = np.full((3, 3), wrong**2), cells_of, processes
    return target, known, window, colour_iris(start, shown, *doubts)


def test_an_iris_whose_epithelium_is_black_cannot_have_these_colours():
    """`is_within` tells the iris that can make the colours of the pixels from one that cannot."""
    radius = radii()
    known = (radius > float(BARE.pupil_radius) + 0.2) & (radius < 5.2)
    black = BASE.replace(eumelanin=100.0, scattering_scale=1e-3)
    right, wrong = (coarse(drawn(), known, iris) for iris in (BASE, black))
    assert right.is_within and not wrong.is_within
    assert wrong.error > 5 * right.error


def test_pixels_in_a_shadow_do_not_ask_for_another_exposure():
    """Light that the model has not falls on the shaded edge of an iris, in colours of no iris."""
    radius = radii()
    known = (radius > float(BARE.pupil_radius) + 0.2) & (radius < 5.2)
    edge = known & (np.indices(SHAPE)[1] < 24)
    lit = drawn() + np.where(edge[..., None], np.array([0.02, 0.05, 0.4]), 0.0)
    assert not coarse(lit, known).is_within
    assert coarse(lit, known, shaded=edge).is_within


def _encoded(picture):
    return np.clip(picture * EXPOSURE, 0, None) ** (1 / 2.4)


def test_the_picture_of_the_texels_is_the_photograph():
    """Within 4 % by the pigments alone and 2 % with the residual, what a clone is asked for; at the
    edge of what is visible and on the rim beside the pupil as well.
    """
    target, known, window, found = solved(reflection=True)
    radius = radii()
    rim = (radius > float(BARE.pupil_radius) + 0.05) & (radius < float(BARE.pupil_radius) + 0.2)
    assert not known[rim].any() and rim.any()
    pigments, whole = (
        _encoded(draw(scene_with(maps).replace(iris=found.iris))) - _encoded(target)
        for maps in (found.maps.replace(residual=None), found.maps)
    )

    def rms(off, part):
        return np.sqrt((off[part] ** 2).mean())

    inside = known & ~window
    assert rms(pigments, inside) < 0.04
    # A blue reflection is none that pigments make: the residual keeps it.
    for part in (inside, inside & ~ndimage.binary_erosion(inside), rim):
        assert rms(whole, part) < 0.01
    assert rms(pigments, window) > max(0.05, 2 * rms(whole, window))
    assert 0.5 * window.sum() / known.sum() < found.outside < 2 * window.sum() / known.sum()
    assert found.gain == 1
    # Maps have the precision of the table that was inverted, so that its program draws the picture.
    factors = (found.maps.eumelanin, found.maps.pheomelanin, found.maps.residual)
    assert {np.asarray(f).dtype for f in factors} == {np.dtype(np.float32)}


def test_texels_of_a_strong_scatterer_stay_within_the_table_of_radiative_transfer():
    """A fit of 70 times LB06's scattering was refused: 60 times as much is beyond the table."""
    strong = usual_iris(0.2855).replace(scattering_scale=70 / 7, eumelanin=0.1)
    scene = dataclasses.replace(scene_with(None), iris=strong, integrator=RadiativeIntegrator())
    found = factors_within_table(scene)
    index, x = scene.eye.aqueous_index, extinction([400.0, 550.0, 655.0])
    table = quickest(strong, index, DEPTH_RESOLVED)

    @jax.jit
    def holds(most):
        return table.holds(texel_layers(strong, index, x, Scales(stroma=most)))

    for most, held in ((found.stroma[1], True), (FACTORS.stroma[1], False)):
        assert holds(jnp.asarray(most)) == held
    # Weak scatterers and ILIT have no such end.
    weak = scene.replace(iris=strong.replace(scattering_scale=0.01))
    for other in (weak, scene_with(None)):
        np.testing.assert_allclose(factors_within_table(other).stroma, FACTORS.stroma)


@pytest.fixture(scope="module")
def sure():
    return solved(reflection=False)[-1]


def test_the_numbers_and_their_deviations_are_those_of_the_drawing(sure):
    """Of all texels 85 to 95 in a hundred lie within two standard deviations of the prior and the
    noise; what trades with another (the melanins do) is known worse, and says so.
    """
    found = sure
    assert found.explained > 0.98 and found.gain == 1 and found.outside == 0
    for name, off, deviation, expected in errors_of(found):
        assert abs(np.median(off)) < 0.5 * np.median(deviation), name
        assert np.corrcoef(off + expected, expected)[0, 1] > 0.85, name
        assert (np.abs(off) < 2 * deviation).mean() > 0.85, name
    assert found.correlation[1, 2] < -0.5


def test_the_mean_melanin_is_that_of_the_drawing(sure):
    """The mean is taken by area, over the texels that the photograph shows."""
    true, held = two_colours(), BASE.layer_concentrations()
    both = held["abl_eumelanin"] * true.eumelanin + held["abl_pheomelanin"] * true.pheomelanin
    shown = ~sure.hidden
    cells = np.array(shown.shape) // (ANGLES, RADII)
    across = np.linspace(float(BARE.pupil_radius), float(BARE.iris_radius), shown.shape[1] + 1)
    area = np.broadcast_to(np.diff(across**2), shown.shape)[shown]
    expected = np.average(np.kron(np.asarray(both), np.ones(cells))[shown], weights=area)
    assert sure.abl_melanin(BARE) == pytest.approx(expected, rel=0.05)
    # The two together are known better than either.
    assert (
        0.01
        < sure.melanin_sd
        < 0.5 * min(np.median(deviation) for deviation in sure.deviations[1:])
    )


def test_deviations_hold_where_light_followed_another_process():
    """Drawn by radiative transfer and read by ILIT, which finds a weaker stroma: without the doubt
    about the process, strengths are off by more than two standard deviations in most texels.
    """
    found = solved(reflection=False, by_another_process=True)[-1]
    for name, off, deviation, _ in errors_of(found):
        assert (np.abs(off) < 2 * deviation).mean() > 0.9, name
        assert np.median(deviation) > np.sqrt(PROCESS_DOUBT.diagonal().min())
    _, off, deviation, _ = errors_of(found)[0]
    own = np.sqrt(deviation**2 - PROCESS_DOUBT[0, 0])
    assert np.median(off) < -0.2 and (np.abs(off) < 2 * own).mean() < 0.5


def errors_of(found):
    """Name, errors, standard deviations and true logarithms of each of the three in its texels."""
    true = two_colours()
    cells, shown = np.array(found.maps.shape) // (ANGLES, RADII), ~found.hidden
    fitted, drawn = found.iris.layer_concentrations(), BASE.layer_concentrations()
    scales = {
        "stroma_depth": float(found.iris.scattering_scale / BASE.scattering_scale),
        "eumelanin": fitted["abl_eumelanin"] / drawn["abl_eumelanin"],
        "pheomelanin": fitted["abl_pheomelanin"] / drawn["abl_pheomelanin"],
    }
    rows = []
    for (name, scale), deviation in zip(scales.items(), found.deviations, strict=True):
        expected = np.log(np.kron(np.asarray(getattr(true, name)), np.ones(cells)))
        off = np.log(np.asarray(getattr(found.maps, name)) * scale) - expected
        rows.append((name, off[shown], deviation[shown], expected[shown]))
    return rows


def test_an_iris_moved_to_its_maps_medians_keeps_every_layer():
    """Haemoglobin is as much denser as the rest of the stroma: it was not, and blue eyes were 5 %
    too dark in the picture of their own maps.
    """
    factors = np.array([0.36, 4.3, 1.1])
    table, index = extinction(np.linspace(400.0, 700.0, 7)), BARE.aqueous_index
    expected = texel_layers(BASE, index, table, Scales(None, *map(jnp.asarray, factors)))
    moved = texel_layers(moved_iris(BASE, factors), index, table, Scales())
    for one, other in zip(jax.tree.leaves(moved), jax.tree.leaves(expected), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-5)


def test_a_residual_moves_a_channel_that_the_model_makes_negative():
    """Saturated colours lie outside sRGB's gamut."""
    radiance = jnp.asarray([[0.5], [0.2], [-0.01]])
    np.testing.assert_allclose(within_gamut(radiance), [[0.5], [0.2], [0.005]], rtol=1e-6)


def test_a_residual_multiplies_the_iris_alone():
    maps = two_colours()
    factors = jnp.broadcast_to(jnp.asarray([2.0, 1.0, 0.5]), (*maps.shape, 3))
    tinted = draw(scene_with(maps.replace(residual=factors)))
    np.testing.assert_allclose(tinted, drawn() * [2.0, 1.0, 0.5], rtol=1e-5)
    with pytest.raises(ValueError, match="map residual has shape"):
        maps.replace(residual=factors[..., :2])
    with pytest.raises(ValueError, match="without a residual"):
        scene_with(maps.replace(residual=factors)).replace(wavelengths=(500.0, 600.0))


def test_the_camera_sees_a_share_of_the_images():
    room, known = Environment.uniform(0.5), {"camera": CAMERA, "integrator": INTEGRATOR}
    scene = Scene(BASE, None, EYE, None, room, **known)
    seen = view()
    assert seen.mirror is not None
    film = scatter_to_picture(seen.mirror, np.asarray(seen.mirror.reflectance), SHAPE)
    shown = []
    for share in (1.0, 0.25, 0.0):
        scene = scene.replace(camera=dataclasses.replace(CAMERA, images=share))
        channels = surroundings(seen, texture(seen, scene), scene)
        shown.append(np.asarray(channels).T.reshape(*SHAPE, 3))
    mirrored = 0.5 * film[..., None] * np.ones(3)
    for share, picture in ((0.75, shown[1]), (1.0, shown[2])):
        np.testing.assert_allclose(shown[0] - picture, share * mirrored, atol=2e-6)
    # The pupil tells what the tears mirror, and the darkest of the iris bounds it.
    pupil = Ellipse((44.5, 44.5), (12.0, 12.0))
    clear = np.zeros(SHAPE, bool)
    np.testing.assert_allclose(find_veil(shown[1], clear, pupil, seen), 0.125, rtol=0.01)
    clear[40:50, 70:75] = True
    dark = np.where(clear[..., None], 0.001, shown[1])
    assert find_veil(dark, clear, pupil, seen).max() < 0.05


def test_an_exposure_that_is_not_known_moves_all_texels_as_their_deviations_say(sure):
    """The same picture under an exposure that is wrong by a standard deviation of 15 %."""
    off = solved(reflection=False, wrong=0.15)[-1]
    assert (sure.common == 0).all()
    moved = []
    for found in (sure, off):
        values = found.iris.layer_concentrations()
        stroma = float(found.iris.scattering_scale) * np.asarray(found.maps.stroma_depth)
        melanins = (
            values[f"abl_{n}"] * np.asarray(getattr(found.maps, n))
            for n in ("eumelanin", "pheomelanin")
        )
        shown = ~found.hidden
        moved.append([np.median(np.log(m[shown])) for m in (stroma, *melanins)])
    shift = np.abs(np.subtract(*moved))
    assert shift[0] == pytest.approx(off.common[0], rel=0.5)
    assert (shift < 2.5 * off.common).all(), (shift, off.common)
