"""Derivatives of pictures against finite differences; single precision."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import irisjax as ij
from common import quick_jit
from irisjax.anatomy.eye import Cornea, Eye
from irisjax.render.bands import colour_bands
from irisjax.render.camera import Camera
from irisjax.render.lights import Lights
from irisjax.render.picture import draw
from irisjax.render.project import look
from irisjax.render.scene import Scene
from irisjax.render.separable import Separable
from irisjax.render.shading import Front
from irisjax.tissue.maps import IrisMaps, Scales
from render.small_scenes import CLOSE, LIGHT, QUICK, SMALL, ring


def brightness(tables, view, bands, ranges):
    """Mean of a picture as a function of all that one may want derivatives in."""

    def of(iris, lights, maps):
        front = Front(CLOSE, iris, maps)
        texels = QUICK.texels(view.iris, front, ranges)
        light = QUICK.illuminate(view.iris, lights, front, tables)
        response = QUICK.response(iris, CLOSE.aqueous_index, bands, ranges)
        found = response.shade(view.iris, texels, light)
        weight = jnp.cos(jnp.arange(found.size)).reshape(
            found.shape
        )  # no symmetry hides a derivative
        return (found * (1 + weight)).sum()

    return of


@pytest.mark.slow  # half a minute of compiling
def test_derivatives_are_finite_differences(tables):
    maps = IrisMaps(
        stroma_depth=ring(lambda x, y: 0.28 + 0.1 * jnp.sin(3 * x) * jnp.cos(2 * y), 6, 12)
    )
    direction = jnp.asarray(np.random.default_rng(1).normal(size=maps.shape))
    ranges = Scales(stroma=(0.3, 2.0))
    of = brightness(tables, look(CLOSE, SMALL), colour_bands(), ranges)

    def by(
        p,
    ):  # eumelanin, thickness along a direction, irradiance, polar angle, azimuth of the light
        iris = eqx.tree_at(lambda i: i.eumelanin, LIGHT, LIGHT.eumelanin + p[0])
        lights = Lights.distant(0.613 + p[3], 1.234 + p[4], 2.0 + p[2])
        changed = eqx.tree_at(lambda m: m.stroma_depth, maps, maps.stroma_depth + p[1] * direction)
        return of(iris, lights, changed)

    found = np.asarray(quick_jit(jax.grad(by))(jnp.zeros(5)))
    value, step = quick_jit(by), 1e-6
    true = [float(value(step * e) - value(-step * e)) / (2 * step) for e in jnp.eye(5)]
    assert (np.abs(found) > 1e-6).all()
    np.testing.assert_allclose(found, true, rtol=1e-5)


@pytest.mark.slow  # half a minute of compiling
def test_single_precision(tables):
    def picture(x64):
        with jax.enable_x64(x64):
            cast = jax.tree.map(lambda x: jnp.asarray(np.asarray(x), float), tables)
            maps = IrisMaps(stroma_depth=ring(lambda x, y: 0.28 + 0.1 * jnp.sin(3 * x)))
            eye = Eye(sclera=None, cornea=Cornea(scatter=None), pupil_radius=0.25)
            made = Scene(
                ij.Iris.of_level("low"), maps, eye, Lights.distant(0.6, 2.0), camera=Camera(size=(24, 18)),
                integrator=Separable(degrees=(5, 4, 2, 2, 3), solver=ij.IlitExact(8)),
            )  # fmt: skip
            return np.asarray(draw(made, cast))

    coarse, fine = picture(False), picture(True)
    assert (fine.dtype, coarse.dtype) == (np.float64, np.float32)
    np.testing.assert_allclose(coarse, fine, rtol=1e-5, atol=1e-4)  # rtol: a highlight is 23
