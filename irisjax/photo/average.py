"""The iris that pigments are told with: what is usual at each distance from the pupil.

Thickness that a photograph told must not tell its pigments: the same brightness would be asked
twice, and an error of the one would be taken for the other.
"""

import jax
import jax.numpy as jnp
import numpy as np

from irisjax.anatomy.eye import Eye
from irisjax.grow.procedural import procedural
from irisjax.photo.thickness import generic_thickness
from irisjax.tissue.iris import Iris
from irisjax.tissue.maps import IrisMaps

TURNS = 16
"""Places round the eye at which its maps stand in turn, so that no feature has a place."""
_SEED = 5


def average_thickness(eye: Eye) -> float:
    """Mean of the generic thickness over the area of an eye's iris, mm."""
    radius = np.linspace(float(eye.pupil_radius), float(eye.iris_radius), 200)
    return float(np.average(generic_thickness(radius), weights=radius))


def average_maps(eye: Eye) -> IrisMaps:
    """Thickness of ultrasound's average, and the fibres, crypts and relief of `procedural`: shade
    and uneven thickness make an iris darker than a smooth one, by 6 % near the limbus to 15 % near
    the pupil.
    """
    iris = Iris(stroma_thickness=jnp.asarray(average_thickness(eye)))
    return procedural(iris, eye, key=jax.random.key(_SEED))
