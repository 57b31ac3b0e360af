"""Clones of the simulated photographs against their truth, for F09 Figs. 8, 9, 11 and 20: thickness
with and without deconvolution, local profiles, luminance along an arc, and the windows from which
pigments are inferred.
"""

import io
from dataclasses import replace

import jax.numpy as jnp
import numpy as np
from PIL import Image
from scipy import ndimage

from experiments.clone_truth import STEP, Truth, correlation, premises, true_thickness
from experiments.common import RESULTS, start, write
from experiments.simulated_photographs import FOLDER
from irisjax.io import write_atomically
from irisjax.io.photographs import read_photograph
from irisjax.measure.colour import srgb_decode, srgb_encode
from irisjax.photo.clone import (
    CloneSettings,
    Coloured,
    Fitted,
    Given,
    PictureDifference,
    Shaped,
    clone_eye,
    compare_with_photograph,
)
from irisjax.photo.photograph import Photograph
from irisjax.photo.pigments import predicted_colours, simplex
from irisjax.photo.texture import HALF_WIDTH, Unrefracted, to_polar, unrefract
from irisjax.photo.thickness import BETA, generic_thickness
from irisjax.photo.windows import ANGLES, MARGIN, OUTER_MARGIN, RINGS

EYES = "blue", "brown"
VARIANTS = {
    "none": CloneSettings(beta=BETA, sigma=0.0),
    "0.5 mm": CloneSettings(beta=BETA, sigma=0.5),
    "1.0 mm": CloneSettings(beta=BETA, sigma=1.0),
    "beta 2 mm": CloneSettings(beta=2.0, sigma=0.0),
    "default": None,
}
"""F09's Eq. 7 without deconvolution and with two widths; with a larger β, all under F09's premises;
and what `irisjax clone` does of itself: every texel its own thickness and pigments."""
ARC = 3.5
"""Radius of the arc of Fig. 20, mm."""
DETAIL = (2.2, 4.8), (-1.3, 1.3)
"""Of the iris plane, x and y, mm: a square beside the pupil, away from the highlight."""
LIGHT = 2.0
"""By which pictures are brightened."""
CELLS = 480, 108
"""Polar cells (angles, radii) of the filtered picture."""
PROFILES = 0, 80, 200, 290
"""Angles of the local profiles, degrees."""
ALONG, ACROSS = 1.0, 7.0
"""Widths of the ortho-radial filter along and across the radius, mm  [F09 Section 7]."""
FILE = "clone_thickness"


def main(key, quick=False, out=RESULTS):
    """Write CSVs, pictures and arrays (quick: one eye, a third as large, two variants)."""
    del key  # a clone up to its pigments draws no random numbers
    names = ("none", "default") if quick else tuple(VARIANTS)
    scores, rings, local, windows, arcs, pictures, arrays = [], [], [], [], [], [], {}
    for colour in EYES[:1] if quick else EYES:
        photograph, row = simulated(colour, quick), []
        for name in names:
            settings = VARIANTS[name]
            if settings is None:
                found = clone_to_texels(photograph)
            else:
                found = clone_by_f09(photograph, colour, settings)
            texture = found.texture
            truth = true_thickness(colour, texture)
            estimate, both = found.morphology.thickness, compare_with_photograph(found)
            scores.append((colour, name, *_score(found, truth, both)))
            row.append(_detail(_flat(brightened(both.pigments), found).pixels))
            along = zip(*both._replace(rendered=both.pigments).arc(found, ARC, 360), strict=True)
            arcs += [(colour, name, *map(float, values)) for values in along]
            arrays[f"{colour} {name}"] = _micrometres(estimate)
        arrays[f"{colour} true"] = _micrometres(truth.thickness)
        taken = brightened(both.photograph)
        pictures.append(np.concatenate([_detail(_flat(taken, found).pixels), *row], 1))
        rings += [(colour, *r) for r in _rings(found, truth)]
        local += [(colour, *r) for r in _profiles(found, truth)]
        windows += [(colour, *r) for r in _windows(found)]
        arrays[f"{colour} cells"] = _filtered(_flat(taken, found, both.clear))
        arrays[f"{colour} rim"] = np.array([texture.pupil_radius, texture.iris_radius])
    out.mkdir(parents=True, exist_ok=True)
    write_jpeg(out / f"{FILE}.jpg", np.concatenate(pictures))
    data = io.BytesIO()
    np.savez_compressed(data, **arrays)
    write_atomically(out / f"{FILE}.npz", data.getvalue())
    for name, columns, rows in (
        ("", _SCORES, scores),
        ("_rings", _RINGS, rings),
        ("_profiles", ("eye", "angle_deg", "radius_mm", "true_mm", "estimate_mm"), local),
        ("_windows", _WINDOWS, windows),
        ("_arcs", ("eye", "variant", "angle_deg", "photograph", "rendered"), arcs),
    ):
        write(out / f"{FILE}{name}.csv", ABOUT, columns, rows)


