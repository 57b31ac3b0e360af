"""Thickness of clones of all simulated photographs against the truth, where light comes.

With `--photographs`, of others that `experiments.simulated_photographs --seed` made: nothing of the
package was chosen by what comes out for those.

A part is well lit where neither the limbus nor a lid takes light away: what a lid takes is seen by
the clean photograph of the same eye. Correlations are of deviations from the mean at a radius.
"""

import argparse
import json
from pathlib import Path

import jax
import numpy as np
from scipy import ndimage

from experiments.clone_thickness import ABOUT
from experiments.clone_truth import correlation, true_thickness
from experiments.common import RESULTS, write
from experiments.simulated_photographs import FOLDER
from irisjax.io.photographs import read_photograph
from irisjax.photo.clone import CloneSettings, Fitted, clone_eye, compare_with_photograph
from irisjax.photo.light import find_shade
from irisjax.photo.masks import cut_part
from irisjax.photo.texture import LUMINANCE_WEIGHTS, unrefract

TAKEN = 0.2
"""Of the light, by a lid: more is not well lit."""
SMOOTH = 6.0
"""Standard deviation of what light is compared by, pixels: fibres and noise are narrower."""


def main(key, quick=False, out=RESULTS, folder=FOLDER, seed=None):
    """Write a CSV (quick: one photograph)."""
    del key  # a clone up to its pigments draws no random numbers
    every = json.loads((folder / "truth.json").read_text(encoding="utf-8"))["photographs"]
    files = [p["file"] for p in every][: 1 if quick else None]
    name, about = "clone_light", ABOUT
    if seed is not None:
        name = "clone_light_held_out"
        about = (f"clones of what simulated_photographs --seed {seed} makes, all simulated",)
    write(out / f"{name}.csv", about, _COLUMNS, (_row(folder, f) for f in files))


_COLUMNS = (
    *("photograph", "share_known", "correlation", "spread"),
    *("share_beside_limbus_shade", "correlation_beside_limbus_shade"),
    *("share_well_lit", "correlation_well_lit", "spread_well_lit"),
    *("rms_red", "rms_green", "rms_blue"),
)


def _row(folder: Path, file: str) -> tuple:
    *_, found = clone_eye(read_photograph(folder / file), CloneSettings(), last="pigments")
    assert isinstance(found, Fitted)
    texture, light = found.texture, found.lighting
    truth = true_thickness(file.split("_")[0].removesuffix(".jpg"), texture, folder)
    room = found.fit.values["room"] if light.room else 0.0
    shade = find_shade(texture, light.lights(), room, found.pose.eye, found.tables)
    beside = truth.used & ~shade
    lit = beside & (_light_left(found, folder, file, beside) > 1 - TAKEN)
    whole = np.pi * (texture.iris_radius**2 - texture.pupil_radius**2)
    share = [float(u.sum() * texture.millimetres_per_texel**2 / whole) for u in
             (truth.used, beside, lit)]  # fmt: skip
    scores = [correlation(found, truth.thickness, u) for u in (truth.used, beside, lit)]
    both = (share[0], *scores[0], share[1], scores[1][0], share[2], *scores[2])
    return (file, *both, *compare_with_photograph(found).rms)


def _light_left(found: Fitted, folder: Path, file: str, usual) -> np.ndarray:
    """At each texel, share of the light that the same eye gets without lids."""
    limbus = found.boundaries.limbus
    seen, bare = (
        ndimage.gaussian_filter(cut_part(p, limbus).pixels @ LUMINANCE_WEIGHTS, SMOOTH)
        for p in (read_photograph(folder / f) for f in (file, file.replace("_dirty", "")))
    )
    ratio = np.repeat((seen / np.maximum(bare, 1e-6))[..., None], 3, -1).astype(np.float32)
    every = np.ones(seen.shape, bool)
    flat = unrefract(ratio, every, found.pose, found.refraction).pixels[..., 0]
    return flat / np.median(flat[usual])


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="a small version, for tests")
    parser.add_argument("--out", type=Path, default=RESULTS, help="folder for the results")
    parser.add_argument("--photographs", type=Path, default=FOLDER, help="folder with their truth")
    parser.add_argument("--seed", type=int, help="that they were made with, if not the project's")
    options = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    main(None, options.quick, options.out, options.photographs, options.seed)
