"""Clones of the second set of simulated photographs against their truth.

Light was made there by another model (`mitsuba_photographs.py`), so neither thickness nor pigments
are found by the model that drew them. Nothing in irisjax was chosen by what comes out here.
"""

import json
import math
from pathlib import Path
from typing import Any

import jax
import numpy as np
from scipy import ndimage

from experiments.common import RESULTS, start, write
from experiments.mitsuba_photographs import FOLDER
from irisjax.io.photographs import read_photograph
from irisjax.photo.clone import (
    CloneSettings,
    Coloured,
    Given,
    clone_eye,
    compare_with_photograph,
    outline_eye,
)
from irisjax.photo.doubts import DOUBTS, doubtful_outlines, doubts_of
from irisjax.photo.photograph import Ellipse
from irisjax.photo.pigments import parameter_values
from irisjax.photo.texels import OwnPigments
from irisjax.tissue.iris import Iris
from irisjax.tissue.pigments import extinction

ABOUT = ("clones of data/photographs/volumetric, all simulated",)
STEP = 0.05
"""Width of a ring, mm: correlations are of deviations from the mean at a radius."""
_DRAWS = 20_000
_WIDEST = 5.2  # radius of texels that are compared, mm: beyond, the white fades in
COLUMNS = (
    *("photograph", "limbus_off", "pupil_off", "limbus_confidence", "pupil_confidence", "given"),
    *("tilt", "tilt_low", "tilt_high", "true_tilt", "share_lit"),
    *("correlation_stroma", "correlation_stroma_seen", "correlation_melanin"),
    *("within_stroma", "within_eumelanin", "within_pheomelanin"),
    *("strength", "true_strength", "texels_melanin"),
    *("abl_melanin", "abl_melanin_low", "abl_melanin_high", "true_abl_melanin"),
    *("rms_red", "rms_green", "rms_blue", "pigments_red", "pigments_green", "pigments_blue"),
    *("gain", "outside", "explained", "doubts_outlines", "doubts_light", "doubts_model"),
)


def main(key, quick=False, out=RESULTS, folder=FOLDER):
    """Write a CSV (quick: one photograph)."""
    truths = read_truth(folder)[: 1 if quick else None]
    rows = (row_of(folder, truth, CloneSettings(), key) for truth in truths)
    write(out / "mitsuba_truth.csv", ABOUT, COLUMNS, rows)


def read_truth(folder: Path = FOLDER) -> list[dict[str, Any]]:
    """Read the numbers with which each photograph was made."""
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


def row_of(folder: Path, truth: dict[str, Any], settings: CloneSettings, key) -> tuple:
    """One photograph's numbers."""
    photograph = read_photograph(folder / truth["file"])
    outlined = outline_eye(photograph)
    found = outlined.boundaries
    first = (*outlines_off(found, truth), found.limbus_confidence, found.pupil_confidence)
    # Outlines that the command would refuse are given.
    refused = doubtful_outlines(outlined)
    given = Given(**{n: ellipse_of(truth[n]) for n in refused})
    clone = list(clone_eye(photograph, settings, given, last="texels"))[-1]
    assert isinstance(clone, Coloured)
    assert clone.texels is not None
    pose, shown = clone.pose, compare_with_photograph(clone)
    doubts = doubts_of(clone, shown.rms_of_pigments)
    kinds = [doubt.kind for doubt in doubts]
    own = clone.texels
    row = (
        truth["file"],
        *first,
        "+".join(refused),
        *(math.degrees(v) for v in (pose.tilt, *pose.tilt_interval)),
        math.degrees(truth["camera"]["polar"]),
        *_maps_against_truth(clone, own, folder, truth),
        *np.quantile(_abl_melanin(clone, key), [0.5, 0.025, 0.975]).tolist(),
        true_abl_melanin(folder, truth),
        *(float(v) for v in (*shown.rms, *shown.rms_of_pigments)),
        *(own.gain, own.outside, own.explained),
        *(kinds.count(kind) for kind in DOUBTS),
    )
    print(*row, *doubts, sep="\n  ", flush=True)
    return row


