"""Floor 2: what the iris and the media before it are made of."""

from irisjax._lazy import modules_of

__getattr__ = modules_of(__name__)
