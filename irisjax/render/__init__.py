"""Pictures of eyes: corneal optics, three integrators, lights and cameras."""

from irisjax._lazy import modules_of

__getattr__ = modules_of(__name__)
