"""Illumination tables in files: the same to the last bit, of this eye, or made again."""

import dataclasses
import os
from concurrent.futures import ThreadPoolExecutor

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from irisjax.anatomy.eye import Cornea, Eye, LimbalRing, Sclera
from irisjax.cli import compiled
from irisjax.cli.compiled import MOST_TABLES, cached_tables, tables_key
from irisjax.optics.conicoid import Conicoid
from irisjax.render.camera import Camera
from irisjax.render.illumination import Illumination, canonical_eye
from irisjax.render.lights import Lights
from irisjax.render.scene import Scene
from irisjax.tissue.iris import Iris

EYE = Eye()
SCENE = Scene(Iris())


def key(eye, caustics, code="code"):
    return tables_key(eye, caustics, code)


@pytest.fixture
def folder(monkeypatch, tmp_path):
    """Where tables are kept."""
    monkeypatch.setenv("JAX_COMPILATION_CACHE_DIR", str(tmp_path))
    monkeypatch.setattr(compiled, "_version_of", lambda place: place / "code")
    return tmp_path / "illumination"


@pytest.fixture
def made(monkeypatch):
    """Small invented tables, a different set each time; what they were made of."""
    calls = []

    def build(eye, *, caustics):
        calls.append((eye, caustics))
        flux = np.random.default_rng(len(calls)).normal(size=(4 if caustics else 2, 5, 5, 3))
        return Illumination(jnp.asarray(flux, float), jnp.asarray(5.6, float), 2.25)

    monkeypatch.setattr(Illumination, "build", staticmethod(build))
    return calls


def equal(a, b):
    assert a.largest == b.largest and a.flux.dtype == b.flux.dtype
    np.testing.assert_array_equal(a.flux, b.flux)
    np.testing.assert_array_equal(a.extent, b.extent)


def test_tables_come_back_to_the_bit(folder, made, bits):
    scene = Scene(Iris(), eye=Eye(iris_depth=3.7))  # of this precision
    first = cached_tables(scene)
    (file,) = folder.iterdir()
    assert first.flux.dtype == f"float{bits}"
    # Another pupil, camera and iris: the same file.
    eye = scene.eye.replace(pupil_radius=2.5)
    scene = scene.replace(eye=eye, camera=Camera(size=(4, 3)), iris=Iris())
    equal(cached_tables(scene), first)
    assert list(folder.iterdir()) == [file] and len(made) == 1


def test_tables_are_made_of_what_the_key_sees():
    """Two eyes of one key have the same tables: build looks at nothing else."""
    parts = {"sclera": Sclera(radius=13.0), "cornea": Cornea(scatter=85e8)}
    pupil = {"pupil_radius": 3.0, "pupil_margin": 0.02, "pupil_centre": [0.2, 0.1]}
    pupil |= {"pupil_harmonics": [[0.01, 0.0]]}
    a = EYE.replace(limbus_width=0.3, limbal_ring=LimbalRing(), **pupil, **parts)
    b = EYE.replace(sclera=None)
    assert key(a, False) == key(b, False) == key(EYE, False)
    assert jax.tree.structure(canonical_eye(a)) == jax.tree.structure(canonical_eye(b))
    single = EYE.replace(cornea=Cornea.f09(), aqueous_index=1.376)
    assert key(single, True) == key(single.replace(cornea=Cornea(posterior=None, index=1.5)), True)


OTHERS = {
    "iris_depth": EYE.replace(iris_depth=3.6 + 1e-12),
    "iris_slope": EYE.replace(iris_slope=0.0),
    "iris_radius": EYE.replace(iris_radius=5.4),
    "limbus_radius": EYE.replace(limbus_radius=5.6),
    "aqueous_index": EYE.replace(aqueous_index=1.34),
    "attenuation": EYE.replace(attenuation=1e-4),
    "one surface": EYE.replace(cornea=Cornea(posterior=None)),
    "cornea.index": EYE.replace(cornea=Cornea(index=1.38)),
    "cornea.anterior": EYE.replace(cornea=Cornea(anterior=Conicoid(7.8, 0.76))),
    "cornea.posterior": EYE.replace(cornea=Cornea(posterior=Conicoid(6.5, 0.75, 0.53))),
}


