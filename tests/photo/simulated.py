"""Simulated photographs with lids, lashes, a highlight and noise, and their true outlines."""

import functools
import json
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy import ndimage

from irisjax.io.photographs import read_photograph
from irisjax.photo.edges import reduce_picture
from irisjax.photo.photograph import Ellipse, Photograph

FOLDER = Path(__file__).parent.parent.parent / "data" / "photographs"
SKIN = np.array([0.45, 0.26, 0.18])


class Simulated(NamedTuple):
    """A picture (rows, columns, 3), linear, with the outlines that the camera's geometry gives."""

    pixels: np.ndarray
    limbus: Ellipse
    pupil: Ellipse

    def photograph(self) -> Photograph:
        return as_photograph(self.pixels)


def as_photograph(pixels, name="made.png") -> Photograph:
    pixels = np.clip(pixels, 0, 1)
    return Photograph(pixels.astype(float), (pixels > 0.99).any(-1), name=name)


def truths(folder: Path) -> list[dict]:
    """The numbers that the photographs of a folder were made with."""
    return json.loads((folder / "truth.json").read_text(encoding="utf-8"))["photographs"]


def outline(truth: dict, name: str, scale=1.0) -> Ellipse:
    of = truth[name]
    return Ellipse(tuple(of["centre_px"]), tuple(of["semi_axes_px"]), of["angle"]).scaled(scale)


def reduced(path: Path, scale: float) -> Photograph:
    photo = read_photograph(path)
    cut_off = reduce_picture(photo.saturated[..., None].astype(float), scale)[..., 0] > 0
    focal = photo.focal_px and scale * photo.focal_px
    pixels = reduce_picture(photo.pixels, scale)
    return photo._replace(pixels=pixels, saturated=cut_off, focal_px=focal)


@functools.cache
def photographed(name: str, scale: float) -> Simulated:
    """A simulated photograph of the project without lids, reduced."""
    truth = next(truth for truth in truths(FOLDER) if truth["file"] == name)
    pixels = reduced(FOLDER / name, scale).pixels.astype(float)
    return Simulated(pixels, *(outline(truth, n, scale) for n in ("limbus", "pupil")))


def with_lids(eye: Simulated, upper=0.62, lower=0.8) -> Simulated:
    """Skin that cuts the limbus along parabolas, `upper` and `lower` times its radius from its
    centre, and a shadow below the upper one.
    """
    rows, columns = eye.pixels.shape[:2]
    row, column = np.mgrid[:rows, :columns]
    (x, y), r = eye.limbus.centre, eye.limbus.semi_axes[0]
    u, v = (column - x) / r, (row - y) / r
    top, bottom = -upper + 0.35 * u**2, lower - 0.2 * (u - 0.1) ** 2
    texture = ndimage.gaussian_filter(np.random.default_rng(1).normal(size=u.shape), r / 80)
    skin = SKIN * (1 + 0.1 * texture / texture.std())[..., None]
    shadow = 1 - 0.5 * np.exp(-np.maximum(v - top, 0) / 0.06)
    lid = ndimage.gaussian_filter(((v < top) | (v > bottom)).astype(float), 0.01 * r)[..., None]
    return eye._replace(pixels=lid * skin + (1 - lid) * eye.pixels * shadow[..., None])


def with_lashes(eye: Simulated, number=25, upper=0.75, seed=2) -> Simulated:
    """Thin dark arcs that hang from the upper lid into the iris."""
    rng = np.random.default_rng(seed)
    covered = np.zeros(eye.pixels.shape[:2])
    (x, y), r = eye.limbus.centre, eye.limbus.semi_axes[0]
    t = np.linspace(0, 1, int(2 * r))
    for start, length, lean in zip(
        rng.uniform(-1.1, 1.1, number),
        rng.uniform(0.2, 0.55, number),
        rng.normal(0, 0.1, number),
        strict=True,
    ):
        column = x + r * (start + (lean + 0.15 * start) * t**2)
        row = y + r * (-upper + 0.35 * start**2 + length * t)
        inside = (row >= 0) & (column >= 0) & (row < covered.shape[0] - 1)
        inside &= column < covered.shape[1] - 1
        covered[row[inside].astype(int), column[inside].astype(int)] = 1
    covered = np.minimum(3 * ndimage.gaussian_filter(covered, 0.006 * r) * 0.012 * r, 1)
    return eye._replace(pixels=eye.pixels * (1 - 0.93 * covered[..., None]))


def with_highlight(eye: Simulated, right=-0.25, up=0.2, size=0.12) -> Simulated:
    """A saturated disc, placed and measured in radii of the limbus."""
    row, column = np.mgrid[: eye.pixels.shape[0], : eye.pixels.shape[1]]
    (x, y), r = eye.limbus.centre, eye.limbus.semi_axes[0]
    away = np.hypot(column - x - right * r, row - y + up * r)
    return eye._replace(pixels=np.where((away < size * r)[..., None], 1.0, eye.pixels))


def with_noise(eye: Simulated, sd=0.015, readout=0.002, seed=3) -> Simulated:
    """A sensor's: `sd` of photon noise in white, less in the dark as its root, and `readout`."""
    noise = np.random.default_rng(seed).normal(0, 1, eye.pixels.shape)
    noise *= np.sqrt(sd**2 * np.maximum(eye.pixels, 0) + readout**2)
    return eye._replace(pixels=np.clip(eye.pixels + noise, 0, 1))


def exposed(eye: Simulated, white=0.8) -> Simulated:
    """Brightened until the 98th percentile is at `white`."""
    scale = white / np.quantile(eye.pixels, 0.98)
    return eye._replace(pixels=np.clip(eye.pixels * scale, 0, 1))
