"""`irisjax export`: an eye for other renderers."""

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from irisjax.cli.options import Group, grouped, option
from irisjax.cli.scenes import EyeWithPupil, changed
from irisjax.export.handover import check_folder
from irisjax.export.handover import export as write
from irisjax.numerics.checks import Range, check_range
from irisjax.render.albedo import CONE

_MODELS = "separable", "radiative-transfer"


@dataclass(frozen=True, kw_only=True)
class Handover(Group):
    """How fine the eye is handed over, and where to."""

    PANEL = "Files"

    integrator: Annotated[
        str | None,
        option(
            metavar="name",
            help=f"whose albedo and BRDF: {', '.join(_MODELS)}; default: the scene's, separable",
        ),
    ] = None
    spacing: Annotated[float, option(metavar="MM", help="size of the triangles, 0.02 to 2")] = 0.1
    output: Annotated[
        Path, option("-o", "--output", metavar="FOLDER", help="a new or empty folder")
    ] = Path("eye")

    def __post_init__(self):
        super().__post_init__()
        if self.integrator is not None and self.integrator not in _MODELS:
            raise ValueError(
                f"--integrator: unknown {self.integrator!r}; known: {', '.join(_MODELS)}"
            )
        check_range("--spacing", self.spacing, Range(0.02, 2, "mm"))


@grouped
def export(subject: EyeWithPupil, handover: Handover) -> None:
    """An eye for other renderers: meshes, textures, a BRDF table, a scene for Mitsuba 3.

    README.txt in the folder says what each file is, and how far a matt iris is
    from the model. Simulated.
    """
    output = handover.output
    check_folder(output)
    scene = subject.read().scene(handover.integrator)
    scene = changed(scene, pupil_radius=subject.pupil_radius)
    made = write(output, scene, spacing=handover.spacing)
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