ABOUT = ("clones of data/photographs, all simulated; see experiments/README.md",)


def clone_by_f09(
    photograph: Photograph, colour: str, settings: CloneSettings, given: Given | None = None
) -> Fitted:
    """A clone under F09's premises: its search, with exposure, light and scattering known, in
    pictures of the thickness that Eq. 7 gives  [F09 Fig. 10]; the light may be `given` otherwise.
    """
    measured, known = premises(colour)
    given = measured if given is None else given
    *_, shaped = clone_eye(photograph, settings, given, last="thickness")
    assert isinstance(shaped, Shaped)
    given = given._replace(maps=shaped.morphology.maps)
    *_, found = clone_eye(photograph, settings, given, last="pigments")
    assert isinstance(found, Fitted)
    gains = np.array([known["red_gain"], 1, known["blue_gain"]])
    fit = simplex(found.windows, found.base, known)
    return replace(found, fit=fit, exposure=known["exposure"] * gains)


def clone_to_texels(photograph: Photograph) -> Coloured:
    """Clone as `irisjax clone` does, with the thickness of the texels."""
    *_, found = clone_eye(photograph, CloneSettings(), last="texels")
    assert isinstance(found, Coloured)
    depth = np.asarray(found.maps().stroma_depth)
    shape = found.morphology._replace(thickness=found.texture.from_polar(depth))
    return replace(found, estimate=lambda: shape)


