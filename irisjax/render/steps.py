"""How the steps of a picture follow each other: simply, or kept by somebody (`stages.Memory`)."""

from collections.abc import Callable
from typing import Any, TypeAlias

Once: TypeAlias = Callable[..., Any]
"""Does a named step of a picture: `once(name, make, *inputs)` is `make(*inputs)`, done now or, of
the same inputs, before.
"""


def simply(name: str, make: Callable[..., Any], *inputs: Any) -> Any:
    """`make(*inputs)`: nothing is kept."""
    del name
    return make(*inputs)
