"""`IrisMaps`: maps of an iris for the renderers, from photographs, painters or procedures.

Polar textures of shape (angles, radii): rows go around the eye from +x towards +y, columns from the
pupil's edge to the root, with values at cell centres. Another pupil radius stretches the maps;
`IrisMaps.moved` also thickens the layers as their area shrinks.
"""

import dataclasses
from collections.abc import Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import DTypeLike
from jaxtyping import Array, Float

from irisjax._types import Scalar, optional_field
from irisjax.anatomy.eye import Eye
from irisjax.numerics.checks import is_known
from irisjax.tissue.iris import Iris
from irisjax.tissue.layers import Layers
from irisjax.tissue.pigments import Extinction

Texture = Float[Array, "angles radii"]
FRECKLE = 12.0
"""Melanin of the ABL in a freckle relative to its surroundings: thicker and denser, after F09's
hand-set maps.
"""
_RANGES = {"relief": (-1, 1), "freckles": (0, 1)}  # of the other maps: not negative
_CHANNELS = 3  # of a residual: linear sRGB


class IrisMaps(eqx.Module):
    """Maps of an iris, shape (angles, radii); an absent one is `None` and costs nothing.

    A texel keeps the concentrations of each layer of the `Iris`, so a deeper layer contains more
    pigment. An `Iris` of that thickness, whose melanin is divided by mass, gives another picture.

    Approximation: a picture's table spans the range of each map, and a wider one is less exact. One
    texel of 20 times a preset's pigment changes the rest by 1.4 % at most, one of 100 times by 3 %.
    Derivatives leave that range as it is.

    Attributes:
        relief: Height of the surface towards the cornea, mm; it tilts the surface and shades it.
        abl_depth: Thickness of the anterior border layer (ABL), mm.
        stroma_depth: Thickness of the stroma, mm.
        freckles: Share of a freckle, 0 to 1; at 1 the ABL contains `FRECKLE` times its melanin.
        eumelanin: Concentration relative to the `Iris`'s, in both layers.
        pheomelanin: Concentration relative to the `Iris`'s, in both layers.
        residual: What a photograph shows over what the model does, in linear sRGB, of shape
            (angles, radii, 3). Pictures of colours are multiplied by it.

    Raises:
        ValueError: For maps of different shapes and for values that no iris can have.
    """

    relief: Texture | None = optional_field()
    abl_depth: Texture | None = optional_field()
    stroma_depth: Texture | None = optional_field()
    freckles: Texture | None = optional_field()
    eumelanin: Texture | None = optional_field()
    pheomelanin: Texture | None = optional_field()
    residual: Float[Array, "angles radii 3"] | None = optional_field()

    def __post_init__(self) -> None:
        shapes = {n: np.shape(m)[:2] for n, m in self.present().items()}
        if len(set(shapes.values())) > 1:
            raise ValueError(
                f"maps differ in shape: {', '.join(f'{n} {s}' for n, s in shapes.items())}"
            )
        for name, texture in self.present().items():
            if not is_known(texture):
                continue
            m = np.asarray(texture)
            colours = (_CHANNELS,) if name == "residual" else ()
            if m.ndim < 2 or m.shape[2:] != colours or min(m.shape) < 2:
                need = "(angles, radii, 3)" if colours else "(angles, radii)"
                raise ValueError(f"map {name} has shape {m.shape}; need {need}, at least 2 of each")
            low, high = _RANGES.get(name, (0, np.inf))
            if not (m.min() >= low and m.max() <= high and m.max() < np.inf):  # false for NaN too
                raise ValueError(f"map {name} has values outside [{low:g}, {high:g}] or not finite")

    def present(self) -> dict[str, Any]:
        """Return the maps that are set, by name."""
        return {name: m for name, m in vars(self).items() if m is not None}

    @property
    def shape(self) -> tuple[int, int]:
        """Shape (angles, radii), or (2, 2) without any map."""
        present = self.present()
        return next(iter(present.values())).shape[:2] if present else (2, 2)

    def replace(self, **fields: object) -> "IrisMaps":
        """Return a copy with some maps changed."""
        return dataclasses.replace(self, **fields)

    def moved(self, before: Eye, after: Eye) -> "IrisMaps":
        """Return the maps after the pupil of one eye has become that of another: tissue moves along
        the radius in proportion, and the layers of every ring keep their volume.
        """
        _, radius = cell_centres(self.shape)
        area_ratio = before.ring_area(radius) / after.ring_area(radius)
        layers = {name: m for name, m in self.present().items() if name.endswith("_depth")}
        return self.replace(**{name: m * area_ratio for name, m in layers.items()})

    def abl_scale(self, iris: Iris) -> Texture | None:
        """Melanin of the ABL relative to that of a uniform iris; `None` if it is one everywhere."""
        scale = None if self.abl_depth is None else self.abl_depth / iris.abl_thickness
        if self.freckles is not None:
            freckle_scale = 1 + (FRECKLE - 1) * self.freckles
            scale = freckle_scale if scale is None else scale * freckle_scale
        return scale

    def stroma_scale(self, iris: Iris) -> Texture | None:
        """Thickness of the stroma relative to a uniform iris; `None` if it is one everywhere."""
        return None if self.stroma_depth is None else self.stroma_depth / iris.stroma_thickness

    def check(self, iris: Iris) -> None:
        """Raise `ValueError` where a layer with a map of its thickness has none in the iris."""
        for layer in ("abl", "stroma"):
            thickness = getattr(iris, f"{layer}_thickness")
            has_map = getattr(self, f"{layer}_depth") is not None
            if has_map and is_known(thickness) and not np.asarray(thickness).all():
                raise ValueError(
                    f"{layer}_thickness = 0 mm leaves no concentrations for the map "
                    f"{layer}_depth to keep"
                )


