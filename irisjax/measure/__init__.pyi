"""Public names of `irisjax.measure`; each loads from its module when it is first used."""

from .colour import illuminant_power as illuminant_power
from .colour import lab_of as lab_of
from .polarimeter import PolarisedInstrument as PolarisedInstrument
