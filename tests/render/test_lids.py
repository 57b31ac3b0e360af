"""Lids: their surface, their skin, what they hide, and the light that they keep from the eye."""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import irisjax as ij
from common import chandrasekhar, operations, quick_jit
from irisjax.anatomy.sclera import sclera_centre
from irisjax.grow.lids import lids
from irisjax.numerics.strokes import stamp_strokes, stroke_sections
from irisjax.render.lids import lid_visibility, skin_reflectance
from irisjax.render.lights import Lights
from irisjax.render.picture import (
    draw_on_cores,
    illuminate,
    respond,
    shade,
    surroundings,
    texture,
    trace_shares,
)
from irisjax.render.project import project, project_visible, scatter_to_picture
from irisjax.render.scene import Scene
from irisjax.render.shading import incident_flux
from irisjax.tissue.diffusion import diffuse_reflectance
from render.small_scenes import LIGHT, QUICK

BARE = ij.Eye(cornea=ij.Cornea(scatter=None))
EYE = BARE.replace(lids=lids(BARE, texels=64, key=jax.random.key(2)))
CAMERA = ij.Camera(size=(16, 12), width=30.0)


@pytest.fixture(scope="module")
def every():
    return project(EYE, CAMERA)


def test_lines_of_sight_end_on_the_surface(every):
    centre = sclera_centre(EYE)

    @quick_jit
    def missed(lids, point):
        x, y, z = point
        return z - lids.depth(x, y, centre), lids.edge(x, y).outside

    off, outside = map(np.asarray, missed(EYE.lids, every.lids.point))
    assert abs(off[outside > 0.5]).max() < 0.02


def test_skin_is_what_exact_theory_of_a_deep_layer_says():
    for albedo in (0.95, 0.99):
        true = chandrasekhar(albedo, 1.0)
        found = diffuse_reflectance(jnp.asarray([1 - albedo]), jnp.asarray([albedo]), inside=0.0)
        np.testing.assert_allclose(found, true, rtol=0.03)  # diffusion theory is that good


def test_melanin_and_blood_darken_skin_where_they_absorb():
    skin = quick_jit(functools.partial(skin_reflectance, np.array([450.0, 550.0, 650.0])))
    usual, brown, flushed = (
        np.asarray(skin(jnp.asarray(m), jnp.asarray(b)))
        for m, b in ((0.01, 0.01), (0.2, 0.01), (0.01, 0.05))
    )
    assert (np.diff(usual) > 0).all() and 0.4 < usual[2] < 0.8
    assert (brown < usual).all() and brown[0] / usual[0] < brown[2] / usual[2] < 0.8
    assert flushed[1] / usual[1] < 0.85 < flushed[2] / usual[2]


def test_lids_keep_light_from_above_from_the_eye():
    polar = np.radians([0.0, 30.0, 60.0, 85.0])
    lamps = Lights.distant(polar, np.pi / 2)
    open_to = quick_jit(lambda eye, y: lid_visibility(eye, (0 * y, y, 0 * y), *_of(lamps)))
    top, middle = (np.asarray(open_to(EYE, jnp.asarray([y])))[:, 0] for y in (3.9, 0.0))
    assert middle[0] > 0.99 and (np.diff(middle) <= 0).all() and middle[-1] < 0.05
    assert (top < middle).all() and top[2] < 0.1

    def whole(y):
        return lid_visibility(EYE, (0 * y, y, 0 * y), *_of(lamps)).sum()

    value = quick_jit(jax.value_and_grad(whole))
    (_, slope), *step = (value(jnp.asarray([2.5 + e])) for e in (0, 1e-5, -1e-5))
    step = [float(v) for v, _ in step]
    np.testing.assert_allclose(slope, (step[0] - step[1]) / 2e-5, rtol=1e-4)


def test_skin_sends_little_of_the_light_that_lids_block_to_the_iris():
    """The iris gets it under the upper lid, in light from above. Dark skin sends less, and where
    no lid is in the way nothing is added.
    """
    lamp, polar = Lights.distant(np.radians(80), np.pi / 2), np.radians([0.0])
    flux = quick_jit(lambda eye, lamp: jnp.abs(incident_flux(lamp, eye, None, size=5)))
    dark = EYE.replace(lids=dataclasses.replace(EYE.lids, melanin=jnp.asarray(0.3)))
    bare, pale, dark = (np.asarray(flux(eye, lamp))[0, 2] for eye in (BARE, EYE, dark))
    share, less = (lidded[-1, 2] / bare[-1, 2] for lidded in (pale, dark))  # at the top
    assert 0 < 3 * less < share < 0.125
    ahead = [np.asarray(flux(eye, Lights.distant(polar, 0.0)))[0, 2, 2, 2] for eye in (BARE, EYE)]
    assert ahead[1] == pytest.approx(ahead[0], rel=0.02)


