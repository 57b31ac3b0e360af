"""Packages whose modules load when they are first asked for: `ij.tissue.iris` after `import irisjax
as ij`.
"""

import importlib
import importlib.util
from collections.abc import Callable
from types import ModuleType


def modules_of(package: str) -> Callable[[str], ModuleType]:
    """The `__getattr__` of a package."""

    def module(name: str) -> ModuleType:
        path = f"{package}.{name}"
        if importlib.util.find_spec(path) is None:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        return importlib.import_module(path)

    return module
