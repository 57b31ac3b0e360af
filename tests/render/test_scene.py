"""Pictures against the exact solver, hand-made optics and geometry; parts left out; derivatives;
precision.
"""

import dataclasses
from concurrent.futures import ThreadPoolExecutor

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import irisjax as ij
from common import operations
from irisjax.anatomy.eye import Cornea, Eye
from irisjax.anatomy.sclera import VeinMap
from irisjax.numerics.portions import in_portions, pixelwise
from irisjax.render import outside, shading, stages
from irisjax.render.bands import colour_bands
from irisjax.render.camera import Camera
from irisjax.render.compose import prepare, render
from irisjax.render.environment import Environment
from irisjax.render.illumination import Illumination
from irisjax.render.lights import Lights
from irisjax.render.project import iris_pixels, project
from irisjax.render.refraction import UNIQUE_POLAR
from irisjax.render.scene import Scene
from irisjax.render.sclera import colour_table
from irisjax.render.separable import Scales, Separable
from irisjax.render.stages import Memory, look
from irisjax.tissue.maps import IrisMaps, cell_centres
from render.tracing import trace

LIGHT = ij.Iris.of_level("low")
CLEAR = Cornea(scatter=None)
BARE, CLOSE = (
    Eye(cornea=None, sclera=None, pupil_radius=0.25),
    Eye(sclera=None, cornea=CLEAR, pupil_radius=0.25),
)
SMALL = Camera(size=(12, 9), width=11.0)
# A cheaper solver: the error of its quadrature is no matter of the picture's.
QUICK = Separable(degrees=(5, 4, 2, 2, 3), solver=ij.IlitExact(8))


def scene(eye=BARE, polar=0.0, azimuth=0.0, irradiance=np.pi, **parts):
    lights = parts.pop("lights", Lights.distant(polar, azimuth, irradiance))
    return Scene(
        parts.pop("iris", LIGHT),
        eye=eye,
        lights=lights,
        **{"camera": SMALL, "integrator": QUICK, **parts},
    )


def places(camera):
    """Points (x, y) of the plane through the pupil that the pixels of a camera straight ahead aim
    at, mm.
    """
    (w, h), pitch = camera.size, float(camera.width) / camera.size[0]
    return np.meshgrid((np.arange(w) + 0.5 - w / 2) * pitch, -(np.arange(h) + 0.5 - h / 2) * pitch)


def ring(height, radii=24, angles=48):
    """A map of (x, y) functions: values at texels of a 0.25 to 5.5 mm iris."""
    angle, radius = cell_centres((angles, radii))
    r = 0.25 + 5.25 * radius
    return height(r * jnp.cos(angle)[:, None], r * jnp.sin(angle)[:, None])


@pytest.mark.parametrize("polar", [0.0, 1.0])
def test_bare_uniform_iris_is_the_brdf(polar):
    """Every pixel: the solver's BRDF at 81 wavelengths × the irradiance of the slanting light."""
    from colour.difference import delta_E_CIE2000

    made = scene(polar=polar, azimuth=2.0, irradiance=2.0)
    picture = np.asarray(render(made))
    r = np.hypot(*places(SMALL))
    seen = (r > 0.25 + shading.PUPIL_MARGIN) & (r < 5.5)
    assert not picture[r > 5.5].any()
    exits = 250 / np.hypot(250, r[seen])
    x = np.arange(380.0, 781, 5)
    bands, irradiance = colour_bands(), 2.0 * np.cos(polar)
    found, at_bands = (
        ij.brdf(LIGHT, w, cos_incidence=np.cos(polar), cos_exit=exits, solver=QUICK.solver).values
        for w in (x, np.asarray(bands.wavelengths))
    )
    error = float(prepare(made).response(LIGHT).error)
    true = np.asarray(irradiance * bands.weights @ at_bands).T
    np.testing.assert_allclose(picture[seen], true, atol=2 * error * true.max())
    linear = jax.vmap(lambda s: ij.measure.colour.colour_of(x, s).srgb_linear)(irradiance * found.T)
    to_xyz = np.array(
        [[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]]
    )

    def lab(rgb):
        return jax.vmap(ij.measure.colour.lab_of)(
            jnp.asarray(np.asarray(rgb) @ to_xyz.T / to_xyz.sum(1))
        )

    assert delta_E_CIE2000(np.asarray(lab(picture[seen])), np.asarray(lab(linear))).max() < 0.5


