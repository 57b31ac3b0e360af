"""Rays and stacks of cones, against spheres, points put on them, and marching."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from irisjax.ocularist.coats import prosthesis
from irisjax.ocularist.cones import Cones, shell

RNG = np.random.default_rng(7)
N = 2000  # rays of most tests
VASE = ((4.0, 0.0), (4.5, 3.0), (2.0, 3.5), (-1.0, 1.0), (-3.0, 1.0), (-3.0, 2.5), (-4.0, 0.0))


def sphere(count, radius=11.5):
    angle = np.linspace(0, np.pi, count + 1)
    profile = radius * np.stack([-np.cos(angle), np.sin(angle)], -1)
    profile[[0, -1], 1] = 0
    return Cones.of(profile)


def unit(v):
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


def rays_towards(target, length):
    """Origins and directions of rays that reach targets from anywhere after a length."""
    direction = unit(RNG.normal(size=target.shape))
    return target - length * direction, direction


def on_stack(profile, cone, share, angle):
    """Points on numbered cones, at a share of the way between their circles."""
    (z, r), (dz, dr) = np.asarray(profile)[cone].T, np.diff(np.asarray(profile), axis=0)[cone].T
    r = r + share * dr
    return np.stack([r * np.cos(angle), r * np.sin(angle), z + share * dz], -1)


compiled = jax.jit(lambda cones, *given: cones.meet(*given), static_argnums=3)
normals = jax.jit(lambda cones, *given: cones.normal(*given))


def meet(cones, origin, direction, least=0.0):
    """Where rays meet cones; always of `N` rays, so that it is compiled once for each stack."""
    more = (0, N - len(origin)), (0, 0)
    rays = (jnp.asarray(np.pad(v, more, mode="edge"), cones.z.dtype) for v in (origin, direction))
    return jax.tree.map(lambda x: np.asarray(x)[: len(origin)], compiled(cones, *rays, least))


def rounding(cones):
    """Sixteen units in the last place of the stack's size: what seams overlap by, mm."""
    size = float(np.abs(cones.z).max() + np.max(cones.radius))
    return 16 * float(jnp.finfo(cones.z.dtype).eps) * size


def test_many_cones_are_a_sphere():
    """Half of the rays begin outside, half inside."""
    away = np.where(np.arange(N) % 2, 3.0, 40.0)[:, None]
    origin, direction = rays_towards(8 * unit(RNG.normal(size=(N, 3))), away)
    along = (origin * direction).sum(1)
    half = np.sqrt(along**2 - (origin**2).sum(1) + 11.5**2)
    exact = -along + np.where(away[:, 0] == 3, half, -half)
    worst = []
    for count in (30, 60):
        hit = meet(sphere(count), origin, direction)
        assert bool(hit.met.all())
        met = np.linalg.norm(origin + hit.distance[:, None] * direction, axis=1)
        # Chords of a circle lie inside it, by their sagitta at most.
        assert met.max() <= 11.5 + 1e-12
        assert met.min() >= 11.5 * np.cos(np.pi / count / 2) - 1e-12
        worst.append(np.abs(hit.distance - exact).mean())
    assert worst[0] / worst[1] == pytest.approx(4, rel=0.1)


def test_no_ray_slips_through_a_seam(bits):
    cones = sphere(60)
    profile = np.stack([cones.z, cones.radius], -1).astype(float)
    seam = RNG.integers(1, 60, N)
    target = on_stack(profile, seam, np.zeros(len(seam)), RNG.uniform(0, 2 * np.pi, len(seam)))
    for length in (1e-2, 3.0, 40.0):
        # Towards the inside: grazing rays may miss a stack by rights.
        origin, direction = rays_towards(target, length)
        hit = meet(cones, origin, direction)
        inwards = -(direction * target).sum(1) / 11.5 > 0.1
        assert bool(hit.met[inwards].all())
        # The target is on the stack: what is met, is met there or before.
        assert float(hit.distance[inwards].max()) <= length + 10 * rounding(cones)


def test_rays_meet_cylinders_rings_and_cones_at_points_put_there(bits):
    cones, cone = Cones.of(VASE), RNG.integers(0, len(VASE) - 1, N)
    target = on_stack(VASE, cone, RNG.uniform(0.01, 0.99, N), RNG.uniform(0, 2 * np.pi, N))
    origin, direction = rays_towards(target, 0.7)
    hit = meet(cones, origin, direction)
    point = origin + hit.distance.astype(float)[:, None] * direction
    normal = np.asarray(normals(cones, jnp.asarray(target, cones.z.dtype), jnp.asarray(cone)))
    steep = np.abs((normal * direction).sum(1)) > 0.1
    assert bool(hit.met[steep].all())
    assert (hit.distance[steep] <= 0.7 + 20 * rounding(cones)).all()
    first = steep & (hit.distance > 0.7 - 1e-3)
    assert first.sum() > 0.6 * N
    np.testing.assert_array_equal(hit.cone[first], cone[first])
    np.testing.assert_allclose(point[first], target[first], atol=20 * rounding(cones))


