"""Pictures with holes: filling them, and means that leave them out."""

import numpy as np
import scipy.fft
from jaxtyping import Bool, Float, Shaped

_LEAST_WEIGHT = 1e-3
"""Share of a mean's weight that must lie on valid texels; below it rounding would show."""


def fill(
    pixels: Float[np.ndarray, "rows columns ..."], holes: Bool[np.ndarray, "rows columns"]
) -> Float[np.ndarray, "rows columns ..."]:
    """The picture with its holes filled smoothly from round about; exact outside of them.

    Means over ever larger squares, each leaving the holes out, and back by linear interpolation: a
    wide hole takes the colours of a wide neighbourhood in time proportional to the pixels. Values
    lie between those outside. **Raises:** `ValueError` where nothing but holes is left.
    """
    if holes.all():
        raise ValueError(f"all {holes.size} pixels are holes; there is nothing to fill them from")
    if not holes.any():
        return pixels.copy()
    hole = holes[..., None]
    layers = np.where(hole, 0, pixels.reshape(*holes.shape, -1)).astype(np.float32)
    filled = _filled(layers, (~hole).astype(np.float32)).reshape(pixels.shape)
    return np.where(holes.reshape(holes.shape + (1,) * (pixels.ndim - 2)), filled, pixels).astype(
        pixels.dtype
    )


def masked_mean(
    values: Float[np.ndarray, "rows columns"], valid: Bool[np.ndarray, "rows columns"], sigma: float
) -> Float[np.ndarray, "rows columns"]:
    """Gaussian-weighted mean of the valid texels around each texel; `sigma` in texels.

    The mean of all where every one of them is far. **Raises:** `ValueError` where none is valid.
    """
    if not valid.any():
        raise ValueError("no texel is valid: there is nothing to take a mean of")
    mean_of = Gaussian(valid.shape, sigma)
    weight = mean_of(valid)
    far = weight < _LEAST_WEIGHT
    mean = mean_of(np.where(valid, values, 0)) / np.where(far, 1, weight)
    return np.where(far, values[valid].mean(dtype=np.float32), mean)


class Gaussian:
    """Convolution of pictures of one shape with a Gaussian, by Fourier transforms in float32.

    `sigma` in texels, 0 for none. A picture is continued by zeros, or `periodic`ally after a few of
    them.
    """

    def __init__(self, shape: tuple[int, ...], sigma: float, periodic: bool = False):
        self.shape = shape
        margin = 0 if periodic else int(np.ceil(4 * sigma))
        self.padded = [scipy.fft.next_fast_len(n + margin, real=True) for n in shape]
        rows, columns = (
            np.exp(-2 * (np.pi * sigma * frequency) ** 2).astype(np.float32)
            for frequency in (scipy.fft.fftfreq(self.padded[0]), scipy.fft.rfftfreq(self.padded[1]))
        )
        self.transfer = rows[:, None] * columns

    def __call__(self, values: Shaped[np.ndarray, "rows columns"]) -> np.ndarray:
        """The picture convolved."""
        spectrum = np.asarray(scipy.fft.rfft2(values.astype(np.float32), self.padded))
        whole = np.asarray(scipy.fft.irfft2(spectrum * self.transfer, self.padded))
        return whole[: self.shape[0], : self.shape[1]]


def _filled(total: np.ndarray, known: np.ndarray) -> np.ndarray:
    """Values whose sums over the known parts are `total`, filled where less than all is known."""
    if known.all():
        return total / known
    rows, columns = known.shape[:2]
    if rows == columns == 1:
        return total / known
    coarse = [_halved(x) for x in (total, known)]
    # A quarter known is enough for a square to count in full at the next level.
    share = np.maximum(coarse[1], 1e-30)
    weight = np.minimum(4 * coarse[1], 1.0)
    below = _filled(coarse[0] / share * weight, weight)
    above = _doubled(_doubled(below).swapaxes(0, 1)).swapaxes(0, 1)[:rows, :columns]
    return total + (1 - known) * above


def _doubled(x: np.ndarray) -> np.ndarray:
    """Twice as many rows, linear between the middles of the old ones and held at the ends."""
    above, below = np.concatenate([x[:1], x[:-1]]), np.concatenate([x[1:], x[-1:]])
    return np.stack([0.75 * x + 0.25 * above, 0.75 * x + 0.25 * below], 1).reshape(-1, *x.shape[1:])


def _halved(x: np.ndarray) -> np.ndarray:
    """Means over squares of 2 × 2, the picture continued by zeros to even sizes."""
    x = np.pad(x, [(0, n % 2) for n in x.shape[:2]] + [(0, 0)])
    return (x[::2, ::2] + x[1::2, ::2] + x[::2, 1::2] + x[1::2, 1::2]) / 4
