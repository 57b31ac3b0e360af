"""The hand-over to other renderers: Mitsuba's picture against ours, albedos against the
spectrophotometer.
"""

import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import trimesh

import irisjax as ij
from irisjax import cli, io
from irisjax.export.handover import WAVELENGTHS, check_folder, export
from irisjax.export.mesh import encode_ply, eye_meshes, right_handed
from irisjax.numerics.interpolation import bilinear
from irisjax.render.environment import Environment
from irisjax.render.shading import slopes_of
from irisjax.render.stages import look
from irisjax.tissue.maps import FRECKLE, IrisMaps, cell_centres

EYE = ij.Eye(cornea=None, sclera=None)
CAMERA = ij.Camera(0.2, 0.7, size=(64, 48), width=13.0)
LAMPS = ij.Lights.distant(0.5, 2.1) + ij.Lights.points([30.0, -10.0, -80.0], 1.5)


def sector():
    """A dark sector, from 10° to 70° and in the outer half only."""
    angle, radius = cell_centres((72, 16))
    dark = ((angle > np.radians(10)) & (angle < np.radians(70)))[:, None] & (radius > 0.5)
    return jnp.where(dark, 20.0, 1.0)


@pytest.fixture(scope="module")
def bare(tmp_path_factory):
    """A bare iris with a dark sector under two lamps: scene, folder, and what `export` said."""
    iris, maps = (
        ij.Iris.of_level("low"),
        IrisMaps(eumelanin=sector(), freckles=0.02 * jnp.ones((72, 16))),
    )
    scene = ij.Scene(iris, maps, EYE, LAMPS, camera=CAMERA)
    folder = tmp_path_factory.mktemp("bare") / "eye"
    return scene, folder, export(folder, scene, spacing=0.3)


@pytest.fixture(scope="module")
def mi():
    mitsuba = pytest.importorskip(
        "mitsuba", reason="Mitsuba is not installed (pip install mitsuba)"
    )
    mitsuba.set_variant("scalar_rgb")  # needs no LLVM
    mitsuba.set_log_level(mitsuba.LogLevel.Error)
    return mitsuba


def pixels(path):
    """Pixels of an EXR by channel name."""
    image = io.read_image(path)
    return {name: image.pixels[..., i] for i, name in enumerate(image.channels)}


def rgb(path):
    found = pixels(path)
    return np.stack([found[c] for c in "RGB"], -1)


def on_the_iris(scene, margin=0.25):
    """Flat indices of pixels that see the iris, clear of its edges, and their points (mm)."""
    view = look(scene.eye, scene.camera).iris
    assert view is not None
    index, point = np.asarray(view.index), np.stack(view.point, -1)
    r = np.hypot(point[:, 0], point[:, 1])
    inside = (
        (index >= 0)
        & (r > float(scene.eye.pupil_radius) + margin)
        & (r < float(scene.eye.iris_radius) - margin)
    )
    return index[inside], point[inside]


def matt(scene, folder, point):
    """Radiance of a Lambertian iris of the exported albedo at points, by the definition of
    irradiance.
    """
    texture = np.flip(rgb(folder / "albedo.exr"), 0).swapaxes(0, 1)  # back to (angles, radii)
    pupil, root = float(scene.eye.pupil_radius), float(scene.eye.iris_radius)
    radius = (np.hypot(point[:, 0], point[:, 1]) - pupil) / (root - pupil)
    albedo = bilinear(
        jnp.moveaxis(jnp.asarray(texture, float), -1, 0),
        jnp.arctan2(point[:, 1], point[:, 0]),
        jnp.asarray(radius),
    )
    irradiance = np.zeros(len(point))
    for i in range(len(scene.lights)):
        towards, power = (np.asarray(x) for x in scene.lights.seen_from(jnp.asarray(point), i))
        irradiance += power * np.maximum(-towards[:, 2], 0)
    return np.asarray(albedo).T * irradiance[:, None] / np.pi


