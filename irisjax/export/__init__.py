"""Scenes handed over to other renderers, as meshes, textures and scene files."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
