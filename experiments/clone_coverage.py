"""Do the intervals of `irisjax clone` hold the truth as often as they say?

Eyes drawn from the priors of `photo.pigments`, photographed by the package's own renderer and
cloned from the picture alone, from outlines to posterior. The optics are the same on both sides:
what is tested is detection, unrefraction, thickness, windows and inference. (Another renderer's
photographs are in `data/photographs`.)
"""

import argparse
import csv
import time
from pathlib import Path
from typing import Any

import jax
import numpy as np
from scipy import stats
from tqdm import tqdm

from experiments.common import RESULTS, uniform_ranks, write
from experiments.simulated_eyes import DISTANCE, SIZE, WIDTH, Truth, photographed, tables_of
from irisjax.photo.clone import (
    NOTHING,
    CloneSettings,
    Fitted,
    Given,
    Lit,
    Outlined,
    Posed,
    Sampled,
    clone_eye,
)
from irisjax.photo.outlines import MIN_CONFIDENCE
from irisjax.photo.photograph import Ellipse, Photograph
from irisjax.photo.pigments import CONCENTRATIONS, FREE_NAMES, PRIORS

EYES, DRAWS = 48, 63
LEVELS = {"68": (0.16, 0.84), "95": (0.025, 0.975)}
TOTALS = {
    "abl_melanin": ("abl_eumelanin", "abl_pheomelanin"),
    "stroma_melanin": ("stroma_eumelanin", "stroma_pheomelanin"),
}
REPORTED = (*CONCENTRATIONS, *TOTALS, *FREE_NAMES[len(CONCENTRATIONS) :])
POSTERIORS = ("eye", "parameter", "truth", "median", "q2.5", "q16", "q84", "q97.5")
POSTERIORS += ("rank", "draws", "z", "contraction")
PICTURES = ("eye", "result", "seconds", "pupil_radius", "tilt_deg", "tilt_deg_found")
PICTURES += ("lamp_deg", "lamps_found", "lamp_off_deg", "limbus_off_px", "pupil_off_px")
PICTURES += ("limbus_confidence", "pupil_confidence", "thickness_response", "rms_red", "rms_green")
PICTURES += ("rms_blue", "rounds", "effective_samples")
SUMMARY = ("parameter", "eyes", *(f"{k}_{p}" for p in LEVELS for k in ("covered", "low", "high")))
SUMMARY += ("p_chi_square", "p_kolmogorov", "mean_z", "sd_z", "contraction")


def main(key, quick=False, out=RESULTS, eyes=EYES, given_outlines=False, end=""):
    """Write posteriors, what was found of each picture, and the summary, anew after every eye
    (quick: one eye); eyes that the files have are not done again.
    """
    eyes = 1 if quick else eyes
    seed = int(jax.random.key_data(key)[-1])
    about = (
        f"simulated eyes from the priors of irisjax.photo.pigments, seed {seed}, {SIZE} px",
        f"outlines {'given' if given_outlines else 'found'}",
        "photographs by the package's own renderer: the optics are not tested here",
    )
    paths = [out / f"clone_coverage{n}{end}.csv" for n in ("_posteriors", "_pictures")]
    posteriors, pictures = (_kept(path, about) for path in paths)
    done = {int(row[0]) for row in pictures}
    for eye in tqdm([e for e in range(eyes) if e not in done], unit="eye", disable=quick):
        begin = time.perf_counter()
        truth, photograph = photographed(np.random.default_rng([seed, eye]), tables_of)
        given = Given(truth.limbus, truth.pupil) if given_outlines else NOTHING
        found, result = _cloned(photograph, given, eye)
        if isinstance(found, Sampled):
            posteriors += _posterior(eye, truth, found, np.random.default_rng([seed, eye, 1]))
        pictures.append(_picture(eye, truth, found, result, time.perf_counter() - begin))
        write(paths[0], about, POSTERIORS, posteriors, quiet=True)
        write(paths[1], about, PICTURES, pictures, quiet=True)
    _summarise(out / f"clone_coverage{end}.csv", about, posteriors, pictures)


def _cloned(photograph: Photograph, given: Given, seed: int) -> tuple[Outlined, str]:
    """As far as a clone gets, and how it ended: as the command ends, and in its words."""
    focal = DISTANCE / WIDTH * SIZE
    settings, key = CloneSettings(focal_px=focal), jax.random.key(seed)
    run = clone_eye(photograph, settings, given, tables=tables_of, key=key)
    found = next(run)
    sure = found.boundaries.limbus_confidence, found.boundaries.pupil_confidence
    if min(sure) < MIN_CONFIDENCE:
        return found, "doubtful outline"
    try:
        for later in run:
            found = later
    except ValueError as error:
        return found, f"refused: {error}"
    assert isinstance(found, Sampled)
    return found, "" if found.posterior.converged else "too few effective samples"


