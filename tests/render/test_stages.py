"""Parts left out, values kept between pictures, chunks and threads."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from common import counting, operations
from irisjax.anatomy.eye import Eye
from irisjax.anatomy.sclera import VeinMap
from irisjax.numerics.chunks import map_chunks, pixelwise
from irisjax.render import outside, shading
from irisjax.render.bands import colour_bands
from irisjax.render.camera import Camera
from irisjax.render.environment import Environment
from irisjax.render.illumination import Illumination
from irisjax.render.lights import Lights
from irisjax.render.outside import colour_table
from irisjax.render.picture import draw, illuminate, respond, shade, texture
from irisjax.render.project import project, project_visible, trace_iris
from irisjax.render.refraction import UNIQUE_POLAR
from irisjax.tissue.maps import IrisMaps, Scales
from render.small_scenes import BARE, CLEAR, CLOSE, LIGHT, QUICK, SMALL, maps_of, ring, scene


def test_tables_are_made_for_what_is_asked(monkeypatch):
    """Rays are counted where a light grazes the cornea, tables made where there is one."""
    built = []
    monkeypatch.setattr(Illumination, "build", lambda eye, caustics: built.append(caustics))
    for eye, polar in ((BARE, 1.0), (CLOSE, UNIQUE_POLAR - 0.01), (CLOSE, UNIQUE_POLAR + 0.01)):
        scene(eye, polar).tables()
    assert built == [False, True]


def each_costs_more(*programs):
    """Each program has more operations than the one before."""
    counts = [operations(program) for program in programs]
    assert counts == sorted(set(counts)), counts


@pytest.mark.peer
def test_absent_parts_cost_nothing(tables):
    pixels, one = project_visible(CLOSE, SMALL).iris, np.ones((8, 6))
    lamp = Lights.distant(0.5, 1.0)
    tinted = dataclasses.replace(lamp, tint=jnp.ones((1, 3)))

    def lit(**maps):
        maps = IrisMaps(**maps) if maps else None
        model = shading.IrisModel(CLOSE, LIGHT, maps)
        texels = QUICK.texels(pixels, model, Scales.of(maps, LIGHT).ranges())
        return texels, QUICK.illuminate(pixels, lamp, model, tables, model.facing(pixels))

    maps = {"stroma_depth": one, "freckles": 0 * one, "relief": 0 * one, "eumelanin": one}
    given = [dict(list(maps.items())[:count]) for count in range(len(maps) + 1)]
    each_costs_more(*(lambda m=m: lit(**m) for m in given))

    def brdf(ranges, scales):
        respond_to = eqx.filter_jit(QUICK.response)
        response = respond_to(LIGHT, CLOSE.aqueous_index, colour_bands(), ranges)
        return response.brdf(scales, jnp.ones(2), jnp.ones(2), jnp.ones(2))

    # The polynomials of a scale that does not vary are not there.
    each_costs_more(
        lambda: brdf(Scales(), Scales()),
        lambda: brdf(Scales(abl=jnp.array([0.5, 2.0])), Scales(abl=jnp.ones(2))),
    )

    def entering(lights, eye, tables):
        return shading.entering_flux(lights, eye, LIGHT, tables)

    each_costs_more(lambda: entering(lamp, BARE, None), lambda: entering(lamp, CLOSE, tables))
    assert [len(entering(lights, CLOSE, tables)) for lights in (lamp, tinted)] == [1, 3]
    eyes = BARE, CLOSE, Eye(cornea=CLEAR)
    each_costs_more(*(lambda e=e: trace_iris(jnp.arange(9), e, SMALL) for e in eyes))
    view = project_visible(Eye(), SMALL)
    room = outside.mirrored_environment(view.mirror, Environment(jnp.ones((4, 8, 3))))
    table = colour_table(Eye().sclera, np.array([450.0, 600.0]), np.ones((3, 2)))
    drawn = VeinMap(*(jnp.zeros((4, 4)) for _ in range(3)))
    each_costs_more(
        lambda: outside.tear_film_radiance((view.mirror, None), lamp, jnp.ones(3)),
        lambda: outside.tear_film_radiance((view.mirror, room), lamp, jnp.ones(3)),
    )
    each_costs_more(
        lambda: outside.sclera_base_colour(view.sclera, Eye(), table, None),
        lambda: outside.sclera_base_colour(view.sclera, Eye(), table, drawn),
    )
    assert project_visible(BARE, SMALL).mirror is project_visible(CLOSE, SMALL).sclera is None


def test_pictures_drawn_once_share_programs(monkeypatch):
    """Pictures of any size and from anywhere do, and their pixels see what they see otherwise."""
    traced = counting(monkeypatch, rays=Camera)
    cameras = Camera(width=12.0, size=(60, 50)), Camera(0.3, 1.0, width=11.0, size=SMALL.size)
    second = [project_visible(CLOSE, camera, once=True) for camera in cameras][1]
    count = traced["rays"]
    project_visible(CLOSE, Camera(0.1, size=(41, 63)), once=True)
    assert traced["rays"] == count > 0
    expected = project_visible(CLOSE, cameras[1])
    for name in ("iris", "mirror"):
        found, same = (getattr(view, name) for view in (second, expected))
        for one, other in zip(jax.tree.leaves(found), jax.tree.leaves(same), strict=True):
            seen = np.asarray(found.index) >= 0
            np.testing.assert_allclose(one[seen], other[np.asarray(same.index) >= 0], atol=1e-6)


@pytest.mark.parametrize(
    ("change", "kept"),
    [
        ({"iris": LIGHT.replace(eumelanin=1.5)}, {"view", "texels", "light"}),
        ({"lights": Lights.distant(0.4, 2.0)}, {"view", "texels", "response"}),
        ({"camera": dataclasses.replace(SMALL, polar=jnp.asarray(0.2))}, {"response"}),
        ({"maps": maps_of(stroma_depth=0.25)}, {"view"}),
    ],
    ids=["pigments", "lights", "camera", "maps"],
)
def test_values_that_a_change_leaves_alone_are_kept(change, kept):
    """The picture of the old values and the new ones is that of the changed scene."""
    before = scene(maps=maps_of(stroma_depth=ring(lambda x, y: 0.3 + 0.02 * x)))
    made = before.replace(**change)
    seen = before if "view" in kept else made
    view = project(seen.eye, seen.camera)
    texels = texture(view, before if "texels" in kept else made)
    light = illuminate(view, texels, before if "light" in kept else made)
    response = respond(before if "response" in kept else made)
    found = shade(view, texels, light, response)
    np.testing.assert_allclose(found, draw(made), atol=1e-12)


def test_threads_change_no_bit(monkeypatch):
    """Pixels enough for threads, shared by one, two and four."""

    @pixelwise
    def wave(x, factor):
        return jnp.stack([jnp.sin(factor * x), x * x])

    x, found = jnp.asarray(np.linspace(0.0, 9.0, (1 << 14) + 100)), []
    for cores in (1, 2, 4):
        monkeypatch.setattr("os.sched_getaffinity", lambda _, n=cores: range(n), raising=False)
        found.append(np.asarray(wave(x, 2.0)))
    np.testing.assert_array_equal(found[1], found[0])
    np.testing.assert_array_equal(found[2], found[0])


def test_chunks_change_nothing():
    """Small ones, as on a processor, or all pixels at once, as on an accelerator."""
    x = np.linspace(0.0, 9.0, 1000)

    @jax.jit
    def both(x):
        def chunked(x):
            return map_chunks(lambda x: jnp.stack([jnp.sin(x), x * x]), x)

        return chunked(x), jax.grad(lambda x: chunked(x).sum())(x)

    found, slope = both(x)
    np.testing.assert_allclose(found, [np.sin(x), x * x], rtol=1e-14)
    np.testing.assert_allclose(slope, np.cos(x) + 2 * x, rtol=1e-12)


def test_settings_of_this_thread_hold_for_all_pixels(bits, monkeypatch):
    """The other precision, chosen by a `with`: threads that do not know of it would compute in
    theirs.
    """

    @pixelwise
    def third(x):
        return jnp.asarray(x, float) / 3

    monkeypatch.setattr("os.sched_getaffinity", lambda _: range(2), raising=False)
    with jax.enable_x64(bits == 32):
        found = third(jnp.arange(1 << 15))
        assert found.dtype == jnp.result_type(float) == jnp.dtype(f"float{96 - bits}")


def test_new_maps_are_not_compiled_for_again():
    """Whatever is compiled for a scene."""
    calls = []
    compiled = eqx.filter_jit(lambda made: calls.append(1) or made.maps)
    for thick in (0.2, 0.3):
        compiled(scene(maps=maps_of(stroma_depth=thick)))
    assert len(calls) == 1
