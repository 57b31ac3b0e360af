"""`irisjax view`: the interactive viewer."""

import dataclasses
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import jax
import typer

from irisjax import _interrupt
from irisjax.cli.cache import cores, kept_tables
from irisjax.cli.options import Group, grouped, option, whole
from irisjax.cli.scenes import Subject, changed
from irisjax.io.clone_folders import read_clone
from irisjax.view import Studio, check, serve


@dataclass(frozen=True, kw_only=True)
class Shown(Subject):
    """Which eye, or which clone of one."""

    scene: Annotated[
        Path | None,
        typer.Argument(
            metavar="SCENE|DIR",
            help="scene file (TOML; data/scenes/everything.toml explains it), or the folder of a "
            "clone, shown beside its photograph",
            show_default=False,
        ),
    ] = None


@dataclass(frozen=True, kw_only=True)
class Window(Group):
    """Where it is shown."""

    PANEL = "Picture"

    size: Annotated[str | None, option(metavar="WIDTHxHEIGHT", help="of the picture, 800x600")] = (
        None
    )
    host: Annotated[str, option(metavar="name", help="0.0.0.0 shows it to the whole network")] = (
        "127.0.0.1"
    )
    port: Annotated[
        int, option(parse=whole(0, 65535), metavar="number", help="0 to 65535; 0 takes a free one")
    ] = 8080


@grouped
def view(subject: Shown, window: Window) -> None:
    r"""An eye in the browser, with sliders, its spectrum and its colour.

    Sliders for pigments, layers, pupil and light; drag to orbit, scroll to zoom.
    Without a scene the eye is blue. Ctrl-C ends it.
    Needs the extra: pip install 'irisjax\[view]'. Simulated.
    """
    check(window.host, window.port)
    if subject.scene is None and subject.preset is None:
        subject = dataclasses.replace(subject, preset="blue")
    photograph = None
    if subject.scene is not None and subject.preset is None and subject.scene.is_dir():
        file, photograph = read_clone(subject.scene)
    else:
        file = subject.read()
    # Half the time of double precision, and the same picture to one level of 255 but for some
    # pixels.
    jax.config.update("jax_enable_x64", False)
    given: dict[str, Any] = {"exposure": file.exposure}
    if subject.preset is not None:
        given |= {"preset": subject.preset, "seed": subject.seed, "environment": "studio"}
    scene = changed(file.scene(), size=window.size)
    studio = Studio(scene, kept_tables, threads=cores(), photograph=photograph, **given)

    def ready(address: str) -> None:
        _interrupt.expect()
        typer.echo(f"irisjax: {address}  (Ctrl-C ends it)")

    serve(studio, window.host, window.port, ready=ready)
