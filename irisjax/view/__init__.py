"""The interactive viewer: what a change of settings costs (`Studio`, and `Bench` for a painted
eye), and the page that shows it (`serve`).
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
