"""`irisjax export`: an eye for other renderers."""

from pathlib import Path

import numpy as np
import typer

from irisjax.cli import options as opt
from irisjax.cli.scenes import EyeWithPupil
from irisjax.export.handover import FORMS, check_new_folder, export_scene
from irisjax.numerics.checks import Range
from irisjax.render.albedo import CONE


class Handover(opt.Group, panel="Files"):
    integrator: str | None = opt.choice(
        "whose albedo and BRDF; default: the scene's, separable",
        ("separable", "radiative-transfer"),
    )
    format: str = opt.choice("glb adds eye.glb (glTF 2, metres) and its textures", FORMS, "obj")
    spacing: float = opt.number("size of the triangles, {}", Range(0.02, 2, "mm"), 0.1)
    output: Path = opt.output("a new or empty folder", "FOLDER", Path("eye"))


@opt.grouped
def export_command(subject: EyeWithPupil, handover: Handover) -> None:
    """Write an eye for other renderers: meshes, textures, a BRDF table, a scene for Mitsuba 3;
    with `--format glb` a glTF 2 binary too.

    README.txt in the folder describes each file and states how far a matt iris is
    from the model. Simulated.
    """
    output = handover.output
    check_new_folder(output)
    scene = subject.scene_of(subject.read(), handover.integrator)
    made = export_scene(output, scene, spacing=handover.spacing, form=handover.format)
    errors = ", ".join(f"{100 * v:.2g} %" for v in np.asarray(made.error.rms))
    typer.echo(
        f"{output}: {len(made.files)} files; a matt iris is off by {errors} (R, G, B) within "
        f"{CONE:g}° of its normal"
    )
    if made.clipped:
        opt.notice(f"{output}: {made.clipped} texels out of sRGB's range are clipped")
