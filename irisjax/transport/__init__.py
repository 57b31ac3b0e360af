"""The random process of ILIT, the solvers of it, and depth-resolved transport."""

from irisjax._lazy import modules_of

__getattr__ = modules_of(__name__)
