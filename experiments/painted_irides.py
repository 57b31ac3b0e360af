"""Painted irides after L03 Figs. 3, 4, 5, 8, 9 and 10, and what a picture of them costs by the
number of coats.
"""

import io
import subprocess
import sys
import tempfile
import time
import tomllib
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import skimage
from PIL import Image

from experiments.common import RESULTS, start, write
from experiments.mitsuba_photographs import FOLDER
from irisjax.io import read_image, write_atomically
from irisjax.measure.colour import srgb_encode
from irisjax.ocularist.coats import Coat, Painting, prosthesis
from irisjax.ocularist.components import COMPONENTS, component
from irisjax.ocularist.integrator import Painted
from irisjax.ocularist.kubelka_munk import KubelkaMunkMixer
from irisjax.ocularist.mixing import PAINTS, HslMixer
from irisjax.ocularist.painting import painted, studio
from irisjax.ocularist.recipes import coats
from irisjax.render.camera import Camera
from irisjax.render.environment import ENVIRONMENTS
from irisjax.render.picture import LitView, draw, respond, shade, surroundings, texture
from irisjax.render.project import project_visible

ABOUT = "painted and simulated by irisjax"
BASES = (("detail", "blue", 0), ("detail", "blue", 1), ("dit-dot", "blue", 2))
BASES += (("dit-dot", "green", 3), ("smeared", "brown", 4))
"""Type, colour and seed of the eyes whose first coats are shown."""
STAGES = 10


def main(key, quick=False, out=RESULTS):
    """Write strips of pictures as JPEG, mixtures and times (quick: small, without times)."""
    side, size = (40, 64) if quick else (240, 512)
    eye, seed = prosthesis(), int(jax.random.key_data(key)[-1])
    tables = studio(_painting("smeared", "brown", seed, eye, 64), eye).tables()

    def picture(painting, polar=0.0):
        camera = Camera(polar=jnp.asarray(polar), width=jnp.asarray(12.6), size=(side, side))
        scene = studio(painting, eye, camera=camera, seed=seed)
        return np.asarray(draw(scene, tables))

    def save(name, panels):
        encoded = np.asarray(srgb_encode(jnp.clip(np.concatenate(panels, axis=1), 0, 1)))
        data = io.BytesIO()
        Image.fromarray(np.rint(255 * encoded).astype(np.uint8)).save(
            data, "jpeg", quality=88, comment=ABOUT
        )
        write_atomically(out / f"{name}.jpg", data.getvalue())

    out.mkdir(parents=True, exist_ok=True)
    pupil = float(eye.pupil_radius / eye.iris_radius)
    save(
        "painted_fig3",
        [
            np.repeat((1 - component(n).opacity(side, pupil, key=key))[..., None], 3, -1)
            for n in COMPONENTS
        ],
    )
    save(
        "painted_fig5",
        [picture(_first(_painting(*eye_of, eye, size), 5)) for eye_of in BASES],
    )
    green = _painting("dit-dot", "green", seed, eye, size)
    counts = np.unique(np.linspace(1, len(green.coats), STAGES).round().astype(int))
    save("painted_fig9", [picture(_first(green, int(n))) for n in counts])
    brown, blue = (
        _painting(kind, colour, seed, eye, size)
        for kind, colour in (("smeared", "brown"), ("detail", "blue"))
    )
    save("painted_fig10", [picture(brown), picture(blue), picture(blue, np.radians(40.0))])
    _mixtures(out)
    if not quick:
        save("painted_fig8", _copied(FOLDER / "green.jpg", side))
        _environments(blue, eye, out)
        _times(blue, eye, tables, out)


def _painting(kind: str, colour: str, seed: int, eye, size: int) -> Painting:
    return painted(coats(kind, colour, seed=seed), HslMixer.default(), eye, size=size)


def _first(painting: Painting, count: int) -> Painting:
    return Painting(painting.coats[:count], painting.profile)


def _mixtures(out) -> None:
    """Equal parts of each pair of paints, both ways."""
    rows = []
    for way, mixer in (("hsl", HslMixer.default()), ("kubelka-munk", KubelkaMunkMixer.default())):
        for first in PAINTS:
            for second in PAINTS:
                rows.append((way, first, second, *map(float, mixer.mix(first, second, 0.5))))
    columns = ("mixing", "first", "second", "r_linear", "g_linear", "b_linear")
    write(out / "painted_mixtures.csv", (ABOUT, "equal parts, linear sRGB"), columns, rows)


