"""`irisjax view`: the interactive viewer."""

import dataclasses
from functools import partial
from pathlib import Path
from typing import Any

import jax
import typer

from irisjax import _interrupt
from irisjax.cli import options as opt
from irisjax.cli.compiled import cached_tables
from irisjax.cli.paints import PaintOptions, check_no_seed
from irisjax.cli.scenes import Subject, change_scene
from irisjax.io.clone_folders import read_clone
from irisjax.numerics.checks import Range
from irisjax.view import Bench, Studio, check_address, serve


class ViewSubject(Subject):
    scene: Path | None = opt.argument(
        "scene file (TOML; data/scenes/everything.toml explains it), or the folder of a clone, "
        "shown beside its photograph",
        "SCENE|DIR",
    )
    seed: int = opt.seeded("maps of a preset, and coats of a --type")


class Coats(PaintOptions, panel="A painted eye"):
    recipe: Path | None = opt.option("coats of paint (TOML), as paint takes them", metavar="RECIPE")


class Window(opt.Group, panel="Picture"):
    size: str | None = opt.option("of the picture, 800x600", metavar="WIDTHxHEIGHT")
    host: str = opt.option("0.0.0.0 shows it to the whole network", "127.0.0.1", metavar="name")
    port: int = opt.whole("{}; 0 takes a free one", Range(0, 65535), 8080, metavar="number")


@opt.grouped
def view_command(subject: ViewSubject, coats: Coats, window: Window) -> None:
    r"""Show an eye in the browser, with sliders, its spectrum and its colour; or a painted one.

    Sliders for pigments, layers, pupil and light; drag to orbit, scroll to zoom.
    Without a scene the eye is blue. A painted eye (--recipe, or --type and --colour) has
    coats to be switched, recoloured, reordered and saved instead. Ctrl-C ends it.
    Needs the extra: pip install 'irisjax\[view]'. Simulated.
    """
    check_address(window.host, window.port)
    painted = coats.painted()
    if painted and (subject.scene is not None or subject.preset is not None):
        raise ValueError("give one eye: SCENE, --preset, --recipe or --type")
    if coats.recipe is not None:
        check_no_seed(subject.typed)
    # Single precision takes half the time, for the same picture to one level of 255 but for some
    # pixels.
    jax.config.update("jax_enable_x64", False)
    if painted:
        recipe = coats.read(subject.seed)
        with coats.in_file():
            content = Bench(recipe, partial(change_scene, size=window.size), cached_tables)
    else:
        content = _studio(subject, window.size)

    def ready(address: str) -> None:
        _interrupt.expect()
        typer.echo(f"irisjax: {address}  (Ctrl-C ends it)")

    serve(content, window.host, window.port, ready=ready)


def _studio(subject: ViewSubject, size: str | None) -> Studio:
    if subject.scene is None and subject.preset is None:
        subject = dataclasses.replace(subject, preset="blue")
    photograph = None
    if subject.scene is not None and subject.preset is None and subject.scene.is_dir():
        file, photograph = read_clone(subject.scene)
        file = subject.changing(file)
    else:
        file = subject.read()
    settings: dict[str, Any] = {"exposure": file.exposure, "photograph": photograph, "file": file}
    if subject.preset is not None:
        settings |= {"preset": subject.preset, "seed": subject.seed, "environment": "studio"}
    return Studio(change_scene(file.scene(), size=size), cached_tables, **settings)
