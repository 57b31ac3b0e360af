import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.linalg

from irisjax.anatomy.eye import Eye, Sclera
from irisjax.anatomy.sclera import VeinMap, limbus_depth, meet_sclera, sclera_centre, vein_place
from irisjax.grow.vessels import veins
from irisjax.measure.colour import colour_of, tristimulus_matrix
from irisjax.render.camera import Camera
from irisjax.render.outside import (
    DEEP,
    DEEP_CHORD,
    DEEPEST,
    SHALLOW,
    Blood,
    bulk_reflectance,
    colour_table,
    sample_veins,
    sclera_reflectance,
)
from irisjax.render.project import trace_tear_film
from irisjax.tissue.diffusion import slab_reflectance

GRID = np.arange(380.0, 781.0, 5.0)

meet = jax.jit(meet_sclera)
look = jax.jit(lambda veins, eye, point: sample_veins(veins, *vein_place(eye, point)))
slab = jax.jit(lambda k, s, behind: slab_reflectance(k, s, 1.1, behind))
bulk_on_grid = jax.jit(lambda sclera: bulk_reflectance(sclera, GRID))


def bloody(depth):
    return Blood(jnp.asarray(depth))


@pytest.fixture(scope="module")
def drawn():
    return veins(Eye(), key=jax.random.key(3))


def test_a_slab_is_what_its_two_fluxes_integrate_to():
    """dI/dx = −(K + S) I + S J, dJ/dx = (K + S) J − S I, by a matrix exponential."""
    for absorbed, scattered, behind in ((0.05, 2.0, 0.1), (0.4, 3.0, 0.3), (0.0, 1.0, 0.0)):
        k, s = 2 * absorbed, 0.75 * scattered
        through = scipy.linalg.expm(1.1 * np.array([[-(k + s), s], [-s, k + s]]))
        # From the front (1, R) to the back (T, behind T).
        t = np.linalg.solve(through, np.eye(2)) @ [1.0, behind]
        found = slab(*(jnp.asarray([v]) for v in (absorbed, scattered, behind)))
        np.testing.assert_allclose(found, t[1] / t[0], rtol=1e-6)


def test_yellowing_takes_blue_from_the_white():
    whites = [np.asarray(bulk_on_grid(Sclera(yellowing=y))) for y in (0.0, 1.0, 4.0)]
    assert ((whites[1] > 0.4) & (whites[1] < 0.8)).all()
    child, usual, old = (float(colour_of(GRID, white).lab[2]) for white in whites)
    assert child < 0 < usual < 6 < old


def test_a_tint_multiplies_the_reflectance():
    tinted = bulk_on_grid(Sclera(tint=jnp.array([1.2, 1.0, 0.7])))
    share = np.asarray(tinted) / np.asarray(bulk_on_grid(Sclera()))
    at = np.searchsorted(GRID, [450.0, 500.0, 550.0, 610.0, 700.0])
    np.testing.assert_allclose(share[at], [0.7, 0.85, 1.0, 1.2, 1.2], rtol=1e-6)


def test_the_white_mirrors_as_much_as_its_gloss():
    pixels = np.array([16 * 48 + 24, 16 * 48 + 2], np.int32)
    films = (
        trace_tear_film(pixels, Eye(sclera=Sclera(gloss=gloss)), Camera(size=(48, 32)))
        for gloss in (1.0, 0.5)
    )
    full, half = (np.asarray(film.reflectance) for film in films)
    np.testing.assert_allclose(half / full, [1, 0.5], rtol=1e-6)


def test_beer_lambert_by_hand():
    """Two layers of vessels, each with its cover, and no blood at all."""
    # 560 nm: 32613.2 (HbO2) and 53788 (Hb) /cm/M, decadic, in Prahl's table.
    mu = np.log(10) * 0.1 * 2.0e-3 * (0.8 * 32613.2 + 0.2 * 53788.0)  # 17 per mm
    scattered = 0.75 * 2.71 * (560 / 500) ** -1.627 * np.array([SHALLOW, DEEP])
    clear = 1 - scattered / (1 + scattered)
    sclera, x = Sclera(hemoglobin=2.0, saturation=0.8), np.array([560.0])
    bulk = np.asarray(jax.jit(lambda sclera: bulk_reflectance(sclera, x))(sclera))
    reflectance = jax.jit(lambda sclera, blood: sclera_reflectance(sclera, x, blood))
    absorbed = clear * -np.expm1(-2 * mu * np.array([0.03, DEEP_CHORD]))
    for cover, deep in ((None, None), (0.4, None), (0.4, 0.7), (0.0, 0.0)):
        blood = Blood(*(None if v is None else jnp.asarray(v) for v in (0.03, cover, deep)))
        share = (1 - (1.0 if cover is None else cover) * absorbed[0]) * (
            1 - (deep or 0.0) * absorbed[1]
        )
        np.testing.assert_allclose(reflectance(sclera, blood), bulk * share, rtol=1e-10)


