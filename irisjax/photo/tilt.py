"""How well ellipses tell the tilt of the circles that they show  [F09 Eq. 1].

Neither limbi nor pupils are circles. Both tell the tilt, by how they are flattened; how far the
pupil lies off the limbus's middle tells its side, but little of its size: 1 degree moves it by
0.016 mm, and people's pupils lie 0.3 mm off.
"""

import numpy as np
from scipy import special

LIMBUS_OVAL = 0.03
"""Flattening ln(a / b) of people's limbi seen from straight ahead, standard deviation of either
component; assumed. Textbooks' 11.7 by 10.6 mm would be 0.1, but rest on no measurement
[Bergmanson & Martinez 2017].
"""
PUPIL_OVAL = 0.025
"""The same of pupils: they deviate from a circle by 0.0166 of their radius, about half of which an
ellipse explains  [Wyatt 1995].
"""
FLATTER = 1.25
"""Flattening of a tilted limbus over that of the pupil, which the cornea shows turned towards the
camera.
"""
FLATTENING = float(1 / np.hypot(1 / LIMBUS_OVAL, 1 / (FLATTER * PUPIL_OVAL)))
"""That of either component which limbus and pupil tell together. How well outlines are measured
hardly adds to it: by 0.003 where lids hide half of the limbus.
"""


def tilts_allowed(
    tilt: float, flattening_sd: float = FLATTENING
) -> tuple[float, tuple[float, float]]:
    """Standard deviation and the 95 % interval (radians) of the tilts that outlines of a tilt
    leave possible.

    What errs is the limbus's flattening q = ln(a / b) = -ln cos(tilt) [F09 Eq. 1], a vector whose
    direction is twice the axis's angle; each component by `flattening_sd`. The length that is seen
    of such a vector follows Rice's distribution. Where every camera's direction is as likely, so
    is every q (nearly, below 40 degrees), and the interval is the shortest in q that holds 95 %. No
    straight line replaces the arc cosine, whose slope has no bound at 0: an eye that looks into the
    camera has an interval from 0 to 17 degrees, one at 30 degrees of 4 to each side.
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
