"""Scenes handed over to other renderers, as meshes, textures and scene files."""

import importlib
from typing import TYPE_CHECKING

from irisjax._lazy import modules_of

if TYPE_CHECKING:
    from irisjax.export.handover import export as export
    from irisjax.export.mesh import eye_meshes as eye_meshes
    from irisjax.export.mesh import write_eye as write_eye

_LATER = {"handover": ("export",), "mesh": ("eye_meshes", "write_eye")}


def __getattr__(name: str):
    for module, names in _LATER.items():
        if name in names:
            return getattr(importlib.import_module(f"irisjax.export.{module}"), name)
    return modules_of(__name__)(name)
