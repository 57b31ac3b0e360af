"""The hand-over to other renderers: its files, and albedos and BRDF against the public instruments."""

import re

import jax
import numpy as np
import pytest
import trimesh
from handed_over import pixels, rgb

import irisjax as ij
from common import read_csv
from irisjax import cli, io
from irisjax.export import export_scene
from irisjax.export.handover import REFLECTANCE_WAVELENGTHS, check_new_folder
from irisjax.tissue.maps import FRECKLE

GRID = ij.wavelengths(380, 780, 5)


def freckled(iris, factor):
    """A texel's own iris: `factor` on its eumelanin, and 0.02 of a freckle shared out by hand."""
    freckle, share = 1 + (FRECKLE - 1) * 0.02, float(iris.abl_fraction)
    more = share * freckle + 1 - share
    return iris.replace(
        abl_fraction=share * freckle / more,
        eumelanin=iris.eumelanin * factor * more,
        pheomelanin=iris.pheomelanin * more,
    )


def test_albedo_is_the_spectrophotometers(bare):
    """The texel's own iris before the public instrument."""
    scene, folder, _ = bare
    iris = scene.iris
    found = pixels(folder / "reflectance.exr")
    names = io.spectral_channels(REFLECTANCE_WAVELENGTHS, layer="T")
    assert set(found) == set(names)
    layers = np.stack([np.flip(found[name], 0).T for name in names], -1)
    within = np.isin(GRID, REFLECTANCE_WAVELENGTHS)
    colour = np.flip(rgb(folder / "albedo.exr"), 0).swapaxes(0, 1)
    for row, column in ((8, 12), (40, 3)):
        texel = freckled(iris, scene.maps.eumelanin[row, column])
        spectrum = ij.reflectance(texel, GRID, first_surface=False).values
        near = {"rtol": 2e-3, "atol": 1e-3 * layers.max()}
        np.testing.assert_allclose(layers[row, column], spectrum[within], **near)
        srgb = ij.colour_of(GRID, spectrum).srgb_linear  # of 81 wavelengths, not ten bands
        np.testing.assert_allclose(colour[row, column], srgb, rtol=0.01, atol=3e-4)


def test_brdf_table_is_the_goniophotometers(bare):
    scene, folder, _ = bare
    table = read_csv(folder / "brdf.csv")
    c = table.columns
    assert len(c["red"]) == 18 * 18 * 3 and "simulated" in table.header
    pick = (c["theta_i_deg"] == 60) & (c["dphi_deg"] == 90)
    exits = np.radians(c["theta_o_deg"][pick])
    spectra = ij.brdf(scene.iris, GRID, cos_incidence=0.5, cos_exit=np.cos(exits)).values
    expected = np.stack([ij.colour_of(GRID, s).srgb_linear for s in np.asarray(spectra).T])
    found = np.stack([c[name][pick] for name in ("red", "green", "blue")], -1)
    np.testing.assert_allclose(found, expected, rtol=0.01)


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


def test_gltf_of_the_iris_alone(bare):
    scene = trimesh.load_scene(bare[1] / "eye.glb", process=False)
    assert set(scene.geometry) == {"iris", "pupil"}
    names = {path.name for path in bare[1].glob("iris_*.png")}
    assert names == {"iris_base_color.png", "iris_thickness.png"}  # no relief


def test_folder_is_new_or_empty(tmp_path, monkeypatch):
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "mine.txt").write_text("mine")
    for name, message in {"full/mine.txt": "is a file", "no/eye": "no such folder"}.items():
        with pytest.raises(OSError, match=message):
            check_new_folder(tmp_path / name)

    def broken(*_):
        raise OSError(28, "disk full", "x")

    monkeypatch.setattr("irisjax.export.handover.write_together", broken)
    monkeypatch.setattr("irisjax.export.handover._contents", lambda *_: ({"a": b""}, 0, None))
    with pytest.raises(OSError, match="disk full"):
        export_scene(tmp_path / "new", ij.Scene(ij.Iris.of_level("low")))
    assert [p.name for p in tmp_path.iterdir()] == ["full"]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((), "give a SCENE file or --preset"),
        (("--preset", "blue", "--spacing", "0"), "--spacing: 0 is outside [0.02, 2] mm"),
        (("--preset", "blue", "--format", "fbx"), "--format: unknown 'fbx'; known: obj, glb"),
        (("--preset", "blue", "-o", "full"), "full: not empty; give a new folder"),
        (("--preset", "blue", "-o", "no/eye"), "no: no such folder"),
        (("bare.toml", "--pupil-radius", "6"), "--pupil-radius: 6 is outside [0.25, 4.75] mm"),
    ],
)
def test_wrong_options_are_one_line(capsys, monkeypatch, tmp_path, arguments, message):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "full" / "mine").mkdir(parents=True)
    (tmp_path / "bare.toml").write_text("[maps]\nuniform = true\n[eye]\nsclera = false")
    before = jax.config.read("jax_enable_x64")
    status = cli.run(["export", *arguments])
    jax.config.update("jax_enable_x64", before)
    out, err = capsys.readouterr()
    assert (status, out, err.count("\n")) == (2, "", 1) and message in err
    assert {p.name for p in tmp_path.iterdir()} <= {"full", "bare.toml"}