def test_through_a_cornea(tables):
    """Light and camera on the axis: numpy's rays say what arrives, what leaves and where."""
    camera = Camera(size=(24, 18), width=11.0, distance=1e5)
    picture = np.asarray(render(scene(CLOSE, irradiance=2.0, camera=camera), tables))
    row, column = 7, 13  # near the axis, outside the pupil
    x, y = (float(c[row, column]) for c in places(camera))
    # Rays from far away run parallel to the axis: the same way for light and for sight.
    axis, r = np.array([0.0, 0.0, -1.0]), np.hypot(x, y)
    step = 1e-4
    at = trace(CLOSE, np.array([[r - step, 0], [r, 0], [r + step, 0]]), axis)
    landed = at.point[:, 0]
    concentration = r / landed[1] * (2 * step) / (landed[2] - landed[0])
    after, n = at.met[-1][2][1], 1.336
    cosine = after[2]
    irradiance = 2.0 * at.share[1] * concentration
    x81 = colour_bands().wavelengths
    brdf = ij.brdf(LIGHT, x81, cos_incidence=cosine, cos_exit=cosine, solver=QUICK.solver).values[
        :, 0
    ]
    expected = at.share[1] / n**2 * irradiance * np.asarray(colour_bands().weights @ brdf)
    mirrored = np.asarray(
        render(scene(CLOSE, irradiance=2.0, camera=camera, maps=NO_LIGHT_BACK), tables)
    )
    np.testing.assert_allclose((picture - mirrored)[row, column], expected, rtol=5e-3)


# A stroma under an ABL so full of melanin that next to nothing comes back: what is left is the tear
# film's mirror.
NO_LIGHT_BACK = IrisMaps(abl_depth=np.full((4, 4), 50.0))


@pytest.mark.parametrize("eye", [BARE, CLOSE], ids=["bare", "cornea"])
def test_mirrored_light_mirrored_picture(eye, tables):
    used = None if eye.cornea is None else tables
    right, left, up = (
        np.asarray(render(scene(eye, 0.7, a), used)) for a in (0.4, np.pi - 0.4, -0.4)
    )
    assert right.max() > 0
    np.testing.assert_allclose(left, right[:, ::-1], atol=1e-9)
    np.testing.assert_allclose(up, right[::-1], atol=1e-9)


def test_rows_run_down_and_columns_right():
    """A dome slopes outwards everywhere: light from the right is stronger on its right, from above
    at the top.
    """
    slope, polar = 0.2, 0.5
    dome = IrisMaps(relief=ring(lambda x, y: 1 - slope * jnp.hypot(x, y)) - 0.5)
    x, y = places(SMALL)
    inside = (np.hypot(x, y) > 1.0) & (np.hypot(x, y) < 5.0)
    flat = np.asarray(render(scene(polar=polar)))
    for azimuth, along in ((0.0, x), (np.pi / 2, y), (np.pi, -x)):
        picture = np.asarray(render(scene(polar=polar, azimuth=azimuth, maps=dome)))[inside]
        tilt = slope * along / np.hypot(x, y)
        expected = (np.cos(polar) + tilt * np.sin(polar)) / np.cos(polar) / np.hypot(1, slope)
        np.testing.assert_allclose((picture / flat[inside])[:, 1], expected[inside], rtol=2e-3)


def test_maps_lie_where_they_are_drawn():
    """Dark above and right, in the eye's frame: the viewer sees it above and right."""
    corner = IrisMaps(eumelanin=ring(lambda x, y: 1 + 5.0 * ((x > 0) & (y > 0))))
    picture = np.asarray(render(scene(maps=corner)))[..., 1]
    six = ij.Iris.of_level("low").replace(eumelanin=6 * float(LIGHT.eumelanin))
    light, dark = (np.asarray(render(scene(iris=i)))[..., 1] for i in (LIGHT, six))
    x, y = places(SMALL)
    seen = (np.hypot(x, y) < 5) & (np.hypot(x, y) > 1) & (np.minimum(abs(x), abs(y)) > 0.3)
    np.testing.assert_allclose(
        picture[seen], np.where((x > 0) & (y > 0), dark, light)[seen], rtol=1e-2
    )
    assert (dark[seen] < 0.8 * light[seen]).all()
    # From the right the camera sees the right half wider, its own left and right as they were.
    turned = np.asarray(
        render(scene(maps=corner, camera=Camera(polar=0.6, size=(12, 9), width=11.0)))
    )[..., 1]
    assert turned[1:4, 7:9].mean() < 0.8 * turned[1:4, 3:5].mean()


