"""Painted irides: coats of paint on cones, as ocularists make them [L03]."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