class Scales(NamedTuple):
    """Textures relative to the uniform iris; `None` is one everywhere.

    Melanin of the ABL, thickness of the stroma, and concentrations of eumelanin and pheomelanin.
    """

    abl: Any = None
    stroma: Any = None
    eumelanin: Any = None
    pheomelanin: Any = None

    @classmethod
    def of(cls, maps: IrisMaps | None, iris: Iris) -> "Scales":
        """Make the scales of some maps."""
        if maps is None:
            return cls()
        return cls(maps.abl_scale(iris), maps.stroma_scale(iris), maps.eumelanin, maps.pheomelanin)

    def ranges(self) -> "Scales":
        """Return each texture's range for nodes, slightly widened and without gradients."""

        def span(t):
            return jax.lax.stop_gradient(jnp.stack([0.95 * jnp.min(t), 1.05 * jnp.max(t) + 1e-3]))

        return Scales(*(None if t is None else span(t) for t in self))


def cell_centres(shape: tuple[int, int]) -> tuple[jax.Array, jax.Array]:
    """Return angles (radians) and relative radii of a texture's cells, (angles,) and (radii,)."""
    row, column = (jnp.arange(count, dtype=float) + 0.5 for count in shape)
    return row * (2 * jnp.pi / shape[0]), column / shape[1]


def texels(size: int, dtype: DTypeLike = float) -> Sequence[np.ndarray]:
    """Return x of the columns and y of the rows of a square picture of the iris, relative to half
    its side; the top row has the largest y.
    """
    line = ((2 * np.arange(size) + 1) / size - 1).astype(dtype)
    return np.meshgrid(line, -line, sparse=True)


def texel_places(size: int, reach: Scalar, dtype: DTypeLike) -> tuple[jax.Array, jax.Array]:
    """Return x and y of the texels of such a picture, (size, size) each, for half a side of
    `reach` mm.
    """
    x, y = jnp.broadcast_arrays(*(v * reach for v in texels(size, dtype)))
    return x, y


def check_pictured(iris: Iris) -> None:
    """Check that an iris can be drawn.

    Raises:
        ValueError: For a power law of scattering, and for a pigment epithelium that lets light
            through, which pictures do not support.
    """
    if iris.ipe_melanin is not None:
        raise ValueError(
            "a picture has nothing behind the iris, whose pigment epithelium is black: leave out "
            "ipe_melanin"
        )
    if iris.power_law is not None:
        raise ValueError(
            "a picture needs the iris's formula of scattering (lb06, rayleigh-spheres), not a "
            "power law"
        )


def texel_layers(
    iris: Iris, aqueous_index: Scalar | float, table: Extinction, scales: Scales
) -> Layers:
    """Compute the layers of one texel, whose scales are numbers or `None`."""
    if scales.eumelanin is not None:
        iris = eqx.tree_at(lambda i: i.eumelanin, iris, iris.eumelanin * scales.eumelanin)
    if scales.pheomelanin is not None:
        iris = eqx.tree_at(lambda i: i.pheomelanin, iris, iris.pheomelanin * scales.pheomelanin)
    check_pictured(iris)
    layers = iris.layers(table, aqueous_index)
    abl = 1.0 if scales.abl is None else scales.abl
    stroma = 1.0 if scales.stroma is None else scales.stroma
    return dataclasses.replace(
        layers,
        abl_absorption=layers.abl_absorption * abl,
        stroma_absorption=layers.stroma_absorption * stroma,
        stroma_scattering=layers.stroma_scattering * stroma,
    )
