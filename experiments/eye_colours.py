"""The made-up eye colours by ILIT and by radiative transfer: pictures, and the mean colour of their
ciliary zone beside that of photographed irides; all simulated.
"""

import numpy as np

import irisjax as ij
from experiments.common import RESULTS, start, write
from irisjax.anatomy.eye import Eye
from irisjax.grow.presets import PRESETS
from irisjax.io import write_png
from irisjax.measure.colour import OBSERVER, lab_of, srgb_encode, tristimulus_matrix
from irisjax.render.bands import BAND_GRID
from irisjax.render.camera import Camera
from irisjax.render.environment import Environment
from irisjax.render.integrators import INTEGRATORS
from irisjax.render.picture import illuminate, respond, shade, texture
from irisjax.render.project import project
from irisjax.render.scene import Scene

MODELS = "separable", "radiative-transfer"
CILIARY = 0.4, 0.9
"""Between pupil (0) and root (1)."""


def main(key, quick=False, out=RESULTS):
    """Write pictures (a row a model, a column a colour) and mean colours (quick: small)."""
    side, shape = (24, (96, 32)) if quick else (240, (768, 256))
    eye, camera = Eye(), Camera(size=(side, side), width=12.6)
    tables, view = Scene(ij.Iris(), eye=eye).tables(), project(eye, camera)
    seen = view.iris
    radius = np.hypot(*(np.asarray(x) for x in seen.point[:2]))
    place = np.asarray(eye.relative_radius(radius))
    zone = (place > CILIARY[0]) & (place < CILIARY[1]) & (np.asarray(seen.share) > 0)
    xyz, rgb = (
        np.asarray(tristimulus_matrix(BAND_GRID, space, "D65", OBSERVER)[0])
        for space in ("XYZ", "linear sRGB")
    )
    to_xyz = xyz @ np.linalg.pinv(rgb)
    rows, sheet = [], []
    for model in MODELS:
        integrator, row = INTEGRATORS[model](), []
        for colour, grow in PRESETS.items():
            iris, maps = grow(eye, process=integrator.process, shape=shape, key=key)
            parts = {"eye": eye, "camera": camera, "integrator": integrator, "lights": None}
            scene = Scene(iris, maps, environment=Environment.studio(), **parts)
            texels = texture(view, scene)
            lit = illuminate(view, texels, scene, tables)
            picture = np.asarray(shade(view, texels, lit, respond(scene)))
            row.append(picture)
            # Without what the tear film mirrors.
            own = picture.reshape(-1, 3) - np.asarray(lit.surroundings).T
            mean = own[zone].mean(0)
            lab = np.asarray(lab_of(to_xyz @ mean / (to_xyz @ np.ones(3))))
            rows.append((colour, model, *map(float, lab)))
        sheet.append(np.concatenate(row, axis=1))
    encoded = np.asarray(srgb_encode(np.clip(np.concatenate(sheet), 0, 1)))
    out.mkdir(parents=True, exist_ok=True)
    write_png(
        out / "eye_colours.png",
        encoded,
        remark=f"simulated by irisjax; rows: {', '.join(MODELS)}; columns: {', '.join(PRESETS)}",
    )
    write(
        out / "eye_colours.csv",
        (
            "simulated by irisjax; mean of the ciliary zone in a studio, under D65 against a white "
            "sheet,",
            "without what the tear film mirrors; CIE 1931 2 degree",
        ),
        ("colour", "integrator", "L", "a", "b"),
        rows,
    )


if __name__ == "__main__":
    start(main, __doc__)
