"""Maps in files: what is written comes back, F09's packing is understood, wrong files are named."""

import re

import equinox as eqx
import jax
import numpy as np
import pytest

from irisjax import io
from irisjax.grow import presets
from irisjax.io.maps import MAP_NAMES
from irisjax.io.scenes import read_scene
from irisjax.tissue.maps import IrisMaps

SHAPE = (7, 5)


def drawn(*names):
    random = np.random.default_rng(3)
    return {name: random.random(SHAPE, np.float32) for name in names}


def scene_file(folder, text):
    (folder / "scene.toml").write_text(text)
    return read_scene(folder / "scene.toml")


@pytest.mark.parametrize(
    "names", [MAP_NAMES, ("eumelanin",), ("freckles", "relief"), MAP_NAMES[:3], MAP_NAMES[:4]]
)
def test_round_trip_to_the_last_bit(tmp_path, bits, names):
    maps = drawn(*names)
    io.write_maps(tmp_path / "maps.exr", IrisMaps(**maps))
    back = io.read_maps(tmp_path / "maps.exr").present()
    assert set(back) == set(names)
    for name, values in maps.items():
        np.testing.assert_array_equal(np.asarray(back[name]), values)


@pytest.mark.parametrize("letters", ["RGB", "RGBA"])
def test_packing_of_f09(tmp_path, letters):
    image = np.random.default_rng(5).random((*SHAPE, len(letters)), np.float32)
    image[0, 0, 3:] = 0  # no freckle: nothing may be divided by it
    io.write_exr(tmp_path / "packed.exr", image, tuple(letters))
    found = io.read_maps(tmp_path / "packed.exr").present()
    order = ["relief", "abl_depth", "stroma_depth", "freckles"][: len(letters)]
    assert set(found) == set(order)
    for i, name in enumerate(order):
        np.testing.assert_array_equal(np.asarray(found[name]), image[..., i])


def test_no_maps_are_no_file(tmp_path):
    with pytest.raises(ValueError, match=r"m\.exr: there are no maps to write"):
        io.write_maps(tmp_path / "m.exr", IrisMaps())
    assert not list(tmp_path.iterdir())


def test_scene_takes_its_maps_from_a_file(tmp_path, monkeypatch):
    # A preset grows maps too, which are not used.
    monkeypatch.setattr(presets, "procedural", lambda *_, **__: IrisMaps())
    (tmp_path / "deep").mkdir()
    io.write_maps(tmp_path / "deep" / "m.exr", IrisMaps(**drawn("relief", "freckles")))
    text = '[iris]\npreset = "blue"\n[maps]\nseed = 4\nfile = "deep/m.exr"\n[eye]\nsclera = false'
    scene = scene_file(tmp_path, text).scene()  # the path is the scene file's neighbour
    assert scene.maps is not None and set(scene.maps.present()) == {"relief", "freckles"}
    np.testing.assert_array_equal(np.asarray(scene.maps.relief), drawn("relief")["relief"])
    own, _ = presets.preset("blue", key=jax.random.key(0))
    assert eqx.tree_equal(scene.iris, own)


def test_scene_of_a_clone_has_its_residual_unless_told_not_to(tmp_path):
    residual = np.random.default_rng(4).random((*SHAPE, 3), np.float32)
    io.write_maps(tmp_path / "m.exr", IrisMaps(**drawn("relief"), residual=residual))
    text = '[eye]\nsclera = false\n[maps]\nfile = "m.exr"\n'
    file = scene_file(tmp_path, text)
    maps = file.scene().maps
    np.testing.assert_array_equal(np.asarray(maps.residual), residual)  # in three channels
    np.testing.assert_array_equal(np.asarray(maps.relief), drawn("relief")["relief"])
    assert set(file.with_entries("maps", residual=False).scene().maps.present()) == {"relief"}
    assert scene_file(tmp_path, text + "residual = false\n").scene().maps.residual is None


MAPS = '[maps]\n\nfile = "m.exr"'
ONES = np.ones(SHAPE, np.float32)


@pytest.mark.parametrize(
    ("text", "channels", "message"),
    [
        (MAPS, {}, "scene.toml, line 3: m.exr: No such file or directory"),
        (MAPS, {"Relief": ONES}, "scene.toml, line 3: m.exr: unknown channel 'Relief'; maps have channels among relief, abl_"),
        (MAPS, {"R": ONES, "G": ONES}, "scene.toml, line 3: m.exr: unknown channel 'R', 'G'; maps have"),
        (MAPS, {"freckles": 2 * ONES}, "line 3: m.exr: map freckles has values outside [0, 1] or not finite"),
        (MAPS, {"R": ONES, "G": -ONES, "B": ONES}, "line 3: m.exr: map abl_depth has values outside [0, inf]"),
        (MAPS, {"relief": np.nan * ONES}, "line 3: m.exr: map relief has values outside [-1, 1] or not finite"),
        (MAPS, {"relief": ONES[:1]}, "line 3: m.exr: map relief has shape (1, 5)"),
        ('[maps]\nfile = "m.png"', {}, "scene.toml, line 2: m.png: a file of maps must end in .exr"),
        ("[maps]\nfile = 3", {}, "scene.toml, line 2: maps.file = 3 must be text"),
        (MAPS + "\nfibres = 1", {"relief": ONES}, "scene.toml, line 4: maps.fibres is for grown maps, and maps.file gives"),
        (MAPS + "\nuniform = true", {"relief": ONES}, "scene.toml, line 4: maps.uniform is for grown maps"),
    ],
)  # fmt: skip
def test_wrong_maps_are_named(tmp_path, monkeypatch, text, channels, message):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "scene.toml").write_text(text)
    if channels:
        io.write_exr("m.exr", np.stack(list(channels.values()), -1), tuple(channels))
    with pytest.raises(ValueError, match=re.escape(message)):
        read_scene("scene.toml").scene()