def simulated(colour: str, quick: bool) -> Photograph:
    """The clean photograph from straight ahead (quick: 3 × 3 pixels averaged)."""
    found = read_photograph(FOLDER / f"{colour}.jpg")
    if not quick:
        return found
    rows, columns = (n // 3 for n in found.shape)
    blocks = [v[: 3 * rows, : 3 * columns].reshape(rows, 3, columns, 3, *v.shape[2:])
              for v in (found.pixels, found.saturated)]  # fmt: skip
    assert found.focal_px is not None
    return found._replace(
        pixels=blocks[0].mean((1, 3)),
        saturated=blocks[1].any((1, 3)),
        focal_px=found.focal_px / 3,
    )


def brightened(encoded: np.ndarray) -> np.ndarray:
    """An encoded picture in `LIGHT` times as much light."""
    linear = np.asarray(srgb_decode(jnp.asarray(encoded)))
    return np.clip(np.asarray(srgb_encode(jnp.asarray(LIGHT * linear))), 0, 1)


def write_jpeg(path, encoded: np.ndarray) -> None:
    """A picture encoded in [0, 1], which says that it is simulated."""
    data = io.BytesIO()
    whole = Image.fromarray(np.round(255 * np.clip(encoded, 0, 1)).astype(np.uint8))
    whole.save(data, "JPEG", quality=90, subsampling="4:4:4", comment="simulated by irisjax")
    write_atomically(path, data.getvalue())


_SCORES = (
    *("eye", "variant", "response", "correlation", "spread", "error_mm", "generic_error_mm"),
    *(
        "mean_mm",
        "true_mm",
        "clamped",
        "rms_r",
        "rms_g",
        "rms_b",
        "contrast",
        "contrast_photograph",
    ),
)


def _score(found: Fitted, truth: Truth, both: PictureDifference) -> tuple:
    """How the thickness compares with the truth, and the rendering with the photograph.

    Correlation of deviations from the mean at their radius, the estimate's spread over the truth's,
    root mean square errors of the estimate and of the generic thickness, and means (mm).
    """
    estimate, used = found.morphology.thickness, truth.used
    true, seen = truth.thickness[used], estimate[used]
    generic = generic_thickness(found.texture.radius()[used])
    return (
        np.nan if found.morphology.response is None else found.morphology.response,
        *correlation(found, truth.thickness, used),
        *(float(np.sqrt(((v - true) ** 2).mean())) for v in (seen, generic)),
        float(seen.mean()),
        float(true.mean()),
        found.morphology.clamped,
        *(float(r) for r in both.rms_of_pigments),
    )


def _flat(picture: np.ndarray, found: Fitted, clear: np.ndarray | None = None) -> Unrefracted:
    """A picture of the clone's camera, laid flat."""
    clear = found.clear if clear is None else clear
    where = found.refraction
    return unrefract(picture.astype(np.float32), clear, found.pose, where)


def _detail(texture: np.ndarray) -> np.ndarray:
    texel = 2 * HALF_WIDTH / len(texture)
    (left, right), (low, high) = DETAIL
    rows, columns = (
        slice(round((HALF_WIDTH + a) / texel), round((HALF_WIDTH + b) / texel))
        for a, b in ((-high, -low), (left, right))
    )
    return texture[rows, columns]


def _micrometres(thickness: np.ndarray) -> np.ndarray:
    """The detail, at half the resolution."""
    return np.round(1000 * _detail(thickness)[::2, ::2]).astype(np.uint16)


_RINGS = (
    "eye",
    "radius_mm",
    "generic_mm",
    "true_mm",
    "true_sd_mm",
    "estimate_mm",
    "estimate_sd_mm",
)


def _rings(found: Fitted, truth: Truth):
    """Mean and standard deviation of the stroma's thickness round the eye, by radius."""
    texture = found.texture
    ring, estimate = (texture.radius() / STEP).astype(int), found.morphology.thickness
    there = texture.valid & (truth.thickness > 0)
    for number in np.unique(ring[there]):
        of = there & (ring == number)
        if of.sum() < 200:
            continue
        middle = (number + 0.5) * STEP
        pairs = [(float(v[of].mean()), float(v[of].std())) for v in (truth.thickness, estimate)]
        yield middle, float(generic_thickness(np.asarray(middle))), *pairs[0], *pairs[1]


def _profiles(found: Fitted, truth: Truth):
    """Thickness along a few radii; NaN where the photograph does not show the iris."""
    texture = found.texture
    radius = np.arange(0.5 * STEP, texture.iris_radius, STEP)
    for degrees in PROFILES:
        along = np.exp(1j * np.radians(degrees)) * radius
        texel, middle = texture.millimetres_per_texel, len(texture.valid) / 2 - 0.5
        place = middle - along.imag / texel, middle + along.real / texel
        at = tuple(np.rint(p).astype(int) for p in place)
        shown = texture.valid[at] & (truth.thickness[at] > 0)
        values = [ndimage.map_coordinates(v, place, order=1)
                  for v in (truth.thickness, found.morphology.thickness)]  # fmt: skip
        for r, true, seen, ok in zip(radius, *values, shown, strict=True):
            if ok:
                yield degrees, float(r), float(true), float(seen)


_WINDOWS = ("eye", "angle_deg", "inner_mm", "outer_mm", "present")
_WINDOWS += tuple(f"{which}_{c}" for which in ("photograph", "model") for c in "rgb")


def _windows(found: Fitted):
    """Borders of the windows, and their linear colours in photograph and model."""
    windows, eye = found.windows, found.pose.eye
    fitted = {name: jnp.asarray(value) for name, value in found.fit.values.items()}
    model = np.asarray(predicted_colours(fitted, windows, found.base))
    inner = float(eye.pupil_radius) + MARGIN
    width = (float(eye.iris_radius) - OUTER_MARGIN - inner) / RINGS
    for number, colours in enumerate(np.concatenate([windows.colour, model], 1)):
        ring, sector = divmod(number, ANGLES)
        place = sector * 360 / ANGLES, inner + ring * width, inner + (ring + 1) * width
        yield *place, int(windows.present[number]), *(float(c) for c in colours)


def _filtered(texture: Unrefracted) -> np.ndarray:
    """Polar cells of a picture, encoded, 8 bits: the upper half as it is, the lower one after the
    ortho-radial filter  [F09 Eq. 14]."""
    rim = texture.pupil_radius, texture.iris_radius
    known = texture.valid.astype(np.float32)
    layers = [known, *(known * texture.pixels[..., k] for k in range(3))]
    cells = [to_polar(layer, *rim, CELLS) for layer in layers]
    smooth = [_ortho_radial(c, *rim) for c in cells]
    half = CELLS[0] // 2
    means = [
        np.concatenate([as_is[:half] / np.maximum(cells[0][:half], 0.5), wide[half:] / least])
        for as_is, wide in zip(cells[1:], smooth[1:], strict=True)
        for least in [np.maximum(smooth[0][half:], 1e-3)]
    ]
    return np.round(255 * np.clip(np.stack(means, -1), 0, 1)).astype(np.uint8)


def _ortho_radial(cells: np.ndarray, inner: float, outer: float) -> np.ndarray:
    angles, radii = cells.shape
    step = (outer - inner) / radii
    along = ndimage.gaussian_filter1d(cells, ALONG / step, axis=1, mode="constant")
    radius = inner + (np.arange(radii) + 0.5) * step
    turned = [
        ndimage.gaussian_filter1d(column, ACROSS / r / (2 * np.pi / angles), mode="wrap")
        for column, r in zip(along.T, radius, strict=True)
    ]
    return np.stack(turned, 1)


if __name__ == "__main__":
    start(main, __doc__)
