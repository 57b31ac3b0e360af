"""`Bench`: a painted eye whose coats are switched, recoloured and reordered. A coat that changes is
painted again with those below it, and no other.
"""

import dataclasses
import itertools
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from irisjax.io.recipes import Recipe, recipe_text
from irisjax.io.tables import write_atomically
from irisjax.measure.colour import srgb_encode
from irisjax.numerics.checks import check_range
from irisjax.ocularist.coats import OPACITY, Coat, Painting
from irisjax.ocularist.integrator import Painted
from irisjax.ocularist.mixing import linear_colour
from irisjax.ocularist.painting import OPACITY_SIZE, painted, studio
from irisjax.render.illumination import Illumination
from irisjax.render.scene import Scene
from irisjax.view.session import CommonSettings, KeptShare, KeptValue, Session


class Layer(NamedTuple):
    """A coat as it is set.

    Attributes:
        name: Its name in the `Painting`.
        on: Whether it is painted.
        colour: Colour picked by hand, `#rrggbb`; `None` for its recipe's mixture of paints.
        opacity: Factor on the map of its component, 0 to 1.
        height: Height above the base, mm.
    """

    name: str
    on: bool
    colour: str | None
    opacity: float
    height: float


LayerStack = tuple[Layer, ...]
"""The bottom coat first."""


@dataclasses.dataclass(frozen=True)
class BenchSettings(CommonSettings):
    """Settings of a painted eye.

    Attributes:
        layers: Its coats, the bottom one first.
    """

    layers: LayerStack = ()


class Bench(Session[BenchSettings]):
    """A recipe, its settings, and what is already painted of them."""

    def __init__(
        self,
        recipe: Recipe,
        scene: Callable[[Scene], Scene] = lambda scene: scene,
        tables_of: Callable[[Scene], Illumination | None] = Scene.tables,
        texels: int = OPACITY_SIZE,
    ):
        """Paint a recipe.

        Args:
            recipe: The recipe.
            scene: Changes the scene in which the iris stands, by default `painting.studio`; its own
                painting makes no difference.
            tables_of: Computes the illumination tables of a scene, or reads them.
            texels: Along a side of opacity maps.

        Raises:
            ValueError: A coat cannot be painted; the message names it.
        """
        self._given = recipe
        eye = recipe.eye()
        whole = [coat._replace(opacity=1.0) for coat in recipe.coats]
        painting = painted(whole, recipe.mixer(), eye, size=texels, scans=recipe.scans())
        super().__init__(scene(studio(painting, eye)), tables_of)
        self._profile = painting.profile
        self._full = {coat.name: coat for coat in painting.coats}
        # Coats bear their places in the recipe, whose order need not be that of heights.
        self._recipes = {n: recipe.coats[int(n.split()[0]) - 1] for n in self._full}
        self._heights = {r.height: self._full[n].height for n, r in self._recipes.items()}
        self._kept_coats = {n: [KeptValue[Any]() for _ in range(3)] for n in self._full}
        self._file: Path | None = None
        layers = (Layer(n, True, None, r.opacity, r.height) for n, r in self._recipes.items())
        self.settings: BenchSettings = BenchSettings(**self._start(), layers=tuple(layers))

    def colour(self, name: str, mixed: bool = False) -> tuple[int, int, int]:
        """A coat's colour as it is set, or that its paints make (`mixed`), sRGB, 8 bits.

        Raises:
            ValueError: There is no such coat.
        """
        layer = self.settings.layers[_place(self.settings.layers, name)]
        coat = self._full[name] if mixed else self._coat(layer)
        red, green, blue = np.rint(255 * np.asarray(srgb_encode(coat.colour)))
        return int(red), int(green), int(blue)

    def recipe(self, layers: LayerStack | None = None) -> Recipe:
        """The recipe of the coats that are on, by default those set, as `irisjax paint` takes it. A
        colour picked by hand becomes a paint of the palette.

        Raises:
            ValueError: Every coat is off.
        """
        palette, coats = dict(self._given.palette), []
        for layer in self.settings.layers if layers is None else layers:
            if not layer.on:
                continue
            coat = self._recipes[layer.name]._replace(opacity=layer.opacity, height=layer.height)
            if layer.colour is not None:
                paint = f"picked {layer.name.split()[0]}"
                paint = _free(palette.__contains__, paint, f"{paint} ({{}})")
                palette[paint] = layer.colour
                coat = coat._replace(first=paint, second=paint, share=0.0)
            coats.append(coat)
        if not coats:
            raise ValueError("no coat is on: there is nothing to save")
        return self._given._replace(coats=tuple(coats), palette=palette)

    def save(self, layers: LayerStack | None = None) -> Path:
        """Write `recipe` beside the recipe that was given, where the files it names are found:
        first as a new file, then over that file.

        Raises:
            ValueError: Every coat is off.
            OSError: The file cannot be written.
        """
        text, folder = recipe_text(self.recipe(layers)), self._given.folder
        path = self._file
        if path is None:
            path = folder / _free(
                lambda name: (folder / name).exists(), "recipe.toml", "recipe_{}.toml"
            )
        write_atomically(path, text.encode())
        self._file = path
        return path

    def _light(self, kept: KeptShare, lit: object, view, texels, scene, tables, model) -> Any:
        """Only coats that have changed and those below are painted."""
        painted = scene.integrator
        assert isinstance(painted, Painted)
        if view.iris is None:
            return None
        parts = scene.all_lights(), scene.eye, tables
        base, steps = kept.light.of(lit, lambda: (painted.base(view.iris, *parts), {}))
        return painted.paint(base, steps)

    def _set(self, s: BenchSettings, size: tuple[int, int]) -> Scene:
        on = tuple(self._coat(layer) for layer in s.layers if layer.on)
        integrator = Painted(painting=Painting(on, self._profile))
        return self._base.replace(integrator=integrator, **self._parts(s, size))

    def _coat(self, layer: Layer) -> Coat:
        """A coat, with the same arrays where nothing has changed: by these it is recognised."""
        name, full = layer.name, self._full[layer.name]
        whole, opacity, colour = self._kept_coats[name]

        def picked():
            if layer.colour is None:
                return full.colour
            return jnp.asarray(linear_colour(name, layer.colour), full.colour.dtype)

        def made():
            covering = opacity.of(layer.opacity, lambda: layer.opacity * full.opacity)
            paint = colour.of(layer.colour, picked)
            return Coat(name, covering, paint, self._heights[layer.height])

        return whole.of(layer, made)


