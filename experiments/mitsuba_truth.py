"""Clones of the second set of simulated photographs against their truth.

Light was made there by another model (`mitsuba_photographs.py`), so neither thickness nor pigments
are found by the model that drew them. Nothing in irisjax was chosen by what comes out here.
"""

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
from scipy import ndimage

from experiments.common import RESULTS, start, write
from experiments.mitsuba_photographs import FOLDER
from irisjax.io.photographs import read_photograph
from irisjax.photo.clone import (
    CloneSettings,
    Fitted,
    Given,
    Sampled,
    clone_eye,
    compare_with_photograph,
    doubtful_outlines,
    doubts_of,
    outline_eye,
)
from irisjax.photo.photograph import Ellipse

ABOUT = ("clones of data/photographs/volumetric, all simulated",)
STEP = 0.05
"""Of radii, mm: correlations are of deviations from the mean at a radius."""
_COLUMNS = (
    *("photograph", "limbus_off", "pupil_off", "limbus_confidence", "pupil_confidence", "given"),
    *("tilt", "tilt_low", "tilt_high", "true_tilt", "correlation", "correlation_all", "share_lit"),
    *("abl_melanin", "abl_melanin_low", "abl_melanin_high", "true_abl_melanin"),
    *("scattering", "true_scattering", "rms_red", "rms_green", "rms_blue", "doubts"),
)


def main(key, quick=False, out=RESULTS, folder=FOLDER):
    """Write a CSV (quick: one photograph, few steps of the posterior)."""
    settings = CloneSettings(steps=200) if quick else CloneSettings()
    truths = read_truth(folder)[: 1 if quick else None]
    rows = (_row(folder, t, settings, key) for t in truths)
    write(out / "mitsuba_truth.csv", ABOUT, _COLUMNS, rows)


def read_truth(folder: Path = FOLDER) -> list[dict[str, Any]]:
    """What each photograph was made with."""
    return json.loads((folder / "truth.json").read_text(encoding="utf-8"))["photographs"]


def read_map(folder: Path, truth: dict[str, Any], name: str) -> np.ndarray:
    """A map of the truth on a square of the iris plane, x and y from -6 to 6 mm, row 0 at y = 6."""
    with np.load(folder / truth["maps"]) as found:
        if name == "lit":
            return np.unpackbits(found[name], axis=1).astype(bool)
        return found[name] * (float(found[f"{name}_most"]) / 255)


def ellipse_of(numbers: dict[str, Any]) -> Ellipse:
    """An outline of the truth."""
    return Ellipse(tuple(numbers["centre_px"]), tuple(numbers["semi_axes_px"]), numbers["angle"])


def outline_error(found: Ellipse, true: Ellipse, radius: float) -> float:
    """Largest distance between two outlines along the true one's radii, over a radius (pixels)."""
    off = true.relative_radius(*found.points(np.linspace(0, 2 * np.pi, 90)).T) - 1
    return float(np.abs(off).max() * max(true.semi_axes) / radius)


def outlines_off(found: Any, truth: dict[str, Any]) -> tuple[float, float]:
    """Errors of limbus and pupil over the limbus's radius."""
    radius = max(truth["limbus"]["semi_axes_px"])
    pairs = ((getattr(found, n), ellipse_of(truth[n])) for n in ("limbus", "pupil"))
    limbus, pupil = (outline_error(*pair, radius) for pair in pairs)
    return limbus, pupil


def _row(folder: Path, truth: dict[str, Any], settings: CloneSettings, key) -> tuple:
    photograph = read_photograph(folder / truth["file"])
    outlined = outline_eye(photograph)
    found = outlined.boundaries
    first = (*outlines_off(found, truth), found.limbus_confidence, found.pupil_confidence)
    # Outlines that the command would refuse are given.
    refused = doubtful_outlines(outlined)
    given = Given(**{n: ellipse_of(truth[n]) for n in refused})
    clone = list(clone_eye(photograph, settings, given, key=key))[-1]
    assert isinstance(clone, Sampled)
    pose, rms = clone.pose, compare_with_photograph(clone).rms
    tilt = [math.degrees(v) for v in (pose.tilt, *pose.tilt_interval)]
    scores = _correlations(clone, folder, truth)
    mass = _abl_melanin(clone)
    own = clone.fit.iris(clone.base)
    row = (
        truth["file"],
        *first,
        "+".join(refused),
        *tilt,
        math.degrees(truth["camera"]["polar"]),
        *scores,
        *np.quantile(mass, [0.5, 0.025, 0.975]).tolist(),
        true_abl_melanin(folder, truth),
        _scattering(own),
        truth["scattering"]["over_lb06"],
        *(float(v) for v in rms),
        len(doubts_of(clone, rms)),
    )
    print(*row, *doubts_of(clone, rms), sep="\n  ", flush=True)
    return row


def _abl_melanin(clone: Sampled) -> np.ndarray:
    """Samples of the ABL's melanin, µg/mm²."""
    drawn = clone.posterior.samples
    both = np.asarray(drawn["abl_eumelanin"]) + np.asarray(drawn["abl_pheomelanin"])
    return both * float(clone.base.abl_thickness)


def true_abl_melanin(folder: Path, truth: dict[str, Any]) -> float:
    """Mean mass of the ABL's melanin where the photograph shows the iris in good light, µg/mm²."""
    return float(read_map(folder, truth, "abl_melanin")[read_map(folder, truth, "lit")].mean())


def _scattering(iris: Any) -> float:
    """Strength of the stroma's scattering relative to LB06's fibrils."""
    from experiments.volumetric_iris import REFERENCE, lb06_scattering
    from irisjax.tissue.pigments import extinction

    depth = iris.layers(extinction(np.array([REFERENCE]))).stroma_scattering[0]
    return float(depth / iris.stroma_thickness) / lb06_scattering()


def _correlations(clone: Fitted, folder: Path, truth: dict[str, Any]) -> tuple[float, float, float]:
    """Of the estimated and the true thickness about their means at a radius, where the iris is well
    lit and where it is seen at all; and the share of the iris that is well lit.
    """
    texture = clone.texture
    size = len(texture.valid)
    true, lit = read_map(folder, truth, "thickness"), read_map(folder, truth, "lit")
    true, lit = (
        ndimage.zoom(v.astype(float), size / len(v), order=1, grid_mode=True, mode="nearest")
        for v in (true, lit)
    )
    radius = texture.radius()
    seen = texture.valid & (true > 0) & (radius < 5.2)
    good = seen & (lit > 0.5)
    found = np.log(clone.morphology.thickness + 0.01)
    true = np.log(true + 0.01)
    scores = [_correlation(true[m], found[m], radius[m]) for m in (good, seen)]
    whole = math.pi * (texture.iris_radius**2 - texture.pupil_radius**2)
    return scores[0], scores[1], float(good.sum() * texture.millimetres_per_texel**2 / whole)


def _correlation(one: np.ndarray, other: np.ndarray, radius: np.ndarray) -> float:
    ring = (radius / STEP).astype(int)
    count = np.maximum(np.bincount(ring), 1)
    pair = [v - (np.bincount(ring, v) / count)[ring] for v in (one, other)]
    return float(np.corrcoef(*pair)[0, 1])


if __name__ == "__main__":
    start(main, __doc__)
