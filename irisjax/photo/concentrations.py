"""Melanins of an iris as concentrations in each of its layers."""

from typing import Any

import jax.numpy as jnp

from irisjax.tissue.iris import Iris

CONCENTRATIONS = ("abl_eumelanin", "abl_pheomelanin", "stroma_eumelanin", "stroma_pheomelanin")
"""The four that are sought, mg/ml of each layer."""


def iris_of(values: dict[str, Any], base: Iris) -> Iris:
    """The iris of four concentrations (mg/ml of each layer) and a factor on the scattering of
    `base`.
    """
    height = base.abl_thickness, base.stroma_thickness
    whole = height[0] + height[1]

    def shared(kind):
        masses = [
            values[f"{layer}_{kind}"] * h
            for layer, h in zip(("abl", "stroma"), height, strict=True)
        ]
        total = masses[0] + masses[1]
        none = total <= 0
        return total / whole, jnp.where(none, 0.5, masses[0] / jnp.where(none, 1.0, total))

    (eumelanin, first), (pheomelanin, second) = shared("eumelanin"), shared("pheomelanin")
    return base.replace(
        eumelanin=eumelanin,
        pheomelanin=pheomelanin,
        abl_fraction=first,
        pheomelanin_abl_fraction=second,
        scattering_scale=values.get("scattering_scale", 1.0) * base.scattering_scale,
    )


def concentrations_of(iris: Iris) -> dict[str, float]:
    """The four concentrations of an iris, mg/ml of each layer."""
    second = iris.pheomelanin_abl_fraction
    shares = iris.abl_fraction, iris.abl_fraction if second is None else second
    whole = iris.abl_thickness + iris.stroma_thickness
    found = {}
    for kind, share in zip(("eumelanin", "pheomelanin"), shares, strict=True):
        mass = getattr(iris, kind) * whole
        found[f"abl_{kind}"] = float(mass * share / iris.abl_thickness)
        found[f"stroma_{kind}"] = float(mass * (1 - share) / iris.stroma_thickness)
    return {name: found[name] for name in CONCENTRATIONS}
