"""The shapes of the eye round its iris."""

from irisjax._lazy import modules_of

__getattr__ = modules_of(__name__)