@pytest.mark.peer
def test_mitsuba_renders_the_matt_iris_and_it_is_as_far_off_as_we_say(bare, mi):
    scene, folder, made = bare
    theirs = np.array(mi.render(mi.load_file(str(folder / "scene.xml"), spp=16)))
    assert theirs.shape == (48, 64, 3) and np.isfinite(theirs).all()
    ours = np.asarray(scene.render()).reshape(-1, 3)
    index, point = on_the_iris(scene)
    theirs = theirs.reshape(-1, 3)
    # Radiance, units, lamps, camera: the mean to 0.3 % (only edges of the sector, blurred within
    # pixels, differ).
    expected = matt(scene, folder, point)
    print("Mitsuba over a matt iris:", theirs[index].mean(0) / expected.mean(0))
    np.testing.assert_allclose(theirs[index].mean(0), expected.mean(0), rtol=3e-3)
    # Against the model itself: the stated largest error of a matt iris, and those 0.3 %.
    off = theirs[index].mean(0) / ours[index].mean(0) - 1
    print("Mitsuba over irisjax:", 1 + off, "stated", made.error.rms, made.error.most)
    assert (np.abs(off) < np.abs(made.error.most) + 3e-3).all() and (
        np.abs(off) > 0.3 * made.error.rms
    ).all()
    # The sector stands where it stands in our picture, and nowhere else.
    dark = [picture[index, 2] < 0.5 * np.median(picture[index, 2]) for picture in (ours, theirs)]
    assert 0.05 < dark[0].mean() < 0.2 and (dark[0] == dark[1]).mean() > 0.97
    assert (point[dark[1], :2].mean(0) > 1.5).all()  # right and up, by its azimuth of 40°


@pytest.mark.peer
def test_relief_tilts_their_shading_as_ours(tmp_path, mi):
    angle, radius = cell_centres((96, 32))
    relief = 0.1 * jnp.cos(9 * angle)[:, None] * jnp.sin(np.pi * radius) ** 2
    scene = ij.Scene(
        ij.Iris.of_level("low"),
        IrisMaps(relief=relief),
        EYE,
        ij.Lights.distant(0.9, 0.4),
        camera=CAMERA,
    )
    made = export(tmp_path / "eye", scene, spacing=0.2)
    theirs = np.array(mi.render(mi.load_file(str(tmp_path / "eye" / "scene.xml"), spp=16))).reshape(
        -1, 3
    )
    index, _ = on_the_iris(scene)
    ours = np.asarray(scene.render()).reshape(-1, 3)[index]
    theirs = theirs[index] * (ours.mean(0) / theirs[index].mean(0))
    assert ours[:, 1].std() > 0.1 * ours[:, 1].mean()  # there is something to see
    assert (theirs - ours).std() < 0.15 * ours.std() and np.corrcoef(theirs[:, 1], ours[:, 1])[
        0, 1
    ] > 0.99
    assert set(made.files) >= {"relief.exr", "albedo.exr"}
    found = pixels(tmp_path / "eye" / "relief.exr")
    np.testing.assert_allclose(np.flip(found["Y"], 0).T, relief, atol=1e-7)


@pytest.mark.peer
def test_fine_relief_is_as_steep_as_a_mesh_of_it(tmp_path, mi):
    """Waves of five texels, about as fine as the finest fibres: against true geometry,
    and by hand.
    """
    shape, lobes, height = (96, 32), 20, 0.12

    def relief(angle, radius):
        return height * jnp.cos(lobes * angle)[:, None] * jnp.ones_like(radius)

    maps = IrisMaps(relief=relief(*cell_centres(shape)))
    scene = ij.Scene(ij.Iris.of_level("low"), maps, EYE, ij.Lights.distant(0.1, 0.4), camera=CAMERA)
    made = export(tmp_path / "eye", scene, spacing=0.2)
    index, point = on_the_iris(scene)
    ours = np.asarray(scene.render()).reshape(-1, 3)[index].mean(0)
    shaded = ours / np.asarray(scene.replace(maps=None).render()).reshape(-1, 3)[index].mean(0)

    def theirs(name):
        return (
            np.array(mi.render(mi.load_file(str(tmp_path / "eye" / name), spp=16)))
            .reshape(-1, 3)[index]
            .mean(0)
        )

    flat = matt(scene, tmp_path / "eye", point).mean(0)
    bumped = theirs("scene.xml") / flat
    # Triangles in place of the bump, eight times as fine as the map; single reflections, as we
    # have.
    mesh = right_handed(eye_meshes(EYE, 0.025)["iris"])
    angle = np.arctan2(mesh.vertices[:, 1], mesh.vertices[:, 0])
    mesh.vertices[:, 2] += height * np.cos(lobes * angle)
    (tmp_path / "eye" / "fine.ply").write_bytes(encode_ply(mesh))
    text = made.files["scene.xml"].read_text().replace("iris.ply", "fine.ply")
    text = text.replace('name="max_depth" value="10"', 'name="max_depth" value="2"')
    text = re.sub(
        r'<bsdf type="bumpmap">.*?</texture>(.*?</bsdf>)\s*</bsdf>', r"\1", text, flags=re.DOTALL
    )
    text = text.replace(
        '<boolean name="flip', '<boolean name="face_normals" value="true" />\n<boolean name="flip'
    )
    (tmp_path / "eye" / "fine.xml").write_text(text)
    true = theirs("fine.xml") / flat
    # By hand: the mean cosine to a light nearly straight ahead, over the waves and the ring.
    r = np.hypot(point[:, 0], point[:, 1])[:, None]
    steep = height * lobes / r * np.sin(np.linspace(0, 2 * np.pi, 64, endpoint=False))
    print(
        "shaded by",
        shaded,
        "mesh",
        true,
        "bump",
        bumped,
        "by hand",
        (1 / np.sqrt(1 + steep**2)).mean(),
    )
    np.testing.assert_allclose(true, (1 / np.sqrt(1 + steep**2)).mean(), rtol=0.01)
    np.testing.assert_allclose(shaded, true, rtol=0.01)
    np.testing.assert_allclose(shaded, bumped, rtol=0.01)


