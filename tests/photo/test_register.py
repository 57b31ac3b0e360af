"""A second photograph comes to lie on the first, though light and highlights differ."""

import functools
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter, map_coordinates

from irisjax.photo import register
from irisjax.photo.photograph import Ellipse, Photograph
from irisjax.photo.register import lay_on_first, register_photographs

SHAPE, LIMBUS = (300, 360), Ellipse((175.0, 150.0), (110.0, 108.0), 0.3)


@functools.cache
def eye():
    """A function of (column, row) arrays: fibres, crypts and a pupil, white around; in [0, 1]."""
    rng = np.random.default_rng(5)
    fibres = gaussian_filter(rng.normal(size=(200, 1400)), (12, 3), mode=("nearest", "wrap"))
    crypts = gaussian_filter(rng.normal(size=(200, 1400)), (8, 14), mode=("nearest", "wrap"))
    texture = 0.35 + 0.09 * fibres / fibres.std() + 0.06 * crypts / crypts.std()

    def at(column, row):
        share = LIMBUS.relative_radius(column, row)
        angle = np.arctan2(LIMBUS.centre[1] - row, column - LIMBUS.centre[0]) % (2 * np.pi)
        where = [np.clip(share, 0, 1) * 199, angle / (2 * np.pi) * 1400]
        iris = np.clip(map_coordinates(texture, where, order=1, mode="grid-wrap"), 0.05, 0.8)
        edge = np.clip((share - 0.98) / 0.04, 0, 1)
        pupil = np.clip((0.33 - share) / 0.02, 0, 1)
        return ((1 - edge) * iris + edge * 0.8) * (1 - pupil) + 0.02 * pupil

    return at


def similarity(scale, turn, shift):
    """(2, 3) from the first's pixels to the second's, about the middle of the limbus."""
    cos, sin = scale * np.cos(turn), scale * np.sin(turn)
    matrix = np.array([[cos, sin], [-sin, cos]])  # rows count downwards
    centre = np.array(LIMBUS.centre)
    return np.column_stack([matrix, centre + shift - matrix @ centre])


def photograph(transform, shape, highlights=(), tint=(1.0, 0.8, 0.5), slope=0.0, noise=0.004):
    """What `transform` shows of the eye, (2, 3), with burnt-out discs (column, row, radius)."""
    row, column = np.mgrid[: shape[0], : shape[1]].astype(float)
    back = np.linalg.inv(transform[:, :2])
    there = np.tensordot(back, np.stack([column - transform[0, 2], row - transform[1, 2]]), 1)
    light = eye()(*there) * np.exp(slope * (column / shape[1] - 0.5))
    rng = np.random.default_rng(1)
    pixels = light[..., None] * np.array(tint) + noise * rng.normal(size=(*shape, 3))
    for x, y, radius in highlights:
        distance = np.hypot(column - x, row - y) - radius
        pixels += np.exp(-np.maximum(distance, 0) / 2)[..., None]
    pixels = np.clip(pixels, 0, 1).astype(np.float32)
    return Photograph(pixels, (pixels >= 0.995).any(2))


def error(found, transform):
    """RMS distance (px) within the limbus between where pixels were put and where they are."""
    rows, columns = np.nonzero(LIMBUS.mask(SHAPE))
    points = np.stack([columns, rows, np.ones(len(rows))])
    return np.sqrt((((found - transform) @ points) ** 2).sum(0).mean())


IDENTITY = np.eye(2, 3)
HIGHLIGHTS = [(140, 110, 16), (215, 180, 9)]


@pytest.mark.parametrize(
    ("scale", "turn", "shift"), [(0.83, -0.21, (-11.0, 3.0)), (1.31, np.pi / 2, (20.0, 31.0))]
)
def test_a_similarity_is_found_to_half_a_pixel(scale, turn, shift):
    transform = similarity(scale, turn, shift)
    first = photograph(IDENTITY, SHAPE, HIGHLIGHTS, slope=0.6)
    second = photograph(transform, (430, 460), tint=(0.5, 0.4, 0.25), slope=-0.5)
    # Outlines as a detector finds them, 1 % off.
    centre = transform @ [*LIMBUS.centre, 1]
    limbus = Ellipse((centre[0] + 0.8, centre[1] - 0.7), (LIMBUS.semi_axes[0] * scale * 1.01,) * 2)
    found = register_photographs(second, first, LIMBUS, limbus)
    assert error(found.transform, transform) < 0.5
    assert found.scale == pytest.approx(scale, rel=3e-3)
    assert found.rotation == pytest.approx(turn, abs=3e-3)
    assert found.correlation > 0.7 and found.residual < 0.5
    truth = photograph(IDENTITY, SHAPE, tint=(0.5, 0.4, 0.25), noise=0.0).pixels
    inside = LIMBUS.mask(SHAPE) & found.valid
    assert inside.sum() > 0.98 * LIMBUS.mask(SHAPE).sum()
    assert np.corrcoef(found.pixels[inside, 1], truth[inside, 1])[0, 1] > 0.93


def test_pixels_beyond_the_second_and_cut_off_ones_are_not_valid():
    transform = similarity(1.0, 0.0, (-60.0, 0.0))
    first = photograph(IDENTITY, SHAPE)
    second = photograph(transform, SHAPE, [(120, 150, 10)])
    limbus = Ellipse((LIMBUS.centre[0] - 60, LIMBUS.centre[1]), LIMBUS.semi_axes, LIMBUS.angle)
    found = register_photographs(second, first, LIMBUS, limbus)
    assert error(found.transform, transform) < 0.5
    assert not found.valid[:, :59].any() and not found.valid[143:158, 173:188].any()
    assert found.valid[40:110, 80:330].all()
    assert found.pixels.dtype == np.float32 and found.pixels.shape == (*SHAPE, 3)


def test_another_eye_has_no_texture_in_common_and_is_refused(monkeypatch):
    first = photograph(IDENTITY, SHAPE)
    other = first._replace(pixels=first.pixels[::-1].copy(), name="brown.jpg")
    limbus, found = LIMBUS._replace(angle=-LIMBUS.angle), []

    def registered(*known):
        found.append(register_photographs(*known))
        return found[0]

    monkeypatch.setattr(register, "register_photographs", registered)
    monkeypatch.setattr(register, "find_boundaries", lambda _: SimpleNamespace(limbus=limbus))
    with pytest.raises(ValueError, match=r"brown\.jpg: its iris does not come to lie on .* 1\.5 %"):
        lay_on_first(other, first, LIMBUS, LIMBUS, (slice(9), slice(9)))
    assert found[0].correlation < 0.3


def test_outlines_out_of_the_picture():
    first = photograph(IDENTITY, SHAPE)
    with pytest.raises(ValueError, match=r"centred at column 500, row 20, out of the 360 × 300"):
        register_photographs(first, first, LIMBUS, LIMBUS._replace(centre=(500.0, 20.0)))
    with pytest.raises(ValueError, match=r"a radius of 9\.0 pixels"):
        register_photographs(first, first, LIMBUS._replace(semi_axes=(9.0, 9.0)), LIMBUS)
