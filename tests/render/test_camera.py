"""Lines of sight from 30 mm to the camera's limit, in both precisions."""

import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from irisjax.anatomy.eye import Eye, LimbalRing
from irisjax.optics.conicoid import Conicoid
from irisjax.render.camera import Camera
from irisjax.render.lights import Lights
from irisjax.render.project import trace_iris, trace_sclera, trace_tear_film, visible_parts

SIZE = (16, 12)
DISTANCES, POLARS = (30.0, 250.0, 1e3, 1e4, 3e4, 1e5), (0.0, 0.5, 1.05, 1.5)
SEEN = (visible_parts, trace_iris, trace_sclera, trace_tear_film)
INDEX = np.arange(SIZE[0] * SIZE[1], dtype=np.int32)


@pytest.fixture(scope="module")
def seen():
    """What every pixel sees and where, by precision, distance and polar angle."""

    cameras = list(itertools.product(DISTANCES, POLARS))

    def look(distance, polar):
        camera = Camera(polar, 0.3, distance, 26.0, SIZE)
        return tuple(f(INDEX, Eye(), camera) for f in SEEN)

    found = {}
    for x64 in (True, False):
        with jax.enable_x64(x64):
            every = jax.tree.map(np.asarray, jax.jit(jax.vmap(look))(*np.array(cameras).T))
        for k, at in enumerate(cameras):
            found[x64, *at] = jax.tree.map(lambda x, k=k: x[k], every)
    return found


@pytest.mark.parametrize("distance", DISTANCES)
def test_single_precision_sees_what_double_does(seen, distance):
    for polar in POLARS:
        (sees, *fine), (also, *coarse) = (seen[x64, distance, polar] for x64 in (True, False))
        assert sees.any()
        # A pixel whose line grazes an edge may fall to either side of it.
        assert (sees != also).sum() <= 1, polar
        for part, one, other in zip((1, 2, 4), fine, coarse, strict=True):
            both = (sees & also & part) > 0
            for a, b in zip(jax.tree.leaves(one), jax.tree.leaves(other), strict=True):
                a, b = a[..., both], b[..., both]
                assert np.isfinite(b).all()
                # Grazing lines of sight alone are less sure: their share and place change fast.
                close = np.abs(a - b) < 1e-4 * np.maximum(np.abs(a), 1)
                assert close.mean() > 0.99, (polar, part)
                np.testing.assert_allclose(b, a, atol=2e-2)


def test_a_far_camera_is_an_orthographic_one(seen):
    """At 100 m lines of sight are parallel: a pixel's place is where it aims."""
    _, iris, _, mirror = seen[True, 1e5, 0.0]
    (w, h), pitch = SIZE, 26.0 / SIZE[0]
    x = (INDEX % w + 0.5 - w / 2) * pitch
    y = -(INDEX // w + 0.5 - h / 2) * pitch
    inside = np.hypot(x, y) < 4
    # Magnified by the cornea, without a twist.
    twist = iris.point[1] * x - iris.point[0] * y
    assert np.abs(twist[inside]).max() < 1e-3
    radius = float(Eye().cornea.anterior.radius)
    # The mirror's direction at the apex's neighbourhood: a normal of slope r/R.
    near = np.hypot(x, y) < 1.5
    np.testing.assert_allclose(mirror.mirror[0][near], 2 * x[near] / radius, atol=0.03)


meet = jax.jit(lambda *ray: Conicoid(7.8, 0.75).intersect(*ray))


@pytest.mark.parametrize("polar", [0.0, 1.5])
def test_rays_from_far_meet_a_conicoid(polar, bits):
    """The surface itself does not lose a ray that begins 10 m away."""
    back, side = [np.sin(polar), 0.0, -np.cos(polar)], [np.cos(polar), 0.0, np.sin(polar)]
    start = np.linspace(-4.0, 4.0, 41)[:, None] * side + [0.0, 0.0, 2.0]
    towards = jnp.asarray(np.broadcast_to(np.negative(back), start.shape), float)
    (near, met), (far, also) = (
        map(np.asarray, meet(jnp.asarray(start + np.multiply(d, back), float), towards))
        for d in (30.0, 1e4)
    )
    np.testing.assert_array_equal(also, met)
    # The start itself is known to half a micrometre in single precision.
    np.testing.assert_allclose((far - near)[met], 1e4 - 30, atol=5e-3 if bits == 32 else 1e-9)


def test_far_lamps_in_single_precision():
    """Directions and irradiances of lamps at places, from the nearest to 10 km."""

    def around(x64):
        with jax.enable_x64(x64):
            place = np.array([0.3, -0.2, -0.933])[None] * np.array([22.0, 250.0, 1e4, 1e7])[:, None]
            lights = Lights.points(place, 2.0)
            point = (jnp.asarray([0.0, 3.0, -5.0]),) * 3
            towards, power = jax.jit(lambda lights: lights.incident_at(point))(lights)
            return np.stack([*map(np.asarray, towards), np.asarray(power)])

    np.testing.assert_allclose(around(False), around(True), rtol=3e-6, atol=1e-6)


# 0.01 mm a pixel, parallel lines of sight; a line outwards, and a circle at 4.5 mm: in the fade of
# an even ring, half dark.
ABOVE = Camera(size=(1201, 1201), width=12.01, distance=1e5)
TURNS = np.linspace(0, 2 * np.pi, 600, endpoint=False)
RIGHT = np.concatenate([[350, 425, 450, 475, 510], np.rint(450 * np.cos(TURNS))])
UP = np.concatenate([np.zeros(5), np.rint(450 * np.sin(TURNS))])
RINGED = ((600 - UP) * 1201 + 600 + RIGHT).astype(np.int32)


@jax.jit
def ringed(darkening, unevenness):
    """The iris's share of light at `RINGED`, and its derivative by the ring's darkening."""

    def share(darkening):
        ring = LimbalRing(darkening=darkening, width=0.5, fade=0.5, unevenness=unevenness)
        return trace_iris(RINGED, Eye(limbus_width=0.5, limbal_ring=ring), ABOVE).share

    return jax.jvp(share, (darkening,), (jnp.ones_like(darkening),))


def test_limbal_ring_darkens_the_iris_inside_its_blend_with_the_white():
    """The iris's share falls from all to 1 - darkening over the fade, half of it half-way."""
    (plain, _), (left, slope) = (np.asarray(ringed(d, 0.0))[:, :5] for d in (0.0, 0.6))
    np.testing.assert_allclose(left / plain, [1, 1, 0.7, 0.4, 0.4], atol=0.02)
    np.testing.assert_allclose(slope / plain, [0, 0, -0.5, -1, -1], atol=0.035)


def test_an_uneven_limbal_ring_is_wide_and_narrow_round_the_eye_and_usual_on_average():
    even, uneven = (np.asarray(ringed(0.6, u)[0])[5:] for u in (0.0, 0.8))
    ratio = uneven / even
    assert ratio.min() < 0.8 and ratio.max() > 1.2
    assert abs(ratio.mean() - 1) < 0.03
    assert np.abs(np.diff(ratio)).max() < 0.5  # waves, not noise
