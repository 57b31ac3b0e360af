"""The search for a clone's pigments: F09's simplex under its own premises (exposure, light and
scattering measured before) and without them, and what `irisjax clone` does, for F09 Fig. 19; all
simulated.
"""

from dataclasses import replace

import numpy as np
import skimage.transform

from experiments.clone_thickness import (
    ABOUT,
    EYES,
    brightened,
    clone_by_f09,
    clone_to_texels,
    simulated,
    write_jpeg,
)
from experiments.clone_truth import premises
from experiments.common import RESULTS, start, write
from irisjax.photo.clone import CloneSettings, Fitted, compare_with_photograph
from irisjax.photo.pigments import CONCENTRATIONS, simplex
from irisjax.photo.thickness import BETA, SIGMA

STEPS = 1, 4, 12, 50
"""Steps of the simplex under its premises, at which its path is kept."""
SHOWN = {"start": 1, "middle": 12, "end": 50}
"""Steps of the simplex whose pictures are kept; those of the end with the ratios sought too."""
SIDE = 220
"""Of a picture, pixels."""
FILE = "clone_search"


def main(key, quick=False, out=RESULTS):
    """Write paths, cumulative differences and pictures (quick: one eye, a third as large)."""
    del key  # a clone up to its texels draws no random numbers
    steps = STEPS[:2] if quick else STEPS
    path, differences, pictures = [], [], []
    for colour in EYES[:1] if quick else EYES:
        photograph, row = simulated(colour, quick), []
        measured = clone_by_f09(photograph, colour, CloneSettings(beta=BETA, sigma=SIGMA))
        known, fits = premises(colour)[1], {}
        for count in steps:
            fits[count] = simplex(measured.windows, measured.base, known, count)
            path.append((colour, "simplex", count, *_numbers(fits[count].log[0])))
        path.append((colour, "simplex", 2 * count, *_numbers(fits[count].log[1])))
        stages = {n: replace(measured, fit=fits[min(at, count)]) for n, at in SHOWN.items()}
        # A photograph of which nothing is known but itself.
        alone = clone_to_texels(photograph)
        fit = simplex(alone.windows, alone.base, max_steps=count)
        path.append((colour, "nothing known", 2 * count, *_numbers(fit.log[1])))
        values = {**alone.fit.values, "rms": float(alone.fit.rms.mean())}
        path.append((colour, "least squares", alone.fit.steps, *_numbers(values)))
        bare = replace(alone, texels=None, fit=fit, exposure=np.ones(3))
        stages |= {"nothing known": bare, "texels": alone}
        for name, at in stages.items():
            both, off, rms = _compared(at)
            row += both if not row else both[1:]
            differences += [(colour, name, step, *share, *rms) for step, share in off]
        pictures.append(np.concatenate(row, 1))
    out.mkdir(parents=True, exist_ok=True)
    write_jpeg(out / f"{FILE}.jpg", np.concatenate(pictures))
    write(out / f"{FILE}.csv", ABOUT, ("eye", "method", "steps", *CONCENTRATIONS, "rms"), path)
    shares = tuple(f"{which}_{c}" for which in ("share", "rms") for c in "rgb")
    columns = "eye", "stage", "difference", *shares
    write(out / f"{FILE}_differences.csv", ABOUT, columns, differences)


def _numbers(values: dict[str, float]):
    return (*(values[n] for n in CONCENTRATIONS), values["rms"])


def _compared(found: Fitted):
    """Photograph and picture by the pigments alone, reduced; shares of the pixels that differ by at
    most so many of 255 steps; RMS per channel.
    """
    both = compare_with_photograph(found)
    off = 255 * np.abs(both.photograph - both.pigments)[both.clear]
    shares = [
        (step, [float((off[:, k] <= step).mean()) for k in range(3)]) for step in range(0, 121, 2)
    ]
    small = [
        skimage.transform.resize(brightened(p), (SIDE, SIDE), anti_aliasing=True)
        for p in (both.photograph, both.pigments)
    ]
    return small, shares, [float(r) for r in both.rms_of_pigments]


if __name__ == "__main__":
    start(main, __doc__)