def test_slopes_of_a_relief():
    """Exact for a plane up to the edges; of waves of four texels steeper than a polygon through
    them (0.9), not half.
    """
    eye = EYE
    pupil, span = float(eye.pupil_radius), float(eye.iris_radius - eye.pupil_radius)
    for shape in ((2, 2), (24, 8)):
        plane = jnp.broadcast_to(0.1 * cell_centres(shape)[1], shape)
        along, across = slopes_of(plane, eye)
        np.testing.assert_allclose(along, 0.1 / span, rtol=1e-5)
        np.testing.assert_allclose(across, 0, atol=1e-6)
    place = np.random.default_rng(0).uniform(size=(2, 4000))
    angle, radius = 2 * np.pi * place[0], 0.05 + 0.9 * place[1]
    for lobes, cycles, most in ((24, 0, 0.08), (12, 0, 0.01), (0, 8, 0.08), (0, 4, 0.01)):
        a, r = cell_centres((96, 32))
        phase = lobes * a[:, None] + 2 * np.pi * cycles * r + 0.7
        found = np.stack(
            bilinear(slopes_of(0.02 * jnp.cos(phase), eye), jnp.asarray(angle), jnp.asarray(radius))
        )
        slope = -0.02 * np.sin(lobes * angle + 2 * np.pi * cycles * radius + 0.7)
        true = slope * np.stack(
            [0 * angle + 2 * np.pi * cycles / span, lobes / (pupil + span * radius)]
        )
        steep = [np.sqrt((x**2).sum(0).mean()) for x in (found, true)]
        print(lobes, cycles, steep[0] / steep[1])
        np.testing.assert_allclose(steep[0], steep[1], rtol=most)


def test_albedo_is_the_spectrophotometers(bare):
    """The texel's own iris, its melanin shared out by hand, before the public instrument."""
    scene, folder, _ = bare
    iris = scene.iris
    found = pixels(folder / "reflectance.exr")
    assert set(found) == set(io.spectral_channels(WAVELENGTHS, layer="T"))
    layers = np.stack(
        [np.flip(found[name], 0).T for name in io.spectral_channels(WAVELENGTHS, layer="T")], -1
    )
    colour = np.flip(rgb(folder / "albedo.exr"), 0).swapaxes(0, 1)
    for row, column in ((8, 12), (40, 3)):
        eumelanin = iris.eumelanin * scene.maps.eumelanin[row, column]
        freckle = 1 + (FRECKLE - 1) * 0.02
        share, kinds = (
            float(iris.abl_fraction),
            {"eumelanin": eumelanin, "pheomelanin": iris.pheomelanin},
        )
        more = share * freckle + 1 - share
        texel = iris.replace(
            abl_fraction=share * freckle / more, **{k: v * more for k, v in kinds.items()}
        )
        expected = ij.reflectance(texel, np.asarray(WAVELENGTHS), first_surface=False).values
        np.testing.assert_allclose(
            layers[row, column], expected, rtol=2e-3, atol=1e-3 * layers.max()
        )
        srgb = ij.colour(texel, first_surface=False).srgb_linear
        np.testing.assert_allclose(
            colour[row, column], srgb, rtol=0.01, atol=3e-4
        )  # ten bands for 81


