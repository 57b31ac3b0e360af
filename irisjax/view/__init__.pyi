"""Public names of `irisjax.view`; each loads from its module when it is first used."""

from .bench import Bench as Bench
from .server import check_address as check_address
from .server import serve as serve
from .session import Settings as Settings
from .studio import Studio as Studio
