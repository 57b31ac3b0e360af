"""A small eye for the viewer."""

import contextlib
import importlib.machinery
import io
import sys
from types import ModuleType

import jax
import pytest
from small import grown

from irisjax import cli
from irisjax.anatomy.eye import Eye
from irisjax.ocularist import painting
from irisjax.render.camera import Camera
from irisjax.render.scene import Scene
from render.small_scenes import QUICK


@pytest.fixture(autouse=True)
def _without_vessels(monkeypatch):
    """Painted eyes need none here: a second to grow each time."""
    monkeypatch.setattr(painting, "veins", lambda eye, key: None)


@pytest.fixture
def bare():
    """A bare iris in air, small: nothing to tabulate."""
    return Scene(
        *grown(), Eye(cornea=None, sclera=None), camera=Camera(size=(16, 12)), integrator=QUICK
    )


@pytest.fixture
def viser(monkeypatch):
    """A stand-in where it is not installed."""
    if "viser" not in sys.modules:
        module = ModuleType("viser")
        module.__spec__ = importlib.machinery.ModuleSpec("viser", None)
        monkeypatch.setitem(sys.modules, "viser", module)


@pytest.fixture
def complaint():
    """What the command says in one line."""
    before = jax.config.read("jax_enable_x64")

    def run(*arguments):
        out = io.StringIO()
        with contextlib.redirect_stderr(out):
            assert cli.run(["view", "--port", "0", *map(str, arguments)]) == 2
        assert out.getvalue().count("\n") == 1
        return out.getvalue()

    yield run
    jax.config.update("jax_enable_x64", before)
