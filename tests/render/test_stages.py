"""Parts left out, what is kept between pictures, portions and threads."""

import dataclasses
from concurrent.futures import ThreadPoolExecutor

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from common import operations
from irisjax.anatomy.eye import Eye
from irisjax.anatomy.sclera import VeinMap
from irisjax.numerics.portions import in_portions, pixelwise
from irisjax.render import outside, shading, stages
from irisjax.render.bands import colour_bands
from irisjax.render.compose import prepare, render
from irisjax.render.environment import Environment
from irisjax.render.illumination import Illumination
from irisjax.render.lights import Lights
from irisjax.render.project import iris_pixels
from irisjax.render.refraction import UNIQUE_POLAR
from irisjax.render.sclera import colour_table
from irisjax.render.separable import Scales
from irisjax.render.stages import Memory, look
from irisjax.tissue.maps import IrisMaps
from render.small_scenes import BARE, CLEAR, CLOSE, LIGHT, QUICK, SMALL, ring, scene


@pytest.mark.heavy
def test_stage_serves_other_pigments(tables):
    dark = LIGHT.replace(eumelanin=3.0)
    made = scene(CLOSE, 0.6, 2.0)
    np.testing.assert_allclose(
        prepare(made, tables)(dark), render(made.replace(iris=dark), tables), atol=1e-12
    )


def test_tables_are_made_for_what_is_asked(monkeypatch):
    """Rays are counted where a light grazes the cornea, tables made where there is one."""
    built = []
    monkeypatch.setattr(Illumination, "build", lambda eye, caustics: built.append(caustics))
    for eye, polar in ((BARE, 1.0), (CLOSE, UNIQUE_POLAR - 0.01), (CLOSE, UNIQUE_POLAR + 0.01)):
        scene(eye, polar).tables()
    assert built == [False, True]


@pytest.mark.slow  # 20 s of compiling
def test_absent_parts_cost_nothing(tables):
    eye, iris = CLOSE, LIGHT
    pixels = look(eye, SMALL).iris
    one = np.ones((8, 6))
    maps = {
        "none": None,
        "stroma": IrisMaps(stroma_depth=one),
        "freckles": IrisMaps(stroma_depth=one, freckles=0 * one),
        "relief": IrisMaps(stroma_depth=one, freckles=0 * one, relief=0 * one),
        "pigment": IrisMaps(stroma_depth=one, freckles=0 * one, relief=0 * one, eumelanin=one),
    }
    lamp, tinted = (
        Lights.distant(0.5, 1.0),
        Lights(jnp.array([[0, 0, -1.0]]), jnp.ones(1), jnp.ones((1, 3))),
    )
    counts = [
        operations(
            lambda m=m: QUICK.place(
                pixels, lamp, eye, iris, m, tables, Scales.of(m, iris).ranges()
            )[0]
        )
        for m in maps.values()
    ]
    assert counts == sorted(set(counts)), dict(zip(maps, counts, strict=True))
    # The polynomials of a scale that does not vary are not there.
    responses = [
        operations(
            lambda r=r, s=s: eqx.filter_jit(QUICK.response)(
                iris, eye.aqueous_index, colour_bands(), r
            )(s, jnp.ones(2))
        )
        for r, s in ((Scales(), Scales()), (Scales(abl=(0.5, 2.0)), Scales(abl=jnp.ones(2))))
    ]
    assert responses[0] < responses[1]

    def light(lights, eye, tables):
        return operations(lambda: shading.illuminate(lights, eye, iris, tables))

    assert light(lamp, BARE, None) < light(lamp, eye, tables)
    assert shading.illuminate(lamp, eye, iris, tables).flux.shape[0] == 1
    assert shading.illuminate(tinted, eye, iris, tables).flux.shape[0] == 3
    sight = [
        operations(lambda e=e: iris_pixels(jnp.arange(9), e, SMALL))
        for e in (BARE, CLOSE, Eye(cornea=CLEAR))
    ]
    assert sight == sorted(set(sight))
    view = look(Eye(), SMALL)
    room = outside.room_at(view.mirror, Environment(jnp.ones((4, 8, 3))))
    mirrors = [
        operations(lambda r=r: outside.mirrored((view.mirror, None, r), lamp, jnp.ones(3)))
        for r in (None, room)
    ]
    table = colour_table(Eye().sclera, np.array([450.0, 600.0]), np.ones((3, 2)))
    drawn = VeinMap(*(jnp.zeros((4, 4)) for _ in range(3)))
    whites = [
        operations(lambda v=v: outside.white_colour(view.sclera, Eye(), table, v))
        for v in (None, drawn)
    ]
    assert mirrors[0] < mirrors[1] and whites[0] < whites[1]
    assert look(BARE, SMALL).mirror is None and look(CLOSE, SMALL).sclera is None