@pytest.mark.parametrize("name", OTHERS)
def test_what_matters_makes_another_key(name):
    keys = {key(eye, caustics) for eye in (EYE, OTHERS[name]) for caustics in (False, True)}
    assert len(keys) == 4


def test_every_field_of_the_eye_is_in_the_key_or_said_not_to_matter():
    pupil = {"pupil_radius", "pupil_margin", "pupil_centre", "pupil_harmonics"}
    said = {*pupil, "sclera", "limbus_width", "limbal_ring", "lids", "cornea", "cornea.scatter"}
    fields = {f.name for f in dataclasses.fields(Eye)}
    fields |= {f"cornea.{f.name}" for f in dataclasses.fields(Cornea)}
    assert fields - said <= OTHERS.keys()


def test_precision_and_code_are_in_the_key():
    before = key(EYE, True)
    single = jax.tree.map(lambda x: x.astype(jnp.float32), EYE)
    assert key(single, True) != before
    assert key(EYE, True, "other") != before


def test_grazing_light_asks_for_caustics(folder, made):
    low = SCENE.replace(lights=Lights.distant(1.6, 0.0))
    for scene in (SCENE, low, SCENE, low):
        cached_tables(scene)
    assert [caustics for _, caustics in made] == [False, True]
    assert cached_tables(SCENE.replace(eye=Eye(cornea=None, sclera=None))) is None
    assert len(list(folder.iterdir())) == 2  # without a cornea there is no file


def test_damaged_files_and_those_of_another_eye_are_made_again_and_said(folder, made, capsys):
    other = SCENE.replace(eye=EYE.replace(iris_depth=3.8))
    cached_tables(other)
    (file,) = folder.iterdir()
    data, file = file.read_bytes(), folder / key(EYE, False)
    middle = len(data) // 2
    flipped = data[:middle] + bytes([data[middle] ^ 1]) + data[middle + 1 :]
    for count, contents in enumerate((data, flipped, b""), 2):
        file.write_bytes(contents)
        again = cached_tables(SCENE)
        said = f"irisjax: {file}: not usable (damaged, or tables of another eye); made again\n"
        assert capsys.readouterr().err == said
        equal(cached_tables(SCENE), again)
        assert len(made) == count and capsys.readouterr().err == ""


def test_a_folder_that_cannot_be_written_costs_a_line(folder, made, capsys):
    folder.write_text("")
    found = cached_tables(SCENE)
    assert found.flux.shape == (2, 5, 5, 3)
    err = capsys.readouterr().err
    assert "could not be kept" in err and err.count("\n") == 1


def test_the_folder_stays_small(folder, made):
    folder.mkdir()
    (folder / ".x.123.tmp").write_bytes(b"")
    os.utime(folder / ".x.123.tmp", (0, 0))
    eyes = [EYE.replace(iris_depth=3.6 + 0.01 * i) for i in range(MOST_TABLES + 3)]
    for i, eye in enumerate(eyes):
        cached_tables(SCENE.replace(eye=eye))
        os.utime(folder / key(eye, False), (i, i))
        cached_tables(SCENE.replace(eye=eyes[0]))  # in use all the time, so that it stays
    kept = {key(eye, False) for eye in (eyes[0], *eyes[4:])}
    assert {p.name for p in folder.iterdir()} == kept and len(kept) == MOST_TABLES
    assert len(made) == len(eyes)


def test_many_at_once_get_the_same_file(folder, made):
    with ThreadPoolExecutor(4) as pool:
        list(pool.map(cached_tables, [SCENE] * 4))
    (file,) = folder.iterdir()
    assert compiled._read_tables(file).flux.shape == (2, 5, 5, 3)


def test_where_the_command_keeps_them(monkeypatch, tmp_path, made):
    monkeypatch.setenv("JAX_COMPILATION_CACHE_DIR", "")
    assert compiled.cache_folder() is None
    assert cached_tables(SCENE) is not None
    monkeypatch.setenv("JAX_COMPILATION_CACHE_DIR", str(tmp_path / "named"))
    cached_tables(SCENE)
    assert len(list((tmp_path / "named" / "illumination").iterdir())) == 1
    monkeypatch.delenv("JAX_COMPILATION_CACHE_DIR")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert compiled.cache_folder() == tmp_path / "irisjax"
    assert len(made) == 2
