"""The folder of a clone: what is read from it, and what is refused."""

import json

import numpy as np
import pytest

from irisjax import io
from irisjax.io.clone_folders import PHOTOGRAPH, encode_photograph, read_clone

SCENE = '[iris]\nlevel = "low"\n[maps]\nuniform = true\n[eye]\ncornea = "none"\n'
SCENE += "[camera]\nsize = [8, 6]\n[picture]\nexposure = 2.0\n"


ENCODED = np.random.default_rng(0).uniform(size=(6, 8, 3))


@pytest.fixture
def folder(tmp_path):
    summary = {"photograph": "eye.jpg", "limbus": {}, "pupil": {}}
    (tmp_path / "clone.json").write_text(json.dumps(summary))
    (tmp_path / "scene.toml").write_text(SCENE)
    (tmp_path / PHOTOGRAPH).write_bytes(encode_photograph(ENCODED))
    return tmp_path


def test_scene_and_photograph_come_back(folder):
    found = read_clone(folder)
    assert found.scene.exposure == 2.0
    assert found.scene.scene().camera.size == (8, 6)
    assert np.abs(found.photograph / 255 - ENCODED).max() <= 0.5 / 255 + 1e-6


def test_names_what_is_missing(folder):
    for name, said in (
        (PHOTOGRAPH, "run irisjax clone again"),
        ("scene.toml", "stopped before its pigments"),
        ("clone.json", "not the folder of a clone"),
    ):
        (folder / name).unlink()
        with pytest.raises(ValueError, match=said):
            read_clone(folder)


@pytest.mark.parametrize("text", ["{", "[]", '{"photograph": "eye.jpg"}', "\udcff"])
def test_refuses_a_broken_summary(folder, text):
    (folder / "clone.json").write_bytes(text.encode(errors="surrogateescape"))
    with pytest.raises(ValueError, match=r"clone\.json: broken: [^\n]*$"):
        read_clone(folder)


def test_refuses_a_photograph_of_another_size(folder):
    io.write_png(folder / PHOTOGRAPH, np.zeros((6, 9, 3)))
    with pytest.raises(ValueError, match="is 9 x 6 pixels of 3 channels, must be 8 x 6"):
        read_clone(folder)