def _posterior(eye: int, truth: Truth, found: Sampled, random: np.random.Generator) -> list[tuple]:
    """Rows of an eye's parameters."""
    posterior = found.posterior
    rows = []
    prior = {n: PRIORS[n].value(z) for n, z in zip(FREE_NAMES, _standard().T, strict=True)}
    for name in REPORTED:
        parts = TOTALS.get(name, (name,))
        value = sum(truth.values[n] for n in parts)
        samples, before = (np.log(sum(s[n] for n in parts)) for s in (posterior.samples, prior))
        low, first, median, last, high = np.quantile(samples, (0.025, 0.16, 0.5, 0.84, 0.975))
        some = random.choice(samples, DRAWS, replace=False)
        rows.append(
            (
                *(eye, name, value),
                *(float(np.exp(q)) for q in (median, low, first, last, high)),
                *(int((some < np.log(value)).sum()), DRAWS),
                float((samples.mean() - np.log(value)) / samples.std()),
                float(1 - samples.var() / before.var()),
            )
        )
    return rows


def _standard() -> np.ndarray:
    return np.random.default_rng(0).standard_normal((20_000, len(FREE_NAMES)))


def _picture(eye: int, truth: Truth, found: Outlined, result: str, seconds: float) -> tuple:
    """The row of a photograph; NaN for what was not reached."""
    lamp, scene = np.asarray(truth.scene.all_lights().towards[0]), truth.scene
    boundaries, nan = found.boundaries, float("nan")
    off = nan
    if isinstance(found, Lit) and found.lighting.lamps is not None:
        cosines = np.asarray(found.lighting.lamps.towards) @ lamp
        off = float(np.degrees(np.arccos(np.clip(cosines, -1, 1))).min())
    rms = np.full(3, nan)
    rounds = effective = nan
    if isinstance(found, Fitted):
        rms = found.fit.rms
    if isinstance(found, Sampled):
        rounds, effective = found.posterior.rounds, found.posterior.effective
    return (
        *(eye, result, seconds, float(scene.eye.pupil_radius)),
        *(
            np.degrees(float(scene.camera.polar)),
            np.degrees(found.pose.tilt) if isinstance(found, Posed) else nan,
        ),
        float(np.degrees(np.arccos(-lamp[2]))),
        *(found.lighting.found if isinstance(found, Lit) else nan, off),
        *(_apart(truth.limbus, boundaries.limbus), _apart(truth.pupil, boundaries.pupil)),
        *(boundaries.limbus_confidence, boundaries.pupil_confidence),
        found.morphology.response if isinstance(found, Fitted) else nan,
        *(float(v) for v in rms),
        *(rounds, effective),
    )


def _apart(one: Ellipse, other: Ellipse) -> float:
    """Largest distance of points of an outline from another, px, about."""
    points = other.points(np.linspace(0, 2 * np.pi, 64, endpoint=False))
    off = one.relative_radius(*points.T) - 1
    return float(np.abs(off).max() * one.semi_axes[0])


def _kept(path: Path, about: tuple[str, ...]) -> list[tuple]:
    """Rows of a file of the same run, none of another's."""
    if not path.is_file():
        return []
    lines = path.read_text(encoding="utf-8").splitlines()
    if tuple(line[2:] for line in lines if line.startswith("# ")) != about:
        return []
    rows = csv.reader(line for line in lines if not line.startswith("#"))
    next(rows)
    return [tuple(row) for row in rows]


def _summarise(path: Path, about: tuple[str, ...], posteriors: list, pictures: list) -> None:
    """Coverage by parameter, over the eyes that have a posterior."""
    rows: list[dict[str, Any]] = [dict(zip(POSTERIORS, row, strict=True)) for row in posteriors]
    counts = {"eyes": len(pictures), "with a posterior": len(rows) // len(REPORTED)}
    results = [str(row[1]) for row in pictures]
    for what in ("doubtful outline", "refused"):
        counts[what] = sum(r.startswith(what) for r in results)
    counts["not sampled to the end"] = sum(map(bool, results)) - counts["doubtful outline"]
    counts["not sampled to the end"] -= counts["refused"]
    summary = []
    for name in REPORTED:
        mine = [row for row in rows if row["parameter"] == name]
        if not mine:
            continue
        truth, rank, z, told = (
            np.array([float(row[k]) for row in mine]) for k in ("truth", "rank", "z", "contraction")
        )
        line: list = [name, len(mine)]
        for first, last in LEVELS.values():
            low, high = (
                np.array([float(row[f"q{100 * q:g}"]) for row in mine]) for q in (first, last)
            )
            inside = int(((low < truth) & (truth < high)).sum())
            interval = stats.binomtest(inside, len(mine)).proportion_ci(method="exact")
            line += [inside / len(mine), float(interval.low), float(interval.high)]
        line += uniform_ranks(rank, DRAWS)
        line += [float(np.mean(z)), float(np.std(z)), float(np.median(told))]
        summary.append(line)
    write(path, (*about, ", ".join(f"{n} {k}" for k, n in counts.items())), SUMMARY, summary)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="a small version, for tests")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=RESULTS, help="folder for the results")
    parser.add_argument("--eyes", type=int, default=EYES)
    parser.add_argument("--given-outlines", action="store_true", help="not those that are found")
    options = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    end = "_given" if options.given_outlines else ""
    about = jax.random.key(options.seed), options.quick, options.out, options.eyes
    main(*about, options.given_outlines, end)
