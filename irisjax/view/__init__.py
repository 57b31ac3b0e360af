"""The interactive viewer: what a change of settings costs (`Studio`, and `Bench` for a painted
eye), and the page that shows it (`serve`).
"""

from irisjax.view.bench import Bench
from irisjax.view.server import check_address, serve
from irisjax.view.session import Settings
from irisjax.view.studio import Studio

__all__ = ["Bench", "Settings", "Studio", "check_address", "serve"]