def edited(layers: LayerStack, name: str, **fields: Any) -> LayerStack:
    """Change some fields of a coat.

    Raises:
        ValueError: There is no such coat, or a colour or an opacity is none.
    """
    at = _place(layers, name)
    if fields.get("colour") is not None:
        linear_colour(f"of coat {name}", fields["colour"])
    check_range(f"opacity of coat {name!r}", fields.get("opacity"), OPACITY)
    return (*layers[:at], layers[at]._replace(**fields), *layers[at + 1 :])


def moved(layers: LayerStack, name: str, up: bool) -> LayerStack:
    """Exchange a coat with the next above, or below it, in place and height; a coat at the end
    does not move.
    """
    at = _place(layers, name)
    low, high = (at, at + 1) if up else (at - 1, at)
    if low < 0 or high == len(layers):
        return layers
    below, above = layers[low], layers[high]
    pair = above._replace(height=below.height), below._replace(height=above.height)
    return layers[:low] + pair + layers[high + 1 :]


def _place(layers: LayerStack, name: str) -> int:
    """Place of a coat, from 0 at the bottom; a `ValueError` where there is none."""
    names = [layer.name for layer in layers]
    if name not in names:
        raise ValueError(f"no coat {name!r}; there are {', '.join(names)}")
    return names.index(name)


def _free(taken: Callable[[str], bool], first: str, further: str) -> str:
    """The first name, or one with a number from 2, that is not taken."""
    names = itertools.chain([first], map(further.format, itertools.count(2)))
    return next(name for name in names if not taken(name))
