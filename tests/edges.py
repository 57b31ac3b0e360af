"""Irides at the edges of the physics, and what must hold for their light."""

import numpy as np

import irisjax as ij
from irisjax.tissue.iris import LIMITS

COSINES = (1.0, 0.3, 1e-6, 0.0)
TINY = {64: 1e-12, 32: 1e-6}

BASE = ij.Iris.of_level("low")
NUMBERS = tuple(n for n in LIMITS if n != "ipe_melanin")
"""Fields of an iris whose pigment epithelium is black; test_transmittance.py has others."""
BARE = {"oxyhemoglobin": 0.0, "deoxyhemoglobin": 0.0, "lutein": 0.0, "zeaxanthin": 0.0}
EDGES = {
    "plain": {},
    "no-melanin": {"eumelanin": 0.0, "pheomelanin": 0.0},
    "no-pigment": {"eumelanin": 0.0, "pheomelanin": 0.0, **BARE},
    "abl-fraction-0": {"abl_fraction": 0.0},
    "abl-fraction-1": {"abl_fraction": 1.0},
    "no-abl": {"abl_thickness": 0.0},
    "no-stroma": {"stroma_thickness": 0.0},
    "no-layers": {"abl_thickness": 0.0, "stroma_thickness": 0.0},
    "no-scattering": {"collagen_index": 1.5},
    "nothing-at-all": {"eumelanin": 0.0, "pheomelanin": 0.0, **BARE, "collagen_index": 1.5},
    "no-intensification": {"intensification": 1e-30},
    "most-melanin": {"eumelanin": 2e3},
    "most-blood": {"oxyhemoglobin": 10.0},
    "most-of-all": {"eumelanin": 2e3, "pheomelanin": 2e3, "lutein": 1e3, "oxyhemoglobin": 10.0},
    "equal-indices": {"abl_index": 1.4, "stroma_index": 1.4, "ipe_index": 1.4},
    "abl-is-stroma": {"abl_index": 1.4727, "stroma_index": 1.4727},
    "guided-stroma": {"stroma_index": 1.6, "abl_index": 1.4},
    "total-at-ipe": {"ipe_index": 1.3},
}

_MEDIA = {"abl_index", "stroma_index", "ipe_index", "collagen_index"}
SAME_MEDIA = [e for e in EDGES if not _MEDIA & set(EDGES[e])]
"""Edges that leave the refractive indices as they are."""
OF_DEPTHS = (
    "eumelanin", "pheomelanin", "abl_fraction", "oxyhemoglobin", "lutein", "abl_thickness", "stroma_thickness",
)  # fmt: skip
"""Fields of an iris that change its layers' depths alone."""


_INDICES = BASE.indices()


def edge(name):
    fields = {"abl_index": _INDICES.abl, "stroma_index": _INDICES.stroma, **EDGES[name]}
    # Both melanins shared out alike, each by a number of its own.
    fields.setdefault("pheomelanin_abl_fraction", fields.get("abl_fraction", BASE.abl_fraction))
    return {n: float(fields.get(n, getattr(BASE, n))) for n in NUMBERS}


VECTORS = {e: np.array([edge(e)[n] for n in NUMBERS]) for e in EDGES}
"""Made once, in double precision."""


# An empty stroma between mirrors: grazing rays make reflectance go as τ ln τ, whose slope at 0 is
# infinite.
NO_SLOPE = ("no-layers", "nothing-at-all")


def grazes(indices, cosine):
    """Whether light along this cosine in the aqueous humour is so near to grazing in the stroma
    that its number of depth panels may be too few, which the status says.
    """
    ratio = float(indices[0]) / float(indices[2])
    inside = np.sqrt(max(1 - ratio**2 * (1 - float(cosine) ** 2), 0.0))
    return 0 < inside < 0.25
