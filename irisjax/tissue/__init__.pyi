"""Public names of `irisjax.tissue`; each loads from its module when it is first used."""

from .iris import FRACTIONS as FRACTIONS
from .iris import LIMITS as LIMITS
from .pigments import Extinction as Extinction
