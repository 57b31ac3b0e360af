"""Texel to pixel and back."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from irisjax.anatomy.eye import Eye
from irisjax.render.camera import Camera
from irisjax.render.points import project_points
from irisjax.render.project import trace_iris, trace_sclera
from irisjax.render.surfaces import GlobeSurface, IrisSurface

SIZE = (16, 12)
INDEX = np.arange(SIZE[0] * SIZE[1], dtype=np.int32)
ROW, COLUMN = np.divmod(INDEX, SIZE[0])
# Programs for all cameras of an eye.
there = jax.jit(
    lambda eye, camera: (trace_iris(INDEX, eye, camera), trace_sclera(INDEX, eye, camera))
)
back = jax.jit(lambda eye, camera, point: project_points(IrisSurface(eye), camera, point))
on_globe = jax.jit(lambda eye, camera, point: project_points(GlobeSurface(eye), camera, point))


def filled(*points):
    """Points, the last one repeated: as many as a picture has pixels, for the same programs."""
    return jnp.asarray([*points, *[points[-1]] * (SIZE[0] * SIZE[1] - len(points))])


def appear_there(found, seen, atol=1e-6):
    assert np.asarray(found.visible)[seen].all()
    for of, expected in ((found.column, COLUMN), (found.row, ROW)):
        np.testing.assert_allclose(np.asarray(of)[seen], expected[: len(seen)][seen], atol=atol)


@pytest.mark.parametrize(("polar", "distance"), [(0.0, 250.0), (0.6, 60.0), (1.2, 1e4)])
def test_pixels_return(polar, distance):
    """A pixel's point of the iris and of the white appears in that pixel."""
    eye, camera = Eye(), Camera(polar, 0.8, distance, 24.0, SIZE)
    iris, sclera = there(eye, camera)
    seen, white = np.asarray(iris.share) > 1e-3, np.asarray(sclera.share) == 1
    assert seen.sum() > 15 and white.sum() > 20
    appear_there(back(eye, camera, np.stack(iris.point, -1)), seen)
    appear_there(on_globe(eye, camera, np.stack(sclera.point, -1)), white)


def test_without_a_cornea_and_in_a_part_of_the_picture():
    """Straight lines; rows are counted from the part's first."""
    eye = Eye(cornea=None, iris_slope=0.2)
    camera = Camera(0.5, 2.0, 90.0, 16.0, SIZE).crop_rows(3, 6)
    seen = trace_iris(INDEX[: 6 * SIZE[0]], eye, camera)
    found = back(eye, camera, np.stack(seen.point, -1))
    appear_there(found, np.asarray(seen.share) > 0, 1e-9)


def test_what_is_turned_away_is_not_visible():
    """The far side of the globe, and an iris seen from the side and from behind."""
    eye, point = Eye(), filled([-4.0, 0.0, 3.6], [4.0, 0.0, 3.6])
    aside, ahead, behind = (Camera(polar, size=SIZE) for polar in (1.5, 0.3, 3.0))
    assert not on_globe(eye, aside, filled([-11.0, 0.0, 12.0])).visible[0]
    assert back(eye, ahead, point).visible.all()
    assert not back(eye, behind, point).visible.any()


def test_magnified_by_the_cornea():
    """Paraxially, by the vergence on either side of both surfaces."""
    eye, cornea = Eye(), Eye().cornea
    found = back(eye, Camera(distance=1e5, size=SIZE), filled([1e-3, 0.0, 3.6], [0.0, 1e-3, 3.6]))
    depth, aqueous, index = float(cornea.posterior.apex), float(eye.aqueous_index), cornea.index
    inner = -aqueous / (3.6 - depth)
    middle = inner + (aqueous - index) / cornea.posterior.radius
    outer = -index / (depth - index / middle)
    magnified = inner / middle * outer / (outer + (index - 1) / cornea.anterior.radius)
    x = (np.asarray(found.column)[0] - SIZE[0] / 2 + 0.5) * 15 / SIZE[0]
    assert x / 1e-3 == pytest.approx(float(magnified), rel=1e-4)
