"""Public names of `irisjax.transport`; each loads from its module when it is first used."""

from .process import AbstractProcess as AbstractProcess
from .solution import Absorbed as Absorbed
