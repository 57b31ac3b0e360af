"""The search for a clone's pigments, F09's simplex beside least squares: its path, and the pictures
on its way, for F09 Fig. 19; all simulated.
"""

from dataclasses import replace

import numpy as np
import skimage.transform

from experiments.clone_thickness import ABOUT, EYES, brightened, simulated, write_jpeg
from experiments.common import RESULTS, start, write
from irisjax.photo.clone import CloneSettings, Fitted, clone_to_pigments, compare_with_photograph
from irisjax.photo.pigments import CONCENTRATIONS, fit_pigments, simplex

STEPS = 1, 2, 4, 12, 50
"""Of the searches, where their path is kept; of the simplex those for the eumelanins."""
SHOWN = {"start": 1, "middle": 12, "end": 50}
"""Steps of the simplex whose pictures are kept; those of the end with the ratios sought too."""
SIDE = 220
"""Of a picture, pixels."""
FILE = "clone_search"


def main(key, quick=False, out=RESULTS):
    """Write paths, cumulative differences and pictures (quick: one eye, a third as large)."""
    del key  # a clone up to its pigments draws no random numbers
    steps = STEPS[:2] if quick else STEPS
    path, differences, pictures = [], [], []
    for colour in EYES[:1] if quick else EYES:
        found = clone_to_pigments(simulated(colour, quick), CloneSettings())
        known, row = (found.windows, found.base), []
        for count in steps:
            log = simplex(*known, count).log
            print(f"{colour}: {count} steps", flush=True)
            path.append((colour, "simplex", count, *_numbers(log[0]), 1.0))
            if count == steps[-1]:
                path.append((colour, "simplex", 2 * count, *_numbers(log[1]), 1.0))
            least = fit_pigments(*known, count)
            values = {**least.values, "rms": float(least.rms.mean())}
            path.append((colour, "least squares", count, *_numbers(values), values["exposure"]))
        fits = {name: simplex(*known, min(count, steps[-1])) for name, count in SHOWN.items()}
        # The simplex holds the exposure as stated.
        shown = {name: replace(found, fit=f, exposure=np.ones(3)) for name, f in fits.items()}
        for name, at in {**shown, "least squares": found}.items():
            both, off, rms = _compared(at)
            row += both if not row else both[1:]
            differences += [(colour, name, step, *share, *rms) for step, share in off]
        pictures.append(np.concatenate(row, 1))
    out.mkdir(parents=True, exist_ok=True)
    write_jpeg(out / f"{FILE}.jpg", np.concatenate(pictures))
    columns = "eye", "method", "steps", *CONCENTRATIONS, "rms", "exposure"
    write(out / f"{FILE}.csv", ABOUT, columns, path)
    shares = tuple(f"{which}_{c}" for which in ("share", "rms") for c in "rgb")
    columns = "eye", "stage", "difference", *shares
    write(out / f"{FILE}_differences.csv", ABOUT, columns, differences)


def _numbers(values: dict[str, float]):
    return (*(values[n] for n in CONCENTRATIONS), values["rms"])


def _compared(found: Fitted):
    """Photograph and rendering, reduced; shares of the pixels that differ by at most so many of 255
    steps; RMS per channel.
    """
    both = compare_with_photograph(found)
    off = 255 * np.abs(both.photograph - both.rendered)[both.clear]
    shares = [
        (step, [float((off[:, k] <= step).mean()) for k in range(3)]) for step in range(0, 121, 2)
    ]
    small = [
        skimage.transform.resize(brightened(p), (SIDE, SIDE), anti_aliasing=True)
        for p in (both.photograph, both.rendered)
    ]
    return small, shares, [float(r) for r in both.rms]


if __name__ == "__main__":
    start(main, __doc__)
