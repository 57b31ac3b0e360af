"""An iris from a photograph: outlines, pose, texture, thickness, light and pigments  [F09]."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
