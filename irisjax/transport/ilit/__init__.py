"""The random process of [LB06], integrated, tabulated and sampled."""

from irisjax._lazy import modules_of

__getattr__ = modules_of(__name__)