@pytest.mark.parametrize("slope", [0.0, 1e-12, 1e-3, -1e-7])
def test_almost_flat_cones_lose_nothing(slope, bits):
    radius = np.array([2.0, 3.5, 6.0])
    cones = Cones(*(jnp.asarray(v, float) for v in (3 + slope * (radius - 2), radius)))
    profile = np.stack([cones.z, cones.radius], -1).astype(float)
    share = RNG.uniform(0.001, 0.999, N)
    target = on_stack(profile, RNG.integers(0, 2, N), share, RNG.uniform(0, 2 * np.pi, N))
    origin, direction = rays_towards(target, 2.0)
    steep = np.abs(direction[:, 2]) > 0.1
    hit = meet(cones, origin, direction)
    assert bool(hit.met[steep].all())
    off = np.abs((hit.distance.astype(float) - 2.0) * direction[:, 2])
    assert off[steep].max() < rounding(cones)


TUBE = [(-2.0, 1.5), (2.0, 1.5)]
FAR = 9 - np.sqrt(1.5**2 - 0.25)
# Origin, direction and distance of rays, 0 where they miss.
RAYS = {
    "ring": ([(3, 2), (3, 6)], [
        (0, 0, 0, 0, 0.1, 1, 0), (4, 0, 0, 0, 0, 1, 3), (0, 5, 7, 0, 0, -1, 4),
        (6.5, 0, 0, 0, 0, 1, 0), (0, 1.9, 0, 0, 0, 1, 0),
    ]),
    "cylinder": (TUBE, [
        (-5, 0, 0, 1, 0, 0, 3.5), (0, 0, 0, 0, 1, 0, 1.5), (0.3, 0, -9, 0, 0, 1, 0),
        (-5, 0, 2.5, 1, 0, 0, 0), (-5, 0, -1, 1, 0, 0.3, 3.5 * np.sqrt(1.09)),
    ]),
    "opens-back": ([(1, 1), (2, 2)], [(0.5, -9, -1.5, 0, 1, 0, 0), (0.5, -9, 1.5, 0, 1, 0, FAR)]),
    "opens-forward": ([(-1, 1), (-2, 2)], [(0.5, -9, 1.5, 0, 1, 0, 0), (0.5, -9, -1.5, 0, 1, 0, FAR)]),
    "apex": ([(1, 0), (2, 3)], [(0, 0, -4, 0, 0, 1, 5), (0, 0, 5, 0, 0, -1, 4)]),
    "centre": ([(1, 0), (1, 3)], [(0, 0, -4, 0, 0, 1, 5), (0, 0, 5, 0, 0, -1, 4)]),
}  # fmt: skip


@pytest.mark.parametrize("name", RAYS)
def test_rays_by_hand(name):
    """Holes, the inside, mirror images of cones, which are not met, and the axis."""
    rays = np.array(RAYS[name][1], float)
    hit = meet(Cones.of(RAYS[name][0]), rays[:, :3], unit(rays[:, 3:6]))
    np.testing.assert_array_equal(hit.met, rays[:, 6] > 0)
    np.testing.assert_allclose(hit.distance, rays[:, 6], atol=1e-13)


def test_the_first_meeting_beyond_a_distance():
    beyond = meet(Cones.of(TUBE), np.array([[-5.0, 0, 0]]), np.array([[1.0, 0, 0]]), least=4.0)
    np.testing.assert_allclose(beyond.distance, [6.5])


def test_normals_are_unit_perpendicular_and_out_of_the_eye():
    cones, share = Cones.of(VASE), RNG.uniform(0.05, 0.95, N)
    cone, angle = RNG.integers(0, len(VASE) - 1, N), RNG.uniform(0, 2 * np.pi, N)
    point = on_stack(VASE, cone, share, angle)
    normal = np.asarray(normals(cones, jnp.asarray(point), jnp.asarray(cone)))
    np.testing.assert_allclose(np.linalg.norm(normal, axis=1), 1, rtol=1e-14)
    for aside in (
        on_stack(VASE, cone, share + 0.02, angle) - point,
        on_stack(VASE, cone, share, angle + 1e-6) - on_stack(VASE, cone, share, angle - 1e-6),
    ):
        assert np.abs((unit(aside) * normal).sum(1)).max() < 1e-8
    apex = Cones.of([(1.0, 0.0), (2.0, 3.0)])
    at_apex = normals(apex, jnp.asarray([[0.0, 0, 1]]), jnp.asarray([0]))
    assert np.isfinite(at_apex).all()
    tube = np.asarray(VASE)[cone, 1] == np.asarray(VASE)[cone + 1, 1]
    assert (normal[~tube, 2] < 0).all()
    assert ((normal * point)[tube, :2].sum(1) > 0).all()


