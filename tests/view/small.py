"""Maps that need no growing."""

import numpy as np

from irisjax.tissue.iris import Iris
from irisjax.tissue.maps import IrisMaps


def grown(seed=0, eumelanin=1.0):
    """An iris and maps that need no growing."""
    iris = Iris(eumelanin=eumelanin)
    uneven = np.random.default_rng(seed).uniform(0.5, 1.5, (32, 16))
    return iris, IrisMaps(stroma_depth=uneven * iris.stroma_thickness, relief=0.05 * uneven)
