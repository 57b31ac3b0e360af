"""How well an ellipse tells the tilt of the circle that it shows  [F09 Eq. 1]."""

import numpy as np
from scipy import special

OUTLINE = 0.004
"""Standard deviation of points of a limbus's outline, of its radius."""
FLATTENING = 2 * np.sqrt(2 / 5) * OUTLINE
"""That of ln(a / b), twice an amplitude: the outline errs as five points apart would."""


def tilts_allowed(
    tilt: float, flattening_sd: float = FLATTENING
) -> tuple[float, tuple[float, float]]:
    """Standard deviation and the 95 % interval (radians) of the tilts that an outline of a tilt
    leaves possible.

    What errs is the outline's flattening q = ln(a / b) = -ln cos(tilt) [F09 Eq. 1], a vector whose
    direction is twice the axis's angle; each component by `flattening_sd`. The length that is seen
    of such a vector follows Rice's distribution. Where every camera's direction is as likely, so
    is every q (nearly, below 40 degrees), and the interval is the shortest in q that holds 95 %. No
    straight line replaces the arc cosine, whose slope has no bound at 0: an eye that looks into the
    camera has an interval from 0 to 8 degrees, one at 30 degrees of half a degree to each side.
    """
    seen = -np.log(np.cos(tilt))
    q = np.linspace(max(seen - 6 * flattening_sd, 0.0), seen + 6 * flattening_sd, 4001)
    rice = np.exp(-0.5 * ((q - seen) / flattening_sd) ** 2)
    rice *= special.ive(0, q * seen / flattening_sd**2)
    share = np.concatenate([[0.0], np.cumsum(rice[1:] + rice[:-1])])
    share /= share[-1]
    begin = q[share < 0.05]
    end = np.interp(share[share < 0.05] + 0.95, share, q)
    k = int(np.argmin(end - begin))
    tilts = np.arccos(np.exp(-q))
    mean = (rice * tilts).sum() / rice.sum()
    sd = np.sqrt((rice * (tilts - mean) ** 2).sum() / rice.sum())
    low, high = (float(np.arccos(np.exp(-v))) for v in (begin[k], end[k]))
    return float(sd), (low, high)
