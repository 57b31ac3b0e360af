"""How far a Lambertian iris is from one whose BRDF is known for pairs of directions."""

from typing import NamedTuple

import numpy as np


class LambertError(NamedTuple):
    """A Lambertian iris of the albedo against the model's, relative, channel by channel, shape
    (channels,).

    - `rms`: of the whole iris's mean radiance, over pairs of directions within `CONE` of the normal
        in proportion to their cosines. `most`: the largest there, with its sign (negative: the
        Lambertian one is darker).
    - `texels`: r.m.s. over texels too, relative to the mean radiance of the iris.
    - `hemisphere`: as `rms`, over all directions, relative to the mean BRDF.
    """

    rms: np.ndarray
    most: np.ndarray
    texels: np.ndarray
    hemisphere: np.ndarray


def of_pairs(
    flat: np.ndarray,
    weight: np.ndarray,
    within: np.ndarray,
    within_weight: np.ndarray,
    whole: np.ndarray,
    whole_weight: np.ndarray,
) -> LambertError:
    """`LambertError` from BRDFs.

    Args:
        flat: BRDF of the Lambertian texels, (channels, texels); `weight` of each texel.
        within: BRDFs for cosines near the normal, (in, out, azimuths, channels, texels), with
            the cosines' weights; `whole`: the same over the hemisphere.
    """
    mean = flat @ weight

    def pairs(cosines):
        return (cosines[:, None] * cosines[None])[..., None, None]

    seen = within @ weight
    near = pairs(within_weight) / within.shape[2]
    off = mean / seen - 1
    by_texel = (flat - within) / seen[..., None]
    rows = off.reshape(-1, mean.size)
    most = rows[np.abs(rows).argmax(0), np.arange(mean.size)]
    ratio = (whole @ weight) / mean
    far = pairs(whole_weight) / whole.shape[2]
    average = (far * ratio).sum((0, 1, 2))
    return LambertError(
        rms=np.sqrt((near * off**2).sum((0, 1, 2))),
        most=most,
        texels=np.sqrt((near * (by_texel**2 @ weight)).sum((0, 1, 2))),
        hemisphere=np.sqrt((far * (ratio - 1) ** 2).sum((0, 1, 2))) / average,
    )
