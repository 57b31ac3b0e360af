"""The meshes of the eye in Mitsuba 3: what a camera sees of the iris, how light falls on it."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from common import slowly
from irisjax.anatomy.eye import Eye
from irisjax.export.mesh import eye_meshes, mesh_files
from irisjax.optics.conicoid import norm
from irisjax.render.illumination import trace_flux
from irisjax.render.refraction import find_arrival, refract_to_iris
from render.tracing import towards

pytestmark = pytest.mark.peer
mi = pytest.importorskip("mitsuba", reason="Mitsuba is not installed (pip install mitsuba)")

DEPTH, ROOT, PUPIL = 3.6, 5.5, 1.9
EYE = Eye()


@pytest.fixture(scope="module", autouse=True)
def _variant():
    mi.set_variant("scalar_rgb")  # needs no LLVM
    mi.set_log_level(mi.LogLevel.Warn)


@pytest.fixture(scope="module")
def cornea(tmp_path_factory):
    """Both surfaces at 0.1 mm, as shapes of a scene, and the iris's file."""
    folder = tmp_path_factory.mktemp("eye")
    for name, data in mesh_files(eye_meshes(EYE.replace(sclera=None), 0.1)).items():
        (folder / name).write_bytes(data)
    media = {"anterior": (1.3771, 1.0), "posterior": (1.336, 1.3771)}
    shapes = {
        name: {
            "type": "ply",
            "filename": str(folder / f"{name}.ply"),
            "bsdf": {"type": "dielectric", "int_ior": inside, "ext_ior": outside},
        }
        for name, (inside, outside) in media.items()
    }
    return shapes, str(folder / "iris.ply")


def _colour(value):
    return {"type": "rgb", "value": value}


def _film(size, **options):
    return {"type": "hdrfilm", "width": size, "height": size, "rfilter": {"type": "box"}, **options}


def _seen(cornea, size, first, last, samples):
    """Points (x, y) of the iris in pixels `first` to `last` of `size` both ways, Mitsuba's and
    ours; which to compare.
    """
    shapes, iris = cornea
    # The iris glows with its own coordinates, written into a texture by angle and radius.
    angle, radius = (
        (np.arange(512) + 0.5) * (2 * np.pi / 512),
        PUPIL + (np.arange(256)[:, None] + 0.5) / 256 * (ROOT - PUPIL),
    )
    code = np.stack(
        [radius * np.cos(angle) / 12 + 0.5, radius * np.sin(angle) / 12 + 0.5, np.ones((256, 512))],
        -1,
    )
    texture = {"type": "bitmap", "bitmap": mi.Bitmap(code.astype(np.float32)), "raw": True}
    origin, target, width = np.array([40.0, 0, -300]), np.array([0.0, 0, 2]), 12.0
    view = mi.ScalarTransform4f().look_at(origin=list(origin), target=list(target), up=[0, 1, 0])
    half = width / 2 / 300
    scene = mi.load_dict({
        "type": "scene", **shapes,
        "integrator": {"type": "path", "max_depth": 3},
        "iris": {"type": "ply", "filename": iris, "light": {"type": "area", "radiance": texture}},
        "camera": {"type": "perspective", "to_world": view, "fov": float(2 * np.degrees(np.arctan(half))),
                   "film": _film(size, pixel_format="rgb", crop_offset_x=first, crop_offset_y=first, crop_width=last - first, crop_height=last - first),
                   "sampler": {"type": "stratified", "sample_count": samples}},
    })  # fmt: skip
    image = np.array(mi.render(scene))
    brightness = image[..., 2:]
    with np.errstate(invalid="ignore"):
        theirs = (image[..., :2] / brightness - 0.5) * 12
    # Radiance falls by n² in each medium; any sample mirrored, or slipped between two triangles,
    # shows here.
    whole = np.abs(brightness[..., 0] * 1.336**2 - 1) < 1e-3

    forward = (target - origin) / np.linalg.norm(target - origin)
    left = np.cross([0, 1, 0], forward) / np.linalg.norm(np.cross([0, 1, 0], forward))
    line = (1 - 2 * (np.arange(first, last) + 0.5) / size) * half
    d = forward + line[None, :, None] * left + line[:, None, None] * np.cross(forward, left)
    d /= np.linalg.norm(d, axis=-1, keepdims=True)

    @jax.jit
    def ours(d):
        o = jnp.broadcast_to(jnp.asarray(origin), d.shape)
        distance, met = EYE.cornea.anterior.intersect(o, d)
        entry = o + distance[..., None] * d
        point = refract_to_iris(EYE, entry, d).point[..., :2]
        r = norm(point)
        # Pixels that hold an edge are left out.
        return point, met & (norm(entry[..., :2]) < 5.47) & (r > PUPIL + 0.04) & (r < ROOT - 0.04)

    point, visible = (np.asarray(x) for x in ours(jnp.asarray(d)))
    return theirs, point, visible, visible & whole


