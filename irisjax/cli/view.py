"""`irisjax view`: the interactive viewer."""

from pathlib import Path
from typing import Annotated

import jax
import typer

from irisjax.cli.cache import kept_tables
from irisjax.cli.render import changed, scene_file
from irisjax.grow.presets import PRESETS
from irisjax.view import Studio, check, serve


def view(
    scene: Annotated[
        Path | None, typer.Argument(help="scene file (TOML)", show_default=False)
    ] = None,
    preset: Annotated[
        str | None, typer.Option(help=", ".join(PRESETS) + "; blue without a scene")
    ] = None,
    seed: Annotated[int, typer.Option(min=0, max=2**32 - 1, help="of a preset's maps")] = 0,
    size: Annotated[
        str | None, typer.Option(metavar="WIDTHxHEIGHT", help="of the picture, 800x600")
    ] = None,
    host: Annotated[str, typer.Option(help="0.0.0.0 shows it to the whole network")] = "127.0.0.1",
    port: Annotated[int, typer.Option(min=0, max=65535, help="0 takes a free one")] = 8080,
) -> None:
    r"""An eye in the browser, with sliders for pigments, layers, pupil and light, its spectrum and
    its colour.

    Drag to orbit, scroll to zoom. Ctrl-C ends it. Needs the extra: pip install 'irisjax\[view]'.
    Simulated.
    """
    check(host, port)
    preset = "blue" if scene is None and preset is None else preset
    file = scene_file(scene, preset, seed)
    # Half the time of double precision, and the same picture to one level of 255 but for some
    # pixels.
    jax.config.update("jax_enable_x64", False)
    given = {"exposure": file.exposure}
    if preset is not None:
        given |= {"preset": preset, "seed": seed, "environment": "studio"}
    studio = Studio(changed(file.scene(), size=size), kept_tables, **given)
    serve(
        studio,
        host,
        port,
        ready=lambda address: typer.echo(f"irisjax: {address}  (Ctrl-C ends it)"),
    )
