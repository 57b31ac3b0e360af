"""A painted eye as tissue: maps and a scene file, for whatever takes those."""

import tomlkit

from irisjax.anatomy.eye import Eye
from irisjax.io.maps import encode_maps
from irisjax.ocularist.bridge import Tissue
from irisjax.tissue.iris import LIMITS

MAPS, SCENE = "maps.exr", "scene.toml"
"""Names of the files."""


def tissue_files(tissue: Tissue, eye: Eye) -> dict[str, bytes]:
    """The files of a painting that `maps_of` made tissue of, by name: maps, and a scene of that
    iris in the painted eye's place, behind F09's cornea and as bright as the paint; without its
    white, which would burn out.
    """
    document = tomlkit.document()
    for line in (
        "A painted eye as tissue, by irisjax. Its colours differ from the paint's by a mean dE*ab",
        f"of {tissue.left.mean:.1f} at this exposure; the white (sclera = true) burns out in it.",
    ):
        document.add(tomlkit.comment(line))
    iris = {name: getattr(tissue.iris, name) for name in LIMITS}
    places = "iris_depth", "iris_slope", "limbus_radius", "limbus_width"
    places += "iris_radius", "pupil_radius", "pupil_margin"
    anatomy = {name: getattr(eye, name) for name in places}
    document["iris"] = _numbers(iris)
    document["maps"] = {"file": MAPS}
    document["eye"] = {"cornea": "f09", "sclera": False, **_numbers(anatomy)}
    document["picture"] = _numbers({"exposure": tissue.exposure})
    return {
        MAPS: encode_maps(MAPS, tissue.maps),
        SCENE: tomlkit.dumps(document).encode(),
    }


def _numbers(values) -> dict[str, float]:
    """Those that are there, to the digits of single precision."""
    return {name: float(f"{float(v):.7g}") for name, v in values.items() if v is not None}
