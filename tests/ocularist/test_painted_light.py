"""Where painted coats are seen and where their shadows fall."""

import jax.numpy as jnp
import numpy as np
import pytest
from paintings import BLACK, BLUE, EYE, FINE, GREEN, RED, SIZE, coat, dot, picture, spots

from irisjax.ocularist import integrator
from irisjax.ocularist.coats import DEPTH, LIMBUS, SLOPE
from irisjax.render.camera import Camera
from irisjax.render.lights import Lights
from irisjax.render.points import project_points
from irisjax.render.surfaces import IrisSurface


def centroid(values, camera=FINE):
    columns, rows = np.meshgrid(*(np.arange(n) for n in camera.size))
    return np.array([(values * at).sum() / values.sum() for at in (columns, rows)])


def pixel(x, y, height, camera):
    """Column and row in which a distant camera sees (x, y), a height above the base."""
    # Points are searched for on an eye's iris: on one that lies so much further forward. Its
    # camera looks at its pupil, and sees all of it moved aside by the difference.
    eye = EYE.replace(iris_depth=DEPTH - height)
    z = DEPTH - height + SLOPE * np.hypot(x, y)
    column, row, visible = project_points(IrisSurface(eye), camera, jnp.asarray([[x, y, z]]))
    assert bool(visible.all())
    _, right, up = camera.axes()
    scale = camera.size[0] / float(camera.width)
    return np.array(
        [
            float(column[0]) - height * float(right[2]) * scale,
            float(row[0]) + height * float(up[2]) * scale,
        ]
    )


@pytest.mark.parametrize(("polar", "azimuth"), [(0.0, 0.0), (0.5, 1.0)])
def test_dots_on_high_coats_move_against_the_base(polar, azimuth):
    camera = Camera(size=FINE.size, width=9.0, distance=1e4, polar=polar, azimuth=azimuth)
    x, y, height = 2.8, -0.7, 0.3
    shape = dot(x, y)
    low, high = (
        centroid(picture(coat("dot", h, shape), camera=camera)[..., 0]) for h in (0.0, height)
    )
    expected = pixel(x, y, height, camera) - pixel(x, y, 0.0, camera)
    if polar:
        assert np.linalg.norm(expected) > 1.5
    np.testing.assert_allclose(high - low, expected, atol=0.1)


def direction_in_chamber(polar, place):
    """Of light from polar angle `polar` towards +x that reaches a point: Snell at the sphere, the
    entry by repetition.
    """
    light = np.array([-np.sin(polar), 0.0, np.cos(polar)])
    aim = place[:2].copy()
    for _ in range(200):
        front = np.array([*aim, 7.8 - np.sqrt(7.8**2 - aim @ aim)])
        outwards = (front - np.array([0, 0, 7.8])) / 7.8
        cosine = -light @ outwards
        inside = np.sqrt(1 - (1 - cosine**2) / 1.376**2)
        bent = light / 1.376 + (cosine / 1.376 - inside) * outwards
        landing = front + bent * ((place[2] - front[2]) / bent[2])
        aim = aim + 0.5 * (place - landing)[:2]
    return bent


def test_shadows_fall_aside_from_the_lamp():
    x, y, height = 0.5, 3.0, 0.3
    base, faint = coat("base"), coat("dot", height, dot(x, y, 0.2, 0.02), BLACK)

    def shadow(polar):
        at, down = np.array([x, y]), height  # and on along the cone's fall under the shadow
        for _ in range(10):
            bent = direction_in_chamber(polar, np.array([*at, DEPTH + SLOPE * np.hypot(*at)]))
            at = np.array([x, y]) + bent[:2] / bent[2] * down
            down = height + SLOPE * (np.hypot(*at) - np.hypot(x, y))
        return at

    def seen(polar):
        lights = Lights.distant(polar, 0.0)
        lit, dotted = (
            picture(*c, lights=lights, camera=FINE)[..., 0] for c in ([base], [base, faint])
        )
        return centroid(np.where(lit > 0, 1 - dotted / np.where(lit > 0, lit, 1.0), 0.0))

    # The dot is small: the cornea draws wide shadows out unevenly. It is so faint that it and its shadow, each as dark, add up: half-way between the two.
    overhead, slanted = (pixel(*shadow(polar), 0.0, FINE) for polar in (0.0, 0.9))
    expected = (slanted - overhead) / 2
    assert abs(expected[0]) > 1.5
    np.testing.assert_allclose(seen(0.9) - seen(0.0), expected, atol=0.1)


def test_coats_near_each_other_are_lit_together(monkeypatch):
    shapes = [spots(seed) for seed in (5, 6, 7)]
    coats = [
        coat(str(i), 0.1 + 0.01 * i, shape, colour)
        for i, (shape, colour) in enumerate(zip(shapes, (RED, GREEN, BLUE), strict=True))
    ]
    together = picture(*coats)
    monkeypatch.setattr(integrator, "NEAR", -1.0)
    apart = picture(*coats)
    texel = 2 * LIMBUS / SIZE
    steepest = max(np.hypot(*np.gradient(s, texel)).max() for s in shapes)
    # Light and sight, 45° from the normal at most, cross paint 0.03 mm away that much aside of
    # each other, and the lowest coat has two above it. Light maps round by a texel's share.
    bound = 2 * steepest * (0.03 * 2) * picture(coat("white", 0.12)).max()
    assert 0 < np.abs(together - apart).max() < bound
