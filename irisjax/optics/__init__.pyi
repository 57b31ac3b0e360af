"""Public names of `irisjax.optics`; each loads from its module when it is first used."""

from .conicoid import Conicoid as Conicoid
from .kubelka_munk import thick_layer as thick_layer
from .mueller import stokes as stokes