def test_table_errs_by_1e_4():
    weights = np.concatenate([tristimulus_matrix(GRID, s)[0] for s in ("XYZ", "linear sRGB")])
    grids = np.concatenate([np.linspace(0, 0.02, 400), np.linspace(0.02, DEEPEST, 400)])
    blood = Blood(*jnp.asarray([grids, *np.random.default_rng(0).random((2, grids.size))]))

    @jax.jit
    def errors(blood):
        table = colour_table(Sclera(), GRID, weights)
        beyond = table(bloody(9.0)) - table(bloody(DEEPEST))
        return [
            abs(table(b) - sclera_reflectance(Sclera(), GRID, b) @ weights.T).max()
            for b in (Blood(blood.depth), blood)
        ], beyond

    found, beyond = errors(blood)
    assert max(found) < 2e-4
    np.testing.assert_allclose(beyond, 0.0, atol=1e-12)


def test_map_values(drawn):
    for name, most in (("depth", 0.12), ("cover", 1), ("deep", 1)):
        a = np.asarray(getattr(drawn, name))
        assert a.shape == (1024, 512) and np.isfinite(a).all() and a.min() >= 0
        assert 0 < a.max() <= most


def test_equal_keys_grow_equal_vessels_and_a_higher_density_more():
    assert veins(Eye(sclera=Sclera(veins=0.0)), key=jax.random.key(3)) is None

    def grown(density=1.0, key=3):
        eye = Eye(sclera=Sclera(veins=density))
        return veins(eye, shape=(128, 64), key=jax.random.key(key))

    one, again, other = grown(), grown(), grown(key=4)
    pairs = zip(jax.tree.leaves(one), jax.tree.leaves(again), strict=True)
    assert all(np.array_equal(a, b) for a, b in pairs)
    assert not np.array_equal(one.cover, other.cover)
    assert np.mean(grown(0.3).cover) < np.mean(one.cover) < np.mean(grown(2.0).cover)


def test_cover_does_not_depend_on_the_texture(drawn):
    """A stroke keeps its area in coarse textures."""
    coarse = veins(Eye(), shape=(512, 256), key=jax.random.key(3))
    np.testing.assert_allclose(np.mean(coarse.cover), np.mean(drawn.cover), rtol=0.1)


def test_periodic_in_azimuth(drawn):
    """The seam is no different from elsewhere, in the texture and in the look-up."""
    cover = np.asarray(drawn.cover)
    step = abs(cover - np.roll(cover, 1, axis=0)).mean(axis=1)
    assert step[0] < 3 * step.mean()
    eye = Eye()
    centre, r = float(sclera_centre(eye)), 11.5
    across = np.linspace(0.5, 1.5, 300)

    def at(azimuth):
        s, z = r * np.sin(across), centre - r * np.cos(across)
        return jnp.asarray(np.stack([s * np.cos(azimuth), s * np.sin(azimuth), z], -1))

    for a, b in zip(look(drawn, eye, at(-1e-9)), look(drawn, eye, at(1e-9)), strict=True):
        np.testing.assert_allclose(a, b, atol=1e-5)


def test_look_up_at_a_cell_centre(drawn):
    eye = Eye()
    i, j = 700, 100
    limbus = np.arcsin(5.5 / 11.5)
    azimuth, polar = (i + 0.5) * 2 * np.pi / 1024, limbus + (j + 0.5) / 512 * (np.pi / 2 - limbus)
    sine, centre = np.sin(polar), np.array([0, 0, float(sclera_centre(eye))])
    outwards = np.array([sine * np.cos(azimuth), sine * np.sin(azimuth), -np.cos(polar)])
    found = look(drawn, eye, jnp.asarray(centre + 11.5 * outwards))
    expected = [drawn.depth[i, j], drawn.cover[i, j], drawn.deep[i, j]]
    np.testing.assert_allclose(found, expected, atol=1e-9)