@pytest.mark.slow  # a minute of compiling
def test_only_what_changed_is_made_again(tables):
    """Pictures of a scene that changes, with and without a memory of the one before."""
    maps = IrisMaps(
        stroma_depth=ring(lambda x, y: 0.3 + 0.02 * x), relief=ring(lambda x, y: 0.01 * y)
    )
    made = scene(maps=maps, eye=Eye(), veins=VeinMap(*(jnp.full((4, 4), 0.1) for _ in range(3))))
    memory = Memory()
    tables = made.tables()
    first = memory.prepare(made, tables)
    changes = {
        "lights": {"lights": Lights.distant([0.4, 0.9], [2.0, 0.1])},
        "maps": {"maps": maps.replace(stroma_depth=ring(lambda x, y: 0.2 - 0.02 * y))},
        "camera": {"camera": dataclasses.replace(SMALL, polar=jnp.asarray(0.2))},
        "pupil": {"eye": made.eye.replace(pupil_radius=2.5)},
        "veins": {"veins": None},
        "environment": {"environment": Environment(jnp.ones((4, 8, 3))), "environment_lights": 2},
    }
    for name, change in changes.items():
        after = made.replace(**change)
        again = memory.prepare(after, tables)
        np.testing.assert_allclose(again(LIGHT), prepare(after, tables)(LIGHT), atol=1e-12)
        if name == "lights":
            assert again.texels.terms.scales[0] is first.texels.terms.scales[0]
            assert again.base is not first.base
        if name == "maps":
            assert again.base is memory.prepare(after, tables).base
    back = memory.prepare(made, tables)
    np.testing.assert_array_equal(back(LIGHT), first(LIGHT))


@pytest.mark.slow
def test_pictures_with_a_memory(monkeypatch, tables):
    """Equal to those without, and the response is made again for other pigments only."""
    made = scene(maps=IrisMaps(stroma_depth=ring(lambda x, y: 0.3 + 0.02 * x)), eye=CLOSE)
    changes = (
        {"lights": Lights.distant([0.4, 0.9], [2.0, 0.1])},
        {"camera": dataclasses.replace(SMALL, polar=jnp.asarray(0.2))},
        {"iris": LIGHT.replace(eumelanin=1.5)},
    )
    every = [made, *(made.replace(**change) for change in changes)]
    fresh = [render(one, tables) for one in every]
    calls, respond = [], stages.respond
    monkeypatch.setattr(stages, "respond", lambda *a: calls.append(a) or respond(*a))
    memory = Memory()
    for one, picture in zip(every, fresh, strict=True):
        np.testing.assert_allclose(memory.render(one, tables), picture, atol=1e-12)
    assert len(calls) == 2


@pytest.mark.slow  # half a minute of compiling
def test_threads_change_no_bit(tables):
    """A picture large enough for threads, by one, two and three."""
    maps = IrisMaps(stroma_depth=ring(lambda x, y: 0.3 + 0.02 * x))
    made = scene(maps=maps, eye=CLOSE, camera=dataclasses.replace(SMALL, size=(200, 150)))
    pictures = [np.asarray(Memory(threads).render(made, tables)) for threads in (1, 2, 3)]
    assert look(CLOSE, made.camera).iris.index.size > 1 << 14
    np.testing.assert_array_equal(pictures[1], pictures[0])
    np.testing.assert_array_equal(pictures[2], pictures[0])


@pytest.mark.heavy
def test_portions_change_nothing():
    """Small ones, as on a processor, or all pixels at once, as on an accelerator."""
    x = jnp.linspace(0.0, 9.0, 1000)

    def f(x):
        return jnp.stack([jnp.sin(x), jnp.cumsum(jnp.ones_like(x)) * 0 + x * x])

    np.testing.assert_allclose(in_portions(f, x), f(x), rtol=1e-14)
    slope = jax.grad(lambda x: in_portions(f, x).sum())(x)
    np.testing.assert_allclose(slope, jnp.cos(x) + 2 * x, rtol=1e-12)


def test_settings_of_this_thread_hold_for_all_pixels(bits):
    """The other precision, chosen by a `with`: threads that do not know of it would compute in
    theirs.
    """

    @pixelwise
    def third(x):
        return jnp.asarray(x, float) / 3

    with ThreadPoolExecutor(2) as pool, jax.enable_x64(bits == 32):
        found = third.on_threads(pool, 2, jnp.arange(1 << 15))
        assert found.dtype == jnp.result_type(float) == jnp.dtype(f"float{96 - bits}")


def test_new_maps_are_not_compiled_for_again():
    calls = []

    @eqx.filter_jit
    def picture(stage):
        calls.append(1)
        return stage(LIGHT)

    for thick in (0.2, 0.3):
        maps = IrisMaps(stroma_depth=ring(lambda x, y, t=thick: t + 0.01 * x))
        picture(prepare(scene(maps=maps)))
    assert len(calls) == 1