def _of(lamps):
    return tuple(lamps.towards[:, k, None] for k in range(3)), lamps.radius[:, None]


@pytest.fixture(scope="module")
def seen():
    return project_visible(EYE, CAMERA)


def test_lids_hide_what_lies_behind_them(seen, every):
    """Both projections show the same: all pixels for each part, and only those that see it."""
    for name in ("iris", "sclera", "lids"):
        parts = (getattr(view, name) for view in (seen, every))
        shares = (scatter_to_picture(p, np.asarray(p.share), (12, 16)) for p in parts)
        np.testing.assert_allclose(*shares, atol=1e-12)
    hidden, iris = (np.asarray(v.share).reshape(12, 16) > 0 for v in (every.lids, every.iris))
    # Pixels that see the iris, which is 5.5 mm wide, where nothing hides it.
    x, y = np.meshgrid((np.arange(16) - 7.5) * 30 / 16, (5.5 - np.arange(12)) * 30 / 16)
    bare = np.hypot(x, y) < 5.5
    np.testing.assert_array_equal(iris[bare], ~hidden[bare])
    assert 0.5 < iris[bare].mean() < 0.95


def test_skin_is_all_round_the_eye(seen):
    scene = Scene(LIGHT, eye=EYE, camera=CAMERA, integrator=QUICK)
    red, _, blue = np.asarray(surroundings(seen, texture(seen, scene), scene)).reshape(3, 12, 16)
    corners = np.s_[[0, 0, -1, -1], [0, -1, 0, -1]]
    assert (red[corners] > 1.2 * blue[corners]).all() and (blue[corners] > 0).all()
    # The white is less red, and brighter than the skin in the blue.
    assert red[6, 4] < 1.3 * blue[6, 4] and blue[6, 4] > blue[corners].max()


def test_shares_of_the_pixels_make_the_same_picture(seen, monkeypatch):
    """Each part once, lashes too, whatever the number of cores."""
    scene = Scene(LIGHT, eye=EYE, camera=CAMERA, integrator=QUICK)
    texels, response, tables = texture(seen, scene), respond(scene), scene.tables()
    whole = shade(seen, texels, illuminate(seen, texels, scene, tables), response)
    monkeypatch.setattr("irisjax.numerics.chunks._FEW", 1)
    monkeypatch.setattr("os.sched_getaffinity", lambda _: range(4), raising=False)
    assert len(trace_shares(scene)) == 4
    np.testing.assert_array_equal(draw_on_cores(scene, tables, response), whole)
    assert len(trace_shares(scene.replace(integrator=ij.RadiativeIntegrator()))) == 1


def test_absent_lids_cost_nothing():
    lamps = Lights.distant(0.5, 1.0)
    bare, lidded = (
        [
            operations(lambda eye=eye: project(eye, CAMERA)),
            operations(lambda eye=eye: incident_flux(lamps, eye, None)),
        ]
        for eye in (BARE, EYE)
    )
    assert all(a < b for a, b in zip(bare, lidded, strict=True))
    # None of the operations that draw lashes, and none of the parts.
    assert operations(lambda: project(BARE, CAMERA), name="scatter-max") == 0
    view = jax.eval_shape(lambda: project(BARE, CAMERA))
    assert view.lids is view.lashes is None


def test_strokes_have_the_area_of_their_outline():
    radius, length = 1.3, 60.0
    for angle in (0.0, 0.4, 1.2):
        x = 12 + length * np.cos(angle) * np.linspace(0, 1, 5)
        y = 12 + length * np.sin(angle) * np.linspace(0, 1, 5)
        stroke = jnp.asarray(np.stack([x, y, np.full(5, radius)], -1))[None]
        area = float(stamp_strokes(stroke, (80, 80), *stroke_sections(15.0, 2.6)).sum())
        assert area == pytest.approx(2 * radius * length, rel=0.04)


def test_equal_keys_grow_equal_lids():
    again, other = (lids(BARE, texels=64, key=jax.random.key(k)) for k in (2, 3))
    np.testing.assert_array_equal(again.lashes, EYE.lids.lashes)
    assert not np.array_equal(other.lashes, EYE.lids.lashes)


def test_what_lids_refuse():
    with pytest.raises(ValueError, match=r"upper = 9 .*0\.5"):
        lids(BARE, texels=64, key=jax.random.key(0), upper=9.0)
    with pytest.raises(ValueError, match="nose = 0 must be -1 or 1"):
        dataclasses.replace(EYE.lids, nose=0)
    with pytest.raises(ValueError, match="lids need an eye with a cornea and a sclera"):
        lids(BARE.replace(sclera=None), texels=64, key=jax.random.key(0))
    with pytest.raises(ValueError, match="lids need an eye with a cornea"):
        EYE.replace(cornea=None)