@pytest.mark.parametrize(
    "eye", [Eye(), Eye(cornea=None), Eye(sclera=Sclera(radius=12.0), limbus_radius=5.8)]
)
def test_sphere_passes_through_the_limbus(eye):
    a, r, z = np.linspace(0, 6, 4), float(eye.limbus_radius), float(limbus_depth(eye))
    rim = np.stack([r * np.cos(a), r * np.sin(a), np.full(4, z)], -1)
    away = np.linalg.norm(rim - [0, 0, float(sclera_centre(eye))], axis=-1)
    np.testing.assert_allclose(away, float(eye.sclera.radius), rtol=1e-14)
    # Just outside the rim a ray along the axis meets the white, just inside it does not.
    for scale, white in ((1.001, True), (0.999, False)):
        origin = jnp.asarray(rim * [scale, scale, 0] - [0, 0, 20])
        t, hit = meet(eye, origin, jnp.broadcast_to(jnp.array([0.0, 0.0, 1.0]), origin.shape))
        assert (np.asarray(hit) == white).all()
        np.testing.assert_allclose(t - 20, z, atol=0.02)


def test_meet_sclera_exactly():
    eye = Eye()
    origin = jnp.array([[8.0, 1.0, -30.0], [30.0, 3.0, 9.0], [8.0, 12.0, -30.0], [8.0, 1.0, 60.0]])
    direction = jnp.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, 0.0, 1.0]])
    t, hit = meet(eye, origin, direction)
    assert hit.tolist() == [True, True, False, False]
    point = origin + t[:, None] * direction
    from_centre = np.linalg.norm(np.asarray(point) - [0, 0, float(sclera_centre(eye))], axis=-1)
    np.testing.assert_allclose(from_centre[:2], 11.5, rtol=1e-13)


def test_gradients_are_finite(drawn):
    weights, _ = tristimulus_matrix(GRID)
    across = [[x, 1.0, -30.0] for x in np.linspace(6, 11, 40)]
    origin = jnp.array([[0.0, 0.0, -30.0], [8.0, 20.0, -30.0], [-7.0, 0.0, -30.0], *across])

    def brightness(sclera, origin):
        eye = Eye(sclera=sclera)
        d = jnp.broadcast_to(jnp.array([0.0, 0.0, 1.0]), origin.shape)
        t, hit = meet_sclera(eye, origin, d)
        blood = sample_veins(drawn, *vein_place(eye, origin + t[:, None] * d))
        return jnp.where(hit[:, None], colour_table(sclera, GRID, weights)(blood), 0.0).sum()

    value, gradient = jax.jit(jax.value_and_grad(brightness, argnums=(0, 1)))(Sclera(), origin)
    assert np.isfinite(value)
    assert all(np.isfinite(g).all() for g in jax.tree.leaves(gradient))
    assert float(gradient[0].saturation) != 0


def test_single_precision(float32):
    eye = Eye()
    drawn = veins(eye, shape=(128, 64), key=jax.random.key(0))
    weights, _ = tristimulus_matrix(GRID)

    @jax.jit
    def shaded(point):
        return colour_table(eye.sclera, GRID, weights)(sample_veins(drawn, *vein_place(eye, point)))

    colour = shaded(jnp.array([[8.0, 2.0, 4.0]]))
    assert drawn.depth.dtype == drawn.deep.dtype == colour.dtype == jnp.float32
    assert np.isfinite(colour).all()


def test_an_eye_without_sclera():
    with pytest.raises(ValueError, match="no sclera"):
        veins(Eye(sclera=None), key=jax.random.key(0))
    with pytest.raises(ValueError, match="no sclera"):
        sclera_centre(Eye(sclera=None))


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        ("depth", -0.01, r"depth = -0.01 mm is outside \[0, inf\) mm"),
        ("cover", -0.2, r"cover = -0.2 is outside \[0, inf\)"),
        ("deep", np.nan, r"deep = nan is outside \[0, inf\)"),
    ],
)
def test_maps_of_vessels_that_none_can_have_are_refused(field, value, message):
    """A negative depth was drawn as a place without blood."""
    maps = dict.fromkeys(("depth", "cover", "deep"), jnp.zeros((4, 4)))
    with pytest.raises(ValueError, match=message):
        VeinMap(**maps | {field: jnp.full((4, 4), value)})