def test_height_follows_the_profile_and_goes_straight_on():
    profile = np.array([(3.0, 2.0), (3.2, 3.0), (3.1, 5.0)])
    cones = Cones.of(profile)
    inside = np.linspace(2, 5, 31)
    np.testing.assert_allclose(
        cones.height(jnp.asarray(inside)), np.interp(inside, profile[:, 1], profile[:, 0])
    )
    np.testing.assert_allclose(cones.height(jnp.asarray([1.0, 7.0])), [2.8, 3.0])


@pytest.mark.parametrize(
    ("profile", "words"),
    [
        ([(3.0, 2.0)], "two circles or more"),
        ([(3.0, 2.0), (3.0, 2.0)], "circles 0 and 1 of the cones are the same"),
        ([(3.0, 2.0), (np.nan, 3.0)], "circle 1 of the cones has z = nan mm"),
        ([(3.0, -2.0), (3.0, 2.0)], "circle 0 of the cones has z = 3 mm and radius = -2 mm"),
        ([(3.0, 2.0, 1.0)], "pairs"),
        ([3.0, 2.0], "pairs"),
    ],
)
def test_bad_profiles_are_one_clear_line(profile, words):
    with pytest.raises(ValueError, match=words) as error:
        Cones.of(profile)
    assert "\n" not in str(error.value)


@jax.jit
@jax.value_and_grad
def total(given, radius):
    z, origin, direction = given
    return Cones(z, radius).meet(origin, direction).distance.sum()


def test_distances_change_with_the_circles_as_finite_differences_say():
    z, radius = np.array([3.0, 3.3, 3.2]), np.array([2.0, 3.5, 6.0])
    origin = np.array([[0.5, -3.0, -4.0], [2.0, 2.0, -4.0], [1.0, 5.5, -4.0], [-4.0, 1.0, -4.0]])
    direction = unit(
        np.array([[0.1, 0.0, 1.0], [0.2, 0.1, 1.0], [0.0, -0.1, 1.0], [0.0, 0.0, 1.0]])
    )
    slope = total((z, origin, direction), radius)[1][0]
    for i, step in enumerate(1e-5 * np.eye(3)):
        high, low = (total((z + s * step, origin, direction), radius)[0] for s in (1, -1))
        numeric = float(high - low) / 2e-5
        assert abs(numeric) > 0.05
        assert float(slope[i]) == pytest.approx(numeric, rel=1e-7)


@pytest.mark.parametrize("tilt", [0.3, 0.0, 1e-8], ids=["cone", "ring", "almost-flat"])
def test_derivatives_are_finite_where_rays_miss_or_run_along_the_axis(tilt):
    origin = np.array([[0.0, 0.0, -4.0], [9.0, 9.0, -4.0], [9.0, 0.0, 0.5], [1.0, 0.0, -4.0]])
    direction = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
    z = np.array([3.0, 3.0 + tilt, 3.0 + tilt / 2])
    found = total((z, origin, direction), np.array([0.0, 3.0, 6.0]))[1]
    by_z, by_origin, _ = found
    assert all(np.isfinite(v).all() for v in found)
    # The apex and a third of the first cone, and what starts later arrives earlier.
    np.testing.assert_allclose(by_z, [1 + 2 / 3, 1 / 3, 0], rtol=1e-6)
    np.testing.assert_allclose(by_origin[0, 2], -1, rtol=1e-6)


CORNEA, WHITE, APART = 7.8, 11.5, 4.7  # [L03 Fig. 6], mm


def test_circles_lie_on_the_papers_spheres_and_meet_at_the_limbus():
    cornea, white = shell(prosthesis()).values()
    z, r = np.asarray(cornea.z), np.asarray(cornea.radius)
    np.testing.assert_allclose(np.hypot(z - CORNEA, r), CORNEA, rtol=1e-6)
    z, r = np.asarray(white.z), np.asarray(white.radius)
    # The paper's limbus is rounded to 0.01 mm.
    np.testing.assert_allclose(np.hypot(z - CORNEA - APART, r), WHITE, atol=0.01)
    assert (cornea.z[0], cornea.radius[0], white.radius[-1]) == (0, 0, pytest.approx(0, abs=1e-6))
    np.testing.assert_allclose(white.z[0], cornea.z[-1])
    np.testing.assert_allclose(white.radius[0], cornea.radius[-1])


def test_eyes_without_a_shell():
    eye = prosthesis()
    for part in ("cornea", "sclera"):
        with pytest.raises(ValueError, match="has no shell"):
            shell(eye.replace(**{part: None}))
    with pytest.raises(ValueError, match="circles"):
        shell(eye, 1)
