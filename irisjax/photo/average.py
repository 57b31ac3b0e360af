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


def average_maps(eye: Eye) -> IrisMaps:
    """Thickness of ultrasound's average, and the fibres, crypts and relief of `procedural`: shade
    and uneven thickness make an iris darker than a smooth one, by 6 % near the limbus to 15 % near
    the pupil.
    """
    radius = np.linspace(float(eye.pupil_radius), float(eye.iris_radius), 200)
    mean = np.average(generic_thickness(radius), weights=radius)
    return procedural(Iris(stroma_thickness=jnp.asarray(mean)), eye, key=jax.random.key(_SEED))