def test_brdf_table_is_the_goniophotometers(bare):
    scene, folder, _ = bare
    table = io.read_table(folder / "brdf.csv")
    c = table.columns
    assert len(c["red"]) == 18 * 18 * 3 and "simulated" in table.header
    grid = ij.wavelengths(380, 780, 5)
    pick = (c["theta_i_deg"] == 60) & (c["dphi_deg"] == 90)
    exits = np.radians(c["theta_o_deg"][pick])
    spectra = ij.brdf(scene.iris, grid, cos_incidence=0.5, cos_exit=np.cos(exits)).values
    expected = np.stack([ij.colour_of(grid, s).srgb_linear for s in np.asarray(spectra).T])
    found = np.stack([c[name][pick] for name in ("red", "green", "blue")], -1)
    np.testing.assert_allclose(found, expected, rtol=0.01)


def test_error_of_a_matt_iris_by_plain_sums(bare):
    """Largest error of the mean radiance within 50°, from the public BRDF of the two kinds of texel
    there are.
    """
    scene, _, made = bare
    freckle, share = 1 + (FRECKLE - 1) * 0.02, float(scene.iris.abl_fraction)
    more = share * freckle + 1 - share
    grid, angle = ij.wavelengths(380, 780, 20), np.radians(np.arange(0, 51, 10.0))
    # Area weights of the dark sector: its angles, and the ring of its outer half.
    root, pupil = float(scene.eye.iris_radius), float(scene.eye.pupil_radius)
    middle = (root + pupil) / 2
    dark = (np.asarray(sector()) > 1).any(1).mean() * (root**2 - middle**2) / (root**2 - pupil**2)
    brdf, flat = 0.0, 0.0
    for weight, factor in ((1 - dark, 1.0), (dark, 20.0)):
        iris = scene.iris.replace(
            abl_fraction=share * freckle / more,
            eumelanin=scene.iris.eumelanin * factor * more,
            pheomelanin=scene.iris.pheomelanin * more,
        )

        def to_rgb(spectrum):
            return np.asarray(ij.colour_of(grid, spectrum).srgb_linear)

        flat += weight * to_rgb(ij.reflectance(iris, grid, first_surface=False).values) / np.pi
        values = ij.brdf(iris, grid, cos_incidence=1.0, cos_exit=np.cos(angle)).values
        brdf += weight * np.stack([to_rgb(v) for v in values.T])
    off = flat / brdf - 1
    np.testing.assert_allclose(
        made.error.most, off[0], atol=0.01
    )  # the largest is along the normal


def test_files_go_together(bare):
    scene, folder, made = bare
    assert {p.name for p in folder.iterdir()} == set(made.files)
    text = (folder / "README.txt").read_text()
    assert "mirror images" not in text  # no cornea
    assert "simulated" in text and all(f"{100 * v:.2g}" in text for v in made.error.rms)
    for name in re.findall(r'filename" value="([^"]+)"', (folder / "scene.xml").read_text()):
        assert (folder / name).exists()
    back = io.read_maps(folder / "maps.exr").present()
    np.testing.assert_allclose(back["eumelanin"], scene.maps.eumelanin)
    np.testing.assert_allclose(
        rgb(folder / "albedo.png"), io.read_image(folder / "albedo.png").pixels
    )
    # OBJ and PLY hold one mesh, in a right-handed frame with z towards the viewer.
    flat = trimesh.load(folder / "iris.obj", process=False)
    ply = trimesh.load(folder / "iris.ply", process=False)
    np.testing.assert_allclose(flat.vertices, ply.vertices, atol=1e-6)
    np.testing.assert_array_equal(flat.faces, ply.faces)
    assert (flat.face_normals[:, 2] > 0.99).all() and np.allclose(flat.vertices[:, 2], -3.6)
    uv = flat.visual.uv
    angle = np.arctan2(flat.vertices[:, 1], flat.vertices[:, 0])
    np.testing.assert_allclose(np.cos(angle), np.cos(2 * np.pi * uv[:, 0]), atol=1e-5)
    assert "map_Kd albedo.png" in (folder / "iris.mtl").read_text()


