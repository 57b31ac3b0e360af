"""The random process of ILIT, the solvers of it, and depth-resolved transport."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
