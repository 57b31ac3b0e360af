"""`irisjax export`: an eye for other renderers."""

import sys
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from irisjax.cli.render import changed, scene_file
from irisjax.export.handover import CONE, check_folder
from irisjax.export.handover import export as write
from irisjax.grow.presets import PRESETS


def export(
    scene: Annotated[
        Path | None, typer.Argument(help="scene file (TOML)", show_default=False)
    ] = None,
    preset: Annotated[str | None, typer.Option(help=", ".join(PRESETS))] = None,
    seed: Annotated[int, typer.Option(min=0, max=2**32 - 1, help="of a preset's maps")] = 0,
    pupil: Annotated[str | None, typer.Option(metavar="MM", help="diameter, 0.5 to 9.5")] = None,
    spacing: Annotated[
        float, typer.Option(metavar="MM", help="size of the triangles, 0.02 to 2")
    ] = 0.1,
    output: Annotated[Path, typer.Option("-o", "--output", help="a new or empty folder")] = Path(
        "eye"
    ),
) -> None:
    """An eye for other renderers: meshes, textures in the iris's uv, a BRDF table, and a scene for
    Mitsuba 3.

    README.txt in the folder says what each file is, and how far a matt iris is from the model.
    Simulated.
    """
    if not 0.02 <= spacing <= 2:
        raise ValueError(f"--spacing {spacing:g} is outside 0.02 to 2 mm")
    check_folder(output)
    found = changed(scene_file(scene, preset, seed).scene(), pupil=pupil)
    made = write(output, found, spacing=spacing)
    off = ", ".join(f"{100 * v:.2g} %" for v in np.asarray(made.error.rms))
    typer.echo(
        f"{output}: {len(made.files)} files; a matt iris is off by {off} (R, G, B) within "
        f"{CONE:g}° of its normal"
    )
    if made.clipped:
        print(
            f"irisjax: {output}: {made.clipped} texels out of sRGB's range are clipped",
            file=sys.stderr,
        )