def _copied(photograph: Path, side: int) -> list[np.ndarray]:
    """A photographed eye, its clone, and paint matched to the clone's texture, linear."""

    def run(*command) -> None:
        done = subprocess.run([sys.executable, "-m", "irisjax", *map(str, command)], check=False)
        if done.returncode not in (0, 3):  # 3: with doubts, which the command prints
            raise RuntimeError(f"irisjax {command[0]} failed with status {done.returncode}")

    with tempfile.TemporaryDirectory() as made:
        clone, paint, size = Path(made) / "clone", Path(made) / "paint", f"{side}x{side}"
        run("clone", photograph, "-o", clone)
        scene = tomllib.loads((clone / "scene.toml").read_text(encoding="utf-8"))
        run("render", clone / "scene.toml", "--size", size, "-o", clone / "eye.png")
        lamps = [
            f"{lamp['polar_deg']},{lamp['azimuth_deg']},"
            f"{lamp['irradiance'] * scene['picture']['exposure']}"
            for lamp in scene["light"]
        ]
        seen = [option for lamp in lamps for option in ("--light", lamp)]
        seen += ["--size", size, "--camera", f"0,0,{scene['camera']['width']}"]
        run("paint", "--match", clone, *seen, "-o", paint)
        files = clone / "photograph.png", clone / "eye.png", paint / "eye.png"
        panels = [read_image(file, decode=True).pixels[..., :3] for file in files]
    panels[0] = skimage.transform.resize(panels[0], (side, side), anti_aliasing=True)
    return panels


def _environments(blue: Painting, eye, out) -> None:
    """How far few lamps in place of an environment are from 64, on the iris, in levels of 255."""
    rows, (width, height) = [], (400, 300)
    for kind in ("studio", "sky"):
        around = ENVIRONMENTS[kind](rows=256)
        camera = Camera(width=jnp.asarray(16.5), size=(width, height))
        scene = studio(blue, eye, lights=None, environment=around, camera=camera)
        tables, pictures = scene.tables(), {}
        for count in (64, 25, 16, 9, 4):
            drawn = draw(scene.replace(environment_lights=count), tables)
            pictures[count] = 255 * np.clip(np.asarray(srgb_encode(drawn)), 0, 1)
        x, y = (16.5 * ((np.arange(n) + 0.5) - n / 2) / width for n in (width, height))
        away = np.hypot(x, y[:, None])
        iris = (away > 2.2) & (away < 5.5)
        for count, picture in pictures.items():
            off = np.abs(picture - pictures[64])[iris]
            rows.append((kind, count, off.mean(), np.quantile(off, 0.95)))
    write(
        out / "painted_environments.csv",
        (ABOUT, "blue eye of 50 coats, 400 x 300 pixels, encoded sRGB against 64 lamps"),
        ("environment", "lamps", "mean_levels", "q95_levels"),
        rows,
    )


def _timed(painted, parts, known, base=None, before=None):
    """Seconds of a picture, and what is kept of its paint."""
    view, texels, around, response = known
    begin = time.perf_counter()
    base = painted.base(*parts) if base is None else base
    steps = dict(before or {})
    light = LitView(around, painted.paint(base, steps))
    shade(view, texels, light, response).block_until_ready()
    return time.perf_counter() - begin, base, steps


def _times(blue: Painting, eye, tables, out) -> None:
    """Seconds of pictures of 800 × 600 pixels with two lamps, two threads, warm."""
    rows, other = [], jnp.asarray([0.4, 0.2, 0.1])
    for count in (10, 20, 30, 40, 50, 70):
        scene = studio(_first(_doubled(blue), count), eye)

        view = project_visible(scene.eye, scene.camera)
        texels, response = texture(view, scene), respond(scene)
        around = surroundings(view, texels, scene)
        parts = view.iris, scene.all_lights(), scene.eye, tables

        known = view, texels, around, response

        painting = scene.integrator.painting
        changed = [painting.coats[i].name for i in (-1, count // 2, 0)]
        others = [Painted(painting=painting.replace(name, colour=other)) for name in changed]
        found = []
        for _ in range(4):
            whole, base, steps = _timed(scene.integrator, parts, known)
            again = (_timed(painted, parts, known, base, steps)[0] for painted in others)
            found.append((whole, *again))
        rows.append((count, *(float(v) for v in np.median(found[1:], axis=0))))
    write(
        out / "painted_times.csv",
        (ABOUT, "800 x 600 pixels, two lamps, maps of 512 x 512, float64, two threads, warm"),
        ("coats", "whole_s", "top_recoloured_s", "middle_recoloured_s", "base_recoloured_s"),
        rows,
    )


def _doubled(painting: Painting) -> Painting:
    """All coats but the base once more on top."""
    top = painting.coats[-1].height
    again = (
        Coat(f"again {c.name}", c.opacity, c.colour, top + c.height) for c in painting.coats[1:]
    )
    return Painting((*painting.coats, *again), painting.profile)


if __name__ == "__main__":
    start(main, __doc__)