def test_cornea_of_air_is_no_cornea():
    air = CLOSE.replace(cornea=Cornea(index=1.0, scatter=None), aqueous_index=1.0)
    made = Illumination.build(air, caustics=False, size=65)
    x, y = places(SMALL)
    inside = np.hypot(x, y) < 4.5  # slanting light reaches the rest from beyond the limbus
    pictures = [
        np.asarray(render(scene(eye, 0.3, 1.0), t))[inside]
        for eye, t in ((air, made), (BARE.replace(aqueous_index=1.0), None))
    ]
    np.testing.assert_allclose(*pictures, rtol=2e-3, atol=1e-6)


EXTREMES = {
    "light behind": (CLOSE, {"polar": 3.0}),
    "light across": (CLOSE, {"polar": np.pi / 2}),
    "camera across": (CLOSE, {"camera": Camera(polar=1.55, size=(12, 9))}),
    "camera behind": (CLOSE, {"camera": Camera(polar=3.1, size=(12, 9))}),
    "camera above": (CLOSE, {"camera": Camera(polar=np.pi / 2, azimuth=np.pi / 2, size=(12, 9))}),
    "pupil 1 mm": (CLOSE.replace(pupil_radius=0.5), {}),
    "pupil 9 mm": (CLOSE.replace(pupil_radius=4.5), {}),
    "sclera": (Eye(cornea=CLEAR), {"polar": 1.3, "camera": Camera(size=(12, 9), width=30.0)}),
    "one pixel": (CLOSE, {"camera": Camera(size=(1, 1), width=8.0)}),
    "bare, light behind": (BARE, {"polar": 3.0}),
    "bare, camera across": (BARE, {"polar": 1.5, "camera": Camera(polar=1.5, size=(12, 9))}),
}


@pytest.mark.parametrize("name", EXTREMES)
def test_extremes_are_finite_and_no_darker_than_black(name, tables):
    eye, options = EXTREMES[name]
    made = scene(eye, **options)
    picture = np.asarray(render(made, None if eye.cornea is None else tables))
    width, height = made.camera.size
    assert picture.shape == (height, width, 3)
    assert np.isfinite(picture).all()
    # Colours out of sRGB's gamut may be negative in red, never in luminance.
    assert (picture @ [0.2126, 0.7152, 0.0722] >= -1e-12).all()
    if "behind" in name and eye.sclera is None:
        assert not picture.any()


def test_no_pigment_at_all():
    clear = {
        "eumelanin": 0.0,
        "pheomelanin": 0.0,
        "oxyhemoglobin": 0.0,
        "deoxyhemoglobin": 0.0,
        "lutein": 0.0,
    }
    holes = IrisMaps(abl_depth=np.zeros((4, 4)), stroma_depth=np.zeros((4, 4)))
    for maps in (None, holes):
        stage = prepare(scene(maps=maps))
        picture = np.asarray(stage(LIGHT.replace(**clear, zeaxanthin=0.0)))
        assert np.isfinite(picture).all() and (picture > -1e-3).all()


def test_stage_serves_other_pigments(tables):
    dark = LIGHT.replace(eumelanin=3.0)
    made = scene(CLOSE, 0.6, 2.0)
    np.testing.assert_allclose(
        prepare(made, tables)(dark), render(made.replace(iris=dark), tables), atol=1e-12
    )


def test_lights_add_up(tables):
    one, two = Lights.distant(0.6, 2.0, 1.5), Lights.points([20.0, -10.0, -60.0], 2.5)
    pictures = [
        np.asarray(render(scene(CLOSE, lights=which), tables)) for which in (one + two, one, two)
    ]
    np.testing.assert_allclose(pictures[0], pictures[1] + pictures[2], atol=1e-9)