@pytest.mark.peer
def test_eye_behind_its_cornea(tmp_path, mi):
    """A broad panel with a bright patch: it is mirrored where we mirror it, and the iris is as
    bright as ours.
    """
    around = np.zeros((16, 32, 3))
    around[4:12, 11:21] = 1.5  # within 80° of the axis: no caustics to tabulate
    around[4:6, 19:21] = 12.0  # up, and to the right as seen from the eye
    iris = ij.Iris.of_level("low").replace(fibril_radius=60.0)  # bright, that noise may be little
    camera = ij.Camera(0.1, 0.3, size=(48, 36))
    scene = ij.Scene(iris, None, lights=None, environment=Environment(around), camera=camera)
    made = export(tmp_path / "eye", scene, spacing=0.2)
    assert set(made.files) >= {
        f"{n}.{k}" for n in ("anterior", "posterior", "iris", "sclera") for k in ("ply", "obj")
    }
    theirs = np.array(
        mi.render(mi.load_file(str(tmp_path / "eye" / "scene.xml"), spp=256))
    ).reshape(-1, 3)
    ours = np.asarray(scene.render()).reshape(-1, 3)
    assert np.isfinite(theirs).all()
    index, _ = on_the_iris(scene, 0.5)
    row, column = np.unravel_index(index, (36, 48))
    smooth = [np.array([p[index][(abs(row - i) < 2) & (abs(column - j) < 2), 1].mean() for i, j in zip(row, column, strict=True)])
              for p in (ours, theirs)]  # fmt: skip
    spots = [np.array([row[s.argmax()], column[s.argmax()]]) for s in smooth]
    print("mirror image at", *spots)
    assert np.abs(spots[0] - spots[1]).max() <= 1
    # Mirror images and all: 2 % for noise, for light that the cornea sends back in, and for 25
    # lamps in a panel's place.
    off = theirs[index].mean(0) / ours[index].mean(0) - 1
    print("Mitsuba over irisjax:", 1 + off)
    assert (np.abs(off) < np.abs(made.error.most) + 0.02).all()


def test_lamps_before_a_cornea_keep_their_irradiance(tmp_path):
    lamps = ij.Lights.points([0.0, 0.0, -400.0], 2.0) + ij.Lights.distant(0.5, 0.0, radius=0.4)
    export(tmp_path / "eye", ij.Scene(ij.Iris.of_level("low"), None, lights=lamps), spacing=1.0)
    text = (tmp_path / "eye" / "scene.xml").read_text()
    radiances = [float(r) for r in re.findall(r'name="radiance" value="([\d.e+-]+),', text)]
    angles = [np.radians(20), 0.4]
    np.testing.assert_allclose(
        np.array(radiances) * np.pi * np.sin(angles) ** 2, [2.0, np.pi], rtol=1e-6
    )
    scales = [float(s) for s in re.findall(r'scale x="([\d.e+-]+)"', text)]
    np.testing.assert_allclose(
        scales, [400 * np.tan(angles[0]), 1e4 * np.tan(angles[1])], rtol=1e-6
    )


def test_folder_is_new_or_empty(tmp_path, monkeypatch):
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "mine.txt").write_text("mine")
    for name, message in (
        ("full", "not empty"),
        ("full/mine.txt", "is a file"),
        ("no/eye", "no such folder"),
    ):
        with pytest.raises(OSError, match=message):
            check_folder(tmp_path / name)

    def broken(*_):
        raise OSError(28, "disk full", "x")

    monkeypatch.setattr("irisjax.export.handover.write_together", broken)
    monkeypatch.setattr("irisjax.export.handover._contents", lambda *_: ({"a": b""}, 0, None))
    with pytest.raises(OSError, match="disk full"):
        export(tmp_path / "new", ij.Scene(ij.Iris.of_level("low")))
    assert {p.name for p in tmp_path.iterdir()} <= {"full", "bare.toml"}


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((), "give a SCENE file or --preset"),
        (("--preset", "pink"), "--preset: unknown 'pink'"),
        (("--preset", "blue", "--spacing", "0"), "--spacing 0 is outside 0.02 to 2 mm"),
        (("--preset", "blue", "-o", "full"), "full: not empty; give a new folder"),
        (("--preset", "blue", "-o", "no/eye"), "no: no such folder"),
        (("bare.toml", "--pupil", "12"), "--pupil: 12 is outside 0.5 to 9.5; it is a diameter"),
        (("missing.toml",), "missing.toml: No such file"),
    ],
)
def test_wrong_options_are_one_line(capsys, monkeypatch, tmp_path, arguments, message):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "mine.txt").write_text("mine")
    (tmp_path / "bare.toml").write_text("[maps]\nuniform = true\n[eye]\nsclera = false")
    before = jax.config.read("jax_enable_x64")
    status = cli.run(["export", *arguments])
    jax.config.update("jax_enable_x64", before)
    out, err = capsys.readouterr()
    assert (status, out, err.count("\n")) == (2, "", 1) and message in err
    assert {p.name for p in tmp_path.iterdir()} <= {"full", "bare.toml"}
