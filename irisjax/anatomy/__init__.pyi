"""Public names of `irisjax.anatomy`; each loads from its module when it is first used."""

from .lids import Lids as Lids
from .sclera import VeinMap as VeinMap
