"""`IrisMaps`: what photographs, painters and procedures hand to the renderers, texel by texel.

Polar textures of shape (angles, radii): rows run once round the eye from +x towards +y, columns
from the pupil's edge to the root, both at cell centres. The pupil's motion stretches them; they do
not change with it.
"""

import dataclasses
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float

from irisjax._types import as_float_or_none
from irisjax.tissue.iris import Iris
from irisjax.tissue.layers import Layers
from irisjax.tissue.pigments import Extinction

Texture = Float[Array, "angles radii"]


def _texture() -> Any:
    return eqx.field(default=None, converter=as_float_or_none)


class IrisMaps(eqx.Module):
    """Maps of an iris; every one may be absent (`None`), which costs nothing.

    - `relief`: height of the surface towards the cornea, mm; it tilts the surface and shades it.
    - `abl_depth`, `stroma_depth`: of the layers at each texel, mm. A texel keeps the concentrations
        of each layer of the `Iris`, so a deeper one holds more pigment. An `Iris` of that
        thickness, whose melanin is shared out by mass, gives another picture.
    - `freckles`: share of a freckle, 0 to 1; where it is 1 the ABL holds `FRECKLE` times its
        melanin.
    - `eumelanin`, `pheomelanin`: concentrations relative to the `Iris`'s, both layers alike.

    **Raises:** `ValueError` for maps of different shapes and for values that no iris has.
    """

    relief: Texture | None = _texture()
    abl_depth: Texture | None = _texture()
    stroma_depth: Texture | None = _texture()
    freckles: Texture | None = _texture()
    eumelanin: Texture | None = _texture()
    pheomelanin: Texture | None = _texture()

    def __post_init__(self):
        shapes = {n: np.shape(m) for n, m in self.present().items()}
        if len(set(shapes.values())) > 1:
            raise ValueError(
                f"maps differ in shape: {', '.join(f'{n} {s}' for n, s in shapes.items())}"
            )
        for name, found in self.present().items():
            if isinstance(found, Tracer):
                continue
            m = np.asarray(found)
            if m.ndim != 2 or min(m.shape) < 2:
                raise ValueError(
                    f"map {name} has shape {m.shape}; need (angles, radii), at least 2 of each"
                )
            low, high = (
                (-1, 1) if name == "relief" else (0, 1) if name == "freckles" else (0, np.inf)
            )
            if not (m.min() >= low and m.max() <= high and m.max() < np.inf):  # false for NaN too
                raise ValueError(f"map {name} has values outside [{low:g}, {high:g}] or not finite")

    def present(self) -> dict[str, Any]:
        """The maps there are, by name."""
        return {
            f.name: m for f in dataclasses.fields(self) if (m := getattr(self, f.name)) is not None
        }

    @property
    def shape(self) -> tuple[int, int]:
        """(angles, radii), or (2, 2) where there is no map."""
        present = self.present()
        return next(iter(present.values())).shape if present else (2, 2)

    def replace(self, **fields: Any) -> "IrisMaps":
        """A copy with some maps changed."""
        return dataclasses.replace(self, **fields)

    def abl_scale(self, iris: Iris) -> Texture | None:
        """Melanin of the ABL relative to that of a uniform `iris`; `None` where it is one
        everywhere.
        """
        scale = None if self.abl_depth is None else self.abl_depth / iris.abl_thickness
        if self.freckles is not None:
            dark = 1 + (FRECKLE - 1) * self.freckles
            scale = dark if scale is None else scale * dark
        return scale

    def stroma_scale(self, iris: Iris) -> Texture | None:
        """Thickness of the stroma relative to that of a uniform `iris`; `None` where it is one
        everywhere.
        """
        return None if self.stroma_depth is None else self.stroma_depth / iris.stroma_thickness

    def check(self, iris: Iris) -> None:
        """Raise `ValueError` where a layer of an iris has no concentrations for a map to keep."""
        for layer in ("abl", "stroma"):
            thickness = getattr(iris, f"{layer}_thickness")
            given = getattr(self, f"{layer}_depth") is not None
            if given and not isinstance(thickness, Tracer) and not np.asarray(thickness).all():
                raise ValueError(
                    f"{layer}_thickness = 0 mm leaves no concentrations for the map "
                    f"{layer}_depth to keep"
                )


FRECKLE = 12.0
"""Melanin of the ABL in a freckle relative to its surroundings: thicker and denser, after F09's
hand-set maps.
"""


class Scales(NamedTuple):
    """How texels differ from the uniform iris: pigment of the ABL, thickness of the stroma, and
    concentrations of eumelanin and pheomelanin, each relative to the iris's. `None`: one
    everywhere."""

    abl: Any = None
    stroma: Any = None
    eumelanin: Any = None
    pheomelanin: Any = None

    @classmethod
    def of(cls, maps: IrisMaps | None, iris: Iris) -> "Scales":
        """Textures of the maps."""
        if maps is None:
            return cls()
        return cls(maps.abl_scale(iris), maps.stroma_scale(iris), maps.eumelanin, maps.pheomelanin)

    def ranges(self) -> "Scales":
        """Smallest and largest value of each texture, a little widened; without gradients: they
        place nodes.
        """

        def span(t):
            return jax.lax.stop_gradient(jnp.stack([0.95 * jnp.min(t), 1.05 * jnp.max(t) + 1e-3]))

        return Scales(*(None if t is None else span(t) for t in self))


def cell_centres(shape: tuple[int, int]) -> tuple[jax.Array, jax.Array]:
    """Angles (radians) and relative radii of a texture's cells, shapes (angles,) and (radii,)."""
    rows, columns = shape
    return (jnp.arange(rows, dtype=float) + 0.5) * (2 * jnp.pi / rows), (
        jnp.arange(columns, dtype=float) + 0.5
    ) / columns


def check_pictured(iris: Iris) -> None:
    """Raise `ValueError` for an iris with a power law of scattering: pictures know none."""
    if iris.power_law is not None:
        raise ValueError(
            "a picture takes the iris's formula of scattering (lb06, rayleigh-spheres), not a "
            "power law"
        )


def texel_layers(iris: Iris, aqueous_index, table: Extinction, scales: Scales) -> Layers:
    """Layers of a texel, its scales numbers or `None`."""
    if scales.eumelanin is not None:
        iris = eqx.tree_at(lambda i: i.eumelanin, iris, iris.eumelanin * scales.eumelanin)
    if scales.pheomelanin is not None:
        iris = eqx.tree_at(lambda i: i.pheomelanin, iris, iris.pheomelanin * scales.pheomelanin)
    check_pictured(iris)
    layers = iris.layers(table, aqueous_index)
    abl = 1.0 if scales.abl is None else scales.abl
    stroma = 1.0 if scales.stroma is None else scales.stroma
    return Layers(
        layers.abl_absorption * abl,
        layers.stroma_absorption * stroma,
        layers.stroma_scattering * stroma,
        layers.indices,
        layers.order,
    )
