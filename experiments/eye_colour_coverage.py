"""Do the intervals of `irisjax clone --colour` hold the colours of the simulated photographs?

The twelve photographs of `data/photographs` are taken anew: by people whose whites differ, in light
of another tint, by cameras of another exposure, contrast and white balance, with noise and in 8
bits. The truth is what a perfect white in the eye's place would make of the clean photograph.
"""

import json
from pathlib import Path
from typing import Any

import jax
import numpy as np

from experiments.common import RESULTS, start, write
from irisjax.io.photographs import read_photograph
from irisjax.measure.colour import XYZ_TO_SRGB, lab_of, srgb_decode, srgb_encode
from irisjax.photo.clone import Outlined
from irisjax.photo.edges import reduce_picture
from irisjax.photo.eye_colour import RINGS, WHOLE_IRIS, colours_of, depth_in_iris
from irisjax.photo.masks import find_highlights
from irisjax.photo.outlines import Boundaries
from irisjax.photo.photograph import Ellipse, Photograph

FOLDER = Path(__file__).parent.parent / "data" / "photographs"
TIMES, SCALE = 10, 0.3
REFLECTANCE = 0.0226
"""Reflectance of the tear film at normal incidence."""
WHITES = np.array([82.0, 0.9, 3.9]), np.array([5.0, 2.5, 4.0])
"""L*a*b* of the photographs' own white, and standard deviations of people's from it."""
TINT, EXPOSURE, CONTRAST, CHANNEL, NOISE = 0.25, (0.45, 1.0), 0.1, 0.03, 0.006
"""Spreads of the light's tint, of exposures, of contrasts, of channels, and of noise."""
SUMMARY = ("region", "component", "cases", "covered", "half_width", "mean_error", "rms_error")


def main(key, quick=False, out=RESULTS):
    """Write the coverage by region and component (quick: one photograph twice)."""
    entries = json.loads((FOLDER / "truth.json").read_text(encoding="utf-8"))["photographs"]
    clean = {e["scene"]: e for e in entries if not e["dirty"]}
    rows: list[tuple[Any, ...]] = []
    for number, entry in enumerate(entries[:1] if quick else entries):
        truth, random = truths(clean[entry["scene"]]), np.random.default_rng([number, 1])
        photograph, outlines = _reduced(entry)
        for time in range(2 if quick else TIMES):
            taken = taken_anew(photograph, outlines.limbus, random)
            one = jax.random.fold_in(jax.random.fold_in(key, number), time)
            try:
                colours, _ = colours_of(Outlined(taken, outlines), key=one)
            except ValueError as error:
                print(f"{time}: {error}")
                continue
            for name, region in colours.regions.items():
                for i, component in enumerate("Lab"):
                    ends = (float(v[i]) for v in (region.lab, region.low, region.high))
                    rows.append((name, component, float(truth[name][i]), *ends))
    about = [f"simulated; {__doc__.splitlines()[0]}", "L*a*b* under D65; intervals of 95 %"]
    write(out / "eye_colour_coverage.csv", about, SUMMARY, summary(rows))


def truths(entry: dict[str, Any]) -> dict[str, np.ndarray]:
    """Return L*a*b* by region of a clean photograph, whose exposure and light are known."""
    photograph, outlines = _reduced(entry)
    shape = photograph.shape
    depth = depth_in_iris(shape, outlines.pupil, outlines.limbus)
    exposure = entry["exposure"] * np.array(entry["gains"])
    lamp, camera, room = entry["lamp"], entry["camera"], entry["room_radiance"]
    angles = np.radians([lamp["polar_deg"], lamp["azimuth_deg"]])
    cosine = _direction(*angles) @ _direction(camera["polar"], camera["azimuth"])
    paper = (lamp["irradiance"] * cosine / np.pi + room) * exposure
    ring = (depth > 0) & (depth < 1)
    seen = ~find_highlights(photograph.pixels, photograph.saturated & ring, ring)
    borders, found = {WHOLE_IRIS: (RINGS["pupillary ring"][0], RINGS["ciliary ring"][1])}, {}
    for name, (low, high) in (borders | RINGS).items():
        here = seen & (depth > low) & (depth < high)
        light = photograph.pixels[here].mean(0) - REFLECTANCE * room * exposure
        found[name] = np.asarray(lab_of(_relative() @ (light / paper)))
    return found