def test_scenes_that_make_no_sense_are_named():
    with pytest.raises(ValueError, match="needs lights or an environment"):
        Scene(LIGHT, lights=None)
    with pytest.raises(ValueError, match="the lights are A, the scene is D65"):
        Scene(LIGHT, lights=Lights.distant(0.1, 0.2, illuminant="A"))
    for size in ((0, 5), (5, 20000)):
        with pytest.raises(ValueError, match="camera size"):
            Camera(size=size)


def test_tables_are_made_for_what_is_asked(monkeypatch):
    """Rays are counted where a light grazes the cornea, tables made where there is one."""
    built = []
    monkeypatch.setattr(Illumination, "build", lambda eye, caustics: built.append(caustics))
    for eye, polar in ((BARE, 1.0), (CLOSE, UNIQUE_POLAR - 0.01), (CLOSE, UNIQUE_POLAR + 0.01)):
        scene(eye, polar).tables()
    assert built == [False, True]


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


def test_threads_change_no_bit(tables):
    """A picture large enough for threads, by one, two and three."""
    maps = IrisMaps(stroma_depth=ring(lambda x, y: 0.3 + 0.02 * x))
    made = scene(maps=maps, eye=CLOSE, camera=dataclasses.replace(SMALL, size=(200, 150)))
    pictures = [np.asarray(Memory(threads).render(made, tables)) for threads in (1, 2, 3)]
    assert look(CLOSE, made.camera).iris.index.size > 1 << 14
    np.testing.assert_array_equal(pictures[1], pictures[0])
    np.testing.assert_array_equal(pictures[2], pictures[0])


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


def brightness(tables, view, bands, ranges):
    """Mean of a picture as a function of all that one may want derivatives in."""

    def of(iris, lights, maps):
        texels, _ = QUICK.place(view.iris, lights, CLOSE, iris, maps, tables, ranges)
        found = QUICK.response(iris, CLOSE.aqueous_index, bands, ranges).shade(texels, None)
        weight = jnp.cos(jnp.arange(found.size)).reshape(
            found.shape
        )  # no symmetry hides a derivative
        return (found * (1 + weight)).sum()

    return of


def test_a_pixel_that_looks_at_the_middle(tables):
    """Odd sizes have one; a relief has no slope there, and the pupil no light."""
    maps = IrisMaps(relief=ring(lambda x, y: 0.01 * y))
    picture = np.asarray(
        render(scene(maps=maps, eye=CLOSE, camera=Camera(size=(13, 9), width=11.0)), tables)
    )
    assert np.isfinite(picture).all()


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

    found = np.asarray(jax.jit(jax.grad(by))(jnp.zeros(5)))
    value, step = jax.jit(by), 1e-6
    true = [float(value(step * e) - value(-step * e)) / (2 * step) for e in jnp.eye(5)]
    assert (np.abs(found) > 1e-6).all()
    np.testing.assert_allclose(found, true, rtol=1e-5)


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


def test_gradient_of_a_stage():
    """What a fit does: the picture's derivative by pigments, through the public stage."""
    stage = prepare(scene())

    def mean(eumelanin):
        return stage(eqx.tree_at(lambda i: i.eumelanin, LIGHT, eumelanin)).mean()

    slope = float(jax.grad(mean)(LIGHT.eumelanin))
    assert slope < 0
    assert slope == pytest.approx(
        float(mean(LIGHT.eumelanin + 1e-5) - mean(LIGHT.eumelanin - 1e-5)) / 2e-5, rel=1e-5
    )


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
            return np.asarray(render(made, cast))

    coarse, fine = picture(False), picture(True)
    assert (fine.dtype, coarse.dtype) == (np.float64, np.float32)
    np.testing.assert_allclose(coarse, fine, rtol=1e-5, atol=1e-4)  # rtol: a highlight is 23


def test_all_pixels_or_those_that_see(tables):
    """`project` has every pixel for every part, `look` sorts them on the host: one picture."""
    eye = Eye(cornea=CLEAR)
    made = scene(eye, camera=Camera(0.9, 0.3, size=(24, 18), width=26.0))
    every, some = project(eye, made.camera), look(eye, made.camera)
    assert every.iris.index is every.sclera.index is every.mirror.index is None
    assert some.iris.index is not None and all(
        map(np.isfinite, map(np.sum, jax.tree.leaves(every)))
    )
    pictures = (prepare(made, tables, view)(LIGHT) for view in (every, some))
    np.testing.assert_allclose(*pictures, atol=1e-12)