def _abl_melanin(clone: Coloured, key) -> np.ndarray:
    """Draws of the ABL's melanin, µg/mm², from the normal approximation of the global fit."""
    fit = clone.fit
    z = jax.random.multivariate_normal(key, fit.z, fit.covariance, (_DRAWS,), method="eigh")
    drawn = parameter_values(z.T)
    both = np.asarray(drawn["abl_eumelanin"] + drawn["abl_pheomelanin"])
    return both * float(clone.base.abl_thickness)


def true_abl_melanin(folder: Path, truth: dict[str, Any]) -> float:
    """Mean mass of the ABL's melanin where the photograph shows the iris in good light, µg/mm²."""
    return float(read_map(folder, truth, "abl_melanin")[read_map(folder, truth, "lit")].mean())


def _scattering(iris: Iris) -> float:
    """Scattering coefficient of a stroma relative to LB06's."""
    depths = [
        i.layers(extinction(np.array([550.0]))).stroma_scattering[0] / i.stroma_thickness
        for i in (iris, Iris())
    ]
    return float(depths[0] / depths[1])


def _maps_against_truth(
    clone: Coloured, own: OwnPigments, folder: Path, truth: dict[str, Any]
) -> tuple[float, ...]:
    """Share of the iris that is well lit; correlations about the means at a radius, of the stroma's
    strength where it is well lit and where it is seen at all, and of the ABL's melanin; shares of
    well lit texels whose logarithms are within two standard deviations of the truth (strength,
    eumelanin and pheomelanin of the ABL); medians of the strength, mm of LB06's stroma, found and
    true; the mean found melanin of the ABL, µg/mm².
    """
    texture, iris, maps = clone.texture, own.iris, own.maps
    size, radius = len(texture.valid), clone.texture.radius()

    def of_truth(name: str) -> np.ndarray:
        values = read_map(folder, truth, name).astype(float)
        zoom = size / len(values)
        return ndimage.zoom(values, zoom, order=1, grid_mode=True, mode="nearest")

    def found(values: Any) -> np.ndarray:
        return texture.from_polar(np.asarray(values))

    melanin, share = of_truth("abl_melanin"), of_truth("abl_pheomelanin_share")
    true = (
        of_truth("thickness") * truth["scattering"]["over_lb06"],
        melanin * (1 - share),
        melanin * share,
    )
    held = iris.layer_concentrations()
    thick = float(iris.abl_thickness)
    mine = (
        found(maps.stroma_depth) * _scattering(iris),
        found(maps.eumelanin) * held["abl_eumelanin"] * thick,
        found(maps.pheomelanin) * held["abl_pheomelanin"] * thick,
    )
    seen = texture.valid & (true[0] > 0) & (radius < _WIDEST)
    good = seen & (of_truth("lit") > 0.5)
    logs = [[np.log(np.maximum(v, 1e-6)) for v in values] for values in (true, mine)]
    within = [
        float((np.abs(t - m) < 2 * found(sd))[good].mean())
        for t, m, sd in zip(*logs, own.deviations, strict=True)
    ]
    both = np.log(mine[1] + mine[2])
    scores = [
        *(_correlation(logs[0][0][m], logs[1][0][m], radius[m]) for m in (good, seen)),
        _correlation(np.log(np.maximum(melanin, 1e-6))[good], both[good], radius[good]),
    ]
    whole = math.pi * (texture.iris_radius**2 - texture.pupil_radius**2)
    return (
        float(good.sum() * texture.millimetres_per_texel**2 / whole),
        *scores,
        *within,
        *(float(np.median(v[good])) for v in (mine[0], true[0])),
        float((mine[1] + mine[2])[good].mean()),
    )


def _correlation(one: np.ndarray, other: np.ndarray, radius: np.ndarray) -> float:
    ring = (radius / STEP).astype(int)
    count = np.maximum(np.bincount(ring), 1)
    pair = [v - (np.bincount(ring, v) / count)[ring] for v in (one, other)]
    return float(np.corrcoef(*pair)[0, 1])


if __name__ == "__main__":
    start(main, __doc__)
