"""How much melanin has an iris whose colours vary: by one set of pigments, and by its texels?

Eyes of the priors with patches, zones and fibres as the presets have them, of more contrast than
these, photographed by the package's own renderer. The clone is given the true outlines. The truth
is the mean of the ABL's melanin over the iris.
"""

from itertools import pairwise

import jax
import numpy as np
from tqdm import tqdm

from experiments.clone_presets import mean_pigments, raised
from experiments.common import RESULTS, start, write
from experiments.simulated_eyes import DISTANCE, SIZE, WIDTH, photographed, tables_of
from irisjax.grow.presets import PRESETS
from irisjax.photo.clone import CloneSettings, Given, Sampled, clone_eye
from irisjax.photo.pigments import mean_misfit
from irisjax.tissue.maps import IrisMaps

EYES = 72
CONTRAST = 1.0, 2.5
"""Powers of the maps of pigments and thickness."""
UNEVEN = 0.33, 0.55
"""RMS differences of the windows between which rows of the summary are divided."""
COLUMNS = ("eye", "preset", "contrast", "windows_rms", "exposure_factor", "truth")
COLUMNS += ("even_q2.5", "even_median", "even_q97.5", "texels_q2.5", "texels", "texels_q97.5")
SUMMARY = ("windows_rms_from", "to", "eyes")
SUMMARY += tuple(f"{by}_{what}" for by in ("even", "texels") for what in ("held", "bias", "off"))


def main(key, quick=False, out=RESULTS):
    """Write the ABL's melanin (mg/ml) by both beside the truth, and how often intervals hold it
    (quick: one eye).
    """
    seed = int(jax.random.key_data(key)[-1])
    rows = [_row(seed, eye) for eye in tqdm(range(1 if quick else EYES), unit="eye", disable=quick)]
    about = (f"simulated eyes with uneven pigments, seed {seed}, {SIZE} px", "mg/ml of the ABL")
    write(out / "clone_uneven.csv", about, COLUMNS, rows)
    table = [dict(zip(COLUMNS, row, strict=True)) for row in rows]
    ends = (0.0, *UNEVEN, np.inf)
    summary = []
    for low, high in (*pairwise(ends), (0.0, np.inf)):
        mine = [row for row in table if low <= row["windows_rms"] < high]
        if mine:
            both = (_judged(mine, "even", "even_median"), _judged(mine, "texels", "texels"))
            summary.append((low, high, len(mine), *both[0], *both[1]))
    about = (*about, "held: share of 95 % intervals; bias, off: mean and RMS of ln(found / truth)")
    write(out / "clone_uneven_summary.csv", about, SUMMARY, summary)


def _row(seed: int, eye: int) -> tuple:
    random = np.random.default_rng([seed, eye])
    colour = list(PRESETS)[eye % len(PRESETS)]
    contrast = float(random.uniform(*CONTRAST))
    grown: list[IrisMaps] = []

    def grow(iris, eye, key) -> IrisMaps:
        maps = PRESETS[colour](eye, key=key)[1]
        # The preset's stroma may be thicker than the iris's.
        share = iris.stroma_thickness / np.mean(maps.stroma_depth)
        grown.append(raised(maps.replace(stroma_depth=maps.stroma_depth * share), contrast))
        return grown[-1]

    truth, photograph = photographed(random, tables_of, grow)
    settings, given = CloneSettings(focal_px=DISTANCE / WIDTH * SIZE), Given(*truth[2:])
    key = jax.random.key(eye)
    *_, found = clone_eye(photograph, settings, given, tables=tables_of, key=key)
    assert isinstance(found, Sampled)
    own = found.abl_melanin()
    assert found.texels is not None
    assert own is not None
    mean, low, high = own
    scene = truth.scene
    pigments = mean_pigments(scene.iris, grown[-1], scene.eye, found)
    samples = found.posterior.samples
    even = np.quantile(samples["abl_eumelanin"] + samples["abl_pheomelanin"], (0.025, 0.5, 0.975))
    return (
        *(eye, colour, contrast, mean_misfit(found.fit, found.windows), found.texels.gain),
        pigments["abl_eumelanin"] + pigments["abl_pheomelanin"],
        *map(float, even),
        *(low, mean, high),
    )


def _judged(rows: list[dict], by: str, middle: str) -> tuple[float, float, float]:
    low, found, high, truth = (
        np.array([row[name] for row in rows])
        for name in (f"{by}_q2.5", middle, f"{by}_q97.5", "truth")
    )
    error = np.log(found / truth)
    held = np.mean((low < truth) & (truth < high))
    return float(held), float(error.mean()), float(np.sqrt((error**2).mean()))


if __name__ == "__main__":
    start(main, __doc__)