# A corner from the limbus to the pupil, and everything.
@pytest.mark.parametrize(("first", "last"), [(120, 320), slowly(0, 800)])
def test_image_of_the_iris(cornea, first, last):
    """Half a pixel of 800 across 12 mm, everywhere on the visible iris, off the axis by 7.5°."""
    theirs, ours, visible, use = _seen(cornea, 800, first, last, 4)
    assert visible.mean() > 0.5 and use.sum() > 0.8 * visible.sum()
    step = np.stack([np.gradient(ours, axis=1), np.gradient(ours, axis=0)], -1)  # mm per pixel
    off = np.linalg.norm(
        np.linalg.solve(step[use], (theirs - ours)[use][..., None])[..., 0], axis=-1
    )
    print(f"off by {np.median(off):.3f} (median), {off.max():.3f} (most) of {use.sum()} pixels")
    assert off.max() < 0.5


def _lit(cornea, degrees, size, rays):
    """Irradiance on the iris, (size rows y, size columns x) over ±5.5 mm, by Mitsuba's particle
    tracer.
    """
    shapes, _ = cornea
    flip = mi.ScalarTransform4f().translate([0, 0, DEPTH]).rotate([1, 0, 0], 180).scale(6)
    wall = {"type": "cylinder", "p0": [0, 0, 2.1643], "p1": [0, 0, DEPTH + 0.1], "radius": ROOT}
    # Inside the chamber, so that the tracer can join its particles to a camera.
    view = mi.ScalarTransform4f().look_at(origin=[0, 0, 1.0], target=[0, 0, 4], up=[0, 1, 0])
    albedo = 0.02  # light that comes back from the cornea once more is 1e-3 of it or less
    scene = mi.load_dict({
        "type": "scene", **shapes,
        "integrator": {"type": "ptracer", "max_depth": 4, "hide_emitters": True},
        "iris": {"type": "disk", "to_world": flip, "bsdf": {"type": "diffuse", "reflectance": _colour(albedo)}},
        "wall": {**wall, "bsdf": {"type": "twosided", "black": {"type": "diffuse", "reflectance": _colour(0.0)}}},
        "light": {"type": "directional", "direction": list(-towards(np.radians(degrees))), "irradiance": _colour(1.0)},
        "camera": {"type": "perspective", "to_world": view, "fov": float(2 * np.degrees(np.arctan(ROOT / (DEPTH - 1)))),
                   "near_clip": 1e-3, "film": _film(size, pixel_format="luminance")},
    })  # fmt: skip
    radiance = np.array(mi.render(scene, spp=max(1, rays // size**2)))[..., 0]
    # The camera looks along +z: its columns run towards −x, its rows towards −y.
    return radiance[::-1, ::-1] * (np.pi / albedo)


def _smooth(eye, degrees, size):
    """Irradiance at the centres of a grid's cells by the search for entry points, and where these
    lie well inside.
    """
    line = (np.arange(size) + 0.5) * (2 * ROOT / size) - ROOT
    light = jnp.asarray(towards(np.radians(degrees)))

    def at(target):
        found = find_arrival(eye, target, light, 0.9 * target, 20)
        return found.flux[2], norm(found.entry)

    points = jnp.asarray(np.stack(np.meshgrid(line, line), -1))
    irradiance, entry = (np.asarray(x) for x in jax.jit(jax.vmap(jax.vmap(at)))(points))
    return irradiance, (entry < 5.4) & (np.hypot(*np.meshgrid(line, line)) < 5.3)


@pytest.mark.parametrize(
    ("degrees", "rays", "patch"), [(40, 400_000, 16), slowly(70, 4_000_000, 8)]
)
def test_irradiance_in_patches(cornea, degrees, rays, patch):
    size = 64
    theirs = _lit(cornea, degrees, size, rays)
    ours, inside = _smooth(EYE, degrees, size)

    def patches(x):
        return x.reshape(size // patch, patch, size // patch, patch).mean((1, 3))

    use = patches(inside.astype(float)) == 1
    off = patches(theirs)[use] / patches(ours)[use] - 1
    print(
        f"{degrees}°: {use.sum()} patches off by {off.mean():+.4f} ± {off.std():.4f}, most {np.abs(off).max():.4f}"
    )
    assert use.sum() >= 4 and np.abs(off).max() < 0.02


def test_caustic(cornea):
    """The fold of grazing light: where it is brightest, and the power in all."""
    size, degrees = 64, 97
    theirs = _lit(cornea, degrees, size, 300_000)
    cell = 2 * ROOT / size
    # Our grid's points are the centres of their cells.
    extent = jnp.asarray(ROOT - cell / 2)
    ours = np.asarray(
        jax.jit(lambda a: trace_flux(EYE, a, size, extent, 400_000))(jnp.radians(float(degrees)))
    )[..., 2]
    power = [x.sum() * cell**2 for x in (theirs, ours)]
    # Along the axis of symmetry, over a band 1.4 mm wide; between cells by the parabola through the
    # highest three.
    profile = [x[size // 2 - 4 : size // 2 + 4].mean(0) for x in (theirs, ours)]
    ridge = []
    for p in profile:
        i = p.argmax()
        low, top, high = p[i - 1 : i + 2]
        ridge.append((i + 0.5 * (low - high) / (low - 2 * top + high) + 0.5) * cell - ROOT)
    print(f"{degrees}°: power {power[0]:.4f}, ours {power[1]:.4f} mm²; ridge at {ridge[0]:.3f}, ours {ridge[1]:.3f} mm; "
          f"height {profile[0].max():.3f}, ours {profile[1].max():.3f}")  # fmt: skip
    assert power[1] == pytest.approx(power[0], rel=0.05)
    assert ridge[1] == pytest.approx(ridge[0], abs=cell)
