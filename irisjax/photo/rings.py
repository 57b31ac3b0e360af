"""Rings that are dark inside and bright outside, found by voting.

Daugman's integro-differential operator searches circles of the strongest radial change of
brightness; here each pixel votes by the direction of its gradient alone, so that a highlight or a
burnt-out white counts no more than any other edge.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy import fft, ndimage

from irisjax.photo.edges import reduced
from irisjax.photo.ellipse import Ellipse

_RINGS = np.geomspace(20, 40, 9)[:-1]  # px: radii of one octave
_WEAK = 0.05  # change of log brightness per pixel that counts half


class Ring(NamedTuple):
    """A circle in pixels and the mean of its votes, at most 1."""

    column: float
    row: float
    radius: float
    votes: float

    def circle(self) -> Ellipse:
        """The same as an ellipse."""
        return Ellipse((self.column, self.row), (self.radius, self.radius))


def rings(
    brightness: Float[np.ndarray, "rows columns"],
    radii: tuple[float, float],
    number: int,
    sideways: float = 0.0,
) -> list[Ring]:
    """The rings of the most votes, up to `number` of each octave of radii, best first.

    Each octave is searched in a copy in which they are 20 to 40 px. `sideways`: how much
    less the top and the bottom of a ring count, 0 to 1: there lids are in the way.
    """
    kept: list[Ring] = []
    low, high = radii
    while low < high:
        found: list[Ring] = []
        scale = min(_RINGS[0] / low, 1.0)
        small = reduced(brightness[..., None], scale)[..., 0]
        shape = small.shape
        size = tuple(fft.next_fast_len(n + 2 * int(_RINGS[-1] + 10)) for n in shape)
        transformed = fft.fft2(_directions(small), size)
        for radius in _RINGS * (low * scale / _RINGS[0]):
            if radius / scale < 1.06 * high:
                votes = _votes(transformed, shape, radius, sideways)
                peak = ndimage.maximum_filter(votes, max(3, int(radius / 3)))
                for row, column in np.argwhere((votes == peak) & (votes > 0.15)):
                    at = (column + 0.5) / scale - 0.5, (row + 0.5) / scale - 0.5
                    found.append(Ring(*at, radius / scale, float(votes[row, column])))
        fresh: list[Ring] = []
        for ring in sorted(found, key=lambda r: -r.votes):
            if len(fresh) < number and not any(_alike(ring, other) for other in kept + fresh):
                fresh.append(ring)
        kept += fresh
        low *= 2
    return sorted(kept, key=lambda r: -r.votes)


def _alike(a: Ring, b: Ring) -> bool:
    near = np.hypot(a.column - b.column, a.row - b.row) < 0.3 * b.radius
    return bool(near and 0.75 < a.radius / b.radius < 1.33)


def _directions(brightness):
    """Of the gradient of log brightness: cosine minus i sine, weak ones brought towards 0."""
    floor = 0.02 * np.quantile(brightness, 0.98) + 1e-6
    smooth = ndimage.gaussian_filter(np.log(np.maximum(brightness, 0) + floor), 1.5)
    down, right = np.gradient(smooth)
    return ((right - 1j * down) / (np.hypot(down, right) + _WEAK)).astype(np.complex64)


def _votes(transformed, shape, radius: float, sideways: float):
    """Of rings of one radius about each pixel: the mean over the ring of the cosine between its
    normal and the gradient, whose directions come Fourier transformed.
    """
    n = int(np.ceil(radius + 5))
    y, x = np.mgrid[-n : n + 1, -n : n + 1]
    away = np.hypot(x, y) + 1e-9
    ring = np.exp(-0.5 * ((away - radius) / 2) ** 2) * (1 - sideways * (y / away) ** 2)
    # Correlation, and the kernel is odd: its mirror image is its negative.
    kernel = (-ring / ring.sum() * (x + 1j * y) / away).astype(np.complex64)
    size = transformed.shape
    summed = np.real(np.asarray(fft.ifft2(transformed * fft.fft2(kernel, size))))
    return summed[n : n + shape[0], n : n + shape[1]]