def taken_anew(photograph: Photograph, limbus: Ellipse, random: np.random.Generator) -> Photograph:
    """Return the eye with another white, in other light, by another camera."""
    mean, spread = WHITES
    person = _linear(mean + spread * random.standard_normal(3)) / _linear(mean)
    outside = np.clip((limbus.radii(photograph.shape) - 0.98) / 0.04, 0, 1)[..., None]
    gains = np.exp(TINT * random.standard_normal(3) * (1, 0, 1))
    light = photograph.pixels * (1 + outside * (person - 1)) * gains
    # A camera's meter exposes so that the bright parts just fit.
    light *= random.uniform(*EXPOSURE) / np.quantile(light.max(-1), 0.98)
    light = light * np.exp(CHANNEL * random.standard_normal(3))
    light = np.maximum(light, 0) ** np.exp(CONTRAST * random.standard_normal())
    light += NOISE * np.sqrt(light + 0.01) * random.standard_normal(light.shape)
    levels = np.round(255 * np.asarray(srgb_encode(np.clip(light, 0, 1))))
    pixels = np.asarray(srgb_decode(levels / 255), np.float32)
    return photograph._replace(pixels=pixels, saturated=(levels >= 254).any(-1))


def summary(rows: list[tuple[Any, ...]]) -> list[tuple[Any, ...]]:
    """Coverage, mean half width and errors by region and component."""
    found = []
    for region, component in dict.fromkeys(r[:2] for r in rows):
        own = np.array([r[2:] for r in rows if r[:2] == (region, component)])
        truth, middle, low, high = own.T
        off = middle - truth
        covered = float(((low <= truth) & (truth <= high)).mean())
        width, errors = float((high - low).mean() / 2), (off.mean(), np.sqrt((off**2).mean()))
        found.append((region, component, len(own), covered, width, *map(float, errors)))
    return found


def _reduced(entry: dict[str, Any]) -> tuple[Photograph, Boundaries]:
    photograph = read_photograph(FOLDER / entry["file"])
    pixels = np.asarray(reduce_picture(photograph.pixels, SCALE))
    saturated = reduce_picture(photograph.saturated[..., None].astype(np.float32), SCALE)[..., 0]
    small = photograph._replace(pixels=pixels, saturated=saturated > 0.1)
    limbus, pupil = (
        Ellipse(tuple(e["centre_px"]), tuple(e["semi_axes_px"]), e["angle"]).scaled(SCALE)
        for e in (entry["limbus"], entry["pupil"])
    )
    return small, Boundaries(limbus, pupil, 1.0, 1.0)


def _direction(polar: float, azimuth: float) -> np.ndarray:
    around = np.sin(polar) * np.array([np.cos(azimuth), np.sin(azimuth)])
    return np.append(around, np.cos(polar))


def _relative() -> np.ndarray:
    """From linear sRGB to XYZ relative to white."""
    to_xyz = np.linalg.inv(XYZ_TO_SRGB)
    return to_xyz / to_xyz.sum(1, keepdims=True)


def _linear(lab: np.ndarray) -> np.ndarray:
    """Linear sRGB of bright L*a*b*."""
    middle = (lab[0] + 16) / 116
    cubes = np.array([middle + lab[1] / 500, middle, middle - lab[2] / 200]) ** 3
    return np.linalg.solve(_relative(), cubes)


if __name__ == "__main__":
    start(main, __doc__)
