"""Components of coats by their names in recipes  [L03 Section 2.3, Fig. 3].

The paper scans what an ocularist has painted; these are drawn from a key (`scan` takes the former).
"""

from collections.abc import Mapping
from typing import Any

from irisjax.numerics.checks import check_known
from irisjax.ocularist.component import AbstractComponent, check_parameter
from irisjax.ocularist.rings import Base, Limbus, Pupil, Sphincter
from irisjax.ocularist.stroma import (
    CollaretteDots,
    CollaretteSpokes,
    StromaDots,
    StromaSmearedDots,
    StromaSmears,
)

COMPONENTS: Mapping[str, type[AbstractComponent]] = {
    "base": Base,
    "stroma-dots": StromaDots,
    "stroma-smeared-dots": StromaSmearedDots,
    "stroma-smears": StromaSmears,
    "collarette-spokes": CollaretteSpokes,
    "collarette-dots": CollaretteDots,
    "sphincter": Sphincter,
    "limbus": Limbus,
    "pupil": Pupil,
}
"""Components by the names that recipes have for them."""


def component(name: str, parameters: Mapping[str, Any] | None = None) -> AbstractComponent:
    """The component of a name, with its defaults where `parameters` say nothing else.

    **Raises:** `ValueError` naming the known ones for an unknown component or parameter, and for a
    value out of range.
    """
    check_known("component", name, COMPONENTS)
    kind, parameters = COMPONENTS[name], parameters or {}
    for given in parameters:
        check_known(f"parameter of {name}", given, kind.__dataclass_fields__)
    try:
        # Before the types of fields are checked, where they are: a file may hold anything.
        for given, value in parameters.items():
            check_parameter(given, value)
        return kind(**parameters)
    except ValueError as wrong:
        raise ValueError(f"{name}: {wrong}") from None
