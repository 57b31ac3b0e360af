"""An iris from a photograph: outlines, pose, texture, thickness, light and pigments  [F09]."""

from irisjax._lazy import modules_of

__getattr__ = modules_of(__name__)
