"""`Bench`: a painted eye whose coats are switched, recoloured and reordered. A coat that changes is
painted again with those below it, and no other.
"""

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from irisjax.io.recipes import Recipe, recipe_text
from irisjax.io.tables import write_atomically
from irisjax.measure.colour import srgb_encode
from irisjax.ocularist.coats import Coat, Painting
from irisjax.ocularist.integrator import PaintBase, Painted, PaintedLayer
from irisjax.ocularist.mixing import linear_colour
from irisjax.ocularist.painting import OPACITY_SIZE, painted, studio
from irisjax.ocularist.recipes import CoatRecipe
from irisjax.render.illumination import Illumination
from irisjax.render.integrator import AbstractResponse
from irisjax.render.picture import LitView, respond, shade, surroundings, texture
from irisjax.render.project import IrisPixels
from irisjax.render.scene import Scene
from irisjax.view.layers import Layer, Layers, place_of
from irisjax.view.session import KeptValue, Session, Values, encoded
from irisjax.view.settings import CAMERA, LIGHT, CommonSettings, values_of

NAME = "recipe"
"""Of files that keep recipes, before a number and `.toml`."""


@dataclasses.dataclass(frozen=True)
class BenchSettings(CommonSettings):
    """What can be changed of a painted eye.

    Attributes:
        layers: Its coats, the bottom one first.
    """

    layers: Layers = ()


class _PaintedValues(Values):
    """Values of pictures of one size, and the layers of paint on one base."""

    def __init__(self) -> None:
        super().__init__()
        self.surroundings = KeptValue[Array]()
        self.base = KeptValue[tuple[PaintBase, list[PaintedLayer]]]()


class Bench(Session[BenchSettings]):
    """A recipe, its settings, and what is already painted of them.

    Attributes:
        settings: Current settings.
    """

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
        self._profile = painting.profile
        self._full = {coat.name: coat for coat in painting.coats}
        # Coats bear their places in the recipe, whose order need not be that of heights.
        places = {coat.name: int(coat.name.split()[0]) - 1 for coat in painting.coats}
        self._recipes: dict[str, CoatRecipe] = {n: recipe.coats[i] for n, i in places.items()}
        self._coats: dict[str, tuple[Layer, Coat]] = {}
        self._heights = {r.height: self._full[n].height for n, r in self._recipes.items()}
        super().__init__(scene(studio(painting, eye)), tables_of)
        self._values = {draft: _PaintedValues() for draft in (False, True)}
        self._response = KeptValue[AbstractResponse]()
        self._file: Path | None = None
        layers = tuple(
            Layer(name, True, None, r.opacity, r.height) for name, r in self._recipes.items()
        )
        self.settings = BenchSettings(**self._start(), layers=layers)

    def update(self, *, draft: bool = False, **changes: Any) -> np.ndarray:
        """See `Session.update`."""
        settings, kept = self._changed(changes), self._values[draft]
        picture = kept.picture.of(settings, lambda: self._drawn(kept, settings, draft))
        self.settings = settings
        return picture

    def scene(self) -> Scene:
        """The scene as it is set; `exposure` is no part of it."""
        return self._set(self.settings, False)

    def painting(self) -> Painting:
        """Coats that are on, the bottom one first."""
        return self._painting(self.settings.layers)

    def colour(self, name: str) -> tuple[int, int, int]:
        """A coat's colour as it is set, sRGB, 8 bits.

        Raises:
            ValueError: There is no such coat.
        """
        layer = self.settings.layers[place_of(self.settings.layers, name)]
        return _shown(self._coat(layer))

    def mixed(self, name: str) -> tuple[int, int, int]:
        """The colour that a coat's paints make, whatever is set; as `colour`."""
        return _shown(self._full[self.settings.layers[place_of(self.settings.layers, name)].name])

    def recipe(self, layers: Layers | None = None) -> Recipe:
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
                paint = _free(f"picked {layer.name.split()[0]}", palette)
                palette[paint] = layer.colour
                coat = coat._replace(first=paint, second=paint, share=0.0)
            coats.append(coat)
        if not coats:
            raise ValueError("no coat is on: there is nothing to save")
        return self._given._replace(coats=tuple(coats), palette=palette)

    def save(self, layers: Layers | None = None) -> Path:
        """Write `recipe` beside the recipe that was given, where the files it names are found:
        first as a new file, then over that file.

        Raises:
            ValueError: Every coat is off.
            OSError: The file cannot be written.
        """
        text = recipe_text(self.recipe(layers))
        path = self._file or _new(self._given.folder)
        write_atomically(path, text.encode())
        self._file = path
        return path

    def _drawn(self, kept: _PaintedValues, s: BenchSettings, draft: bool) -> np.ndarray:
        scene = self._set(s, draft)
        view = self._view(kept, s, scene)
        surfaces = *values_of(s, CAMERA), s.environment, s.strength
        texels = kept.texels.of(surfaces, lambda: texture(view, scene))
        tables = self._tables_for(s, scene)
        lit = surfaces, values_of(s, LIGHT)
        around = kept.surroundings.of(lit, lambda: surroundings(view, texels, scene))
        response = self._response.of(None, lambda: respond(scene))
        radiance = None
        if view.iris is not None:
            radiance = self._radiance(kept, lit, view.iris, scene, tables)
        light = LitView(around, radiance)
        return encoded(shade(view, texels, light, response), s.exposure)

    def _radiance(
        self,
        kept: _PaintedValues,
        lit: Any,
        pixels: IrisPixels,
        scene: Scene,
        tables: Illumination | None,
    ) -> Array:
        """Radiance of the paint: only coats that have changed and those below are painted."""
        painted = scene.integrator
        assert isinstance(painted, Painted)
        parts = pixels, scene.all_lights(), scene.eye, tables
        base, layers = kept.base.of(lit, lambda: (painted.base(*parts), []))
        layers[:] = painted.layers(base, tuple(layers))
        return (layers[-1].state if layers else base.state).radiance

    def _set(self, s: BenchSettings, draft: bool) -> Scene:
        integrator = Painted(painting=self._painting(s.layers))
        parts = self._parts(s, self._size(draft))
        return self._base.replace(integrator=integrator, **parts)

    def _painting(self, layers: Layers) -> Painting:
        on = tuple(self._coat(layer) for layer in layers if layer.on)
        return Painting(on, self._profile)

    def _coat(self, layer: Layer) -> Coat:
        """A coat, with the same arrays where nothing has changed: by these it is recognised."""
        last = self._coats.get(layer.name)
        if last is not None and last[0] == layer:
            return last[1]
        full = self._full[layer.name]
        if last is not None and last[0].opacity == layer.opacity:
            opacity = last[1].opacity
        else:
            opacity = layer.opacity * full.opacity
        if last is not None and last[0].colour == layer.colour:
            colour = last[1].colour
        elif layer.colour is None:
            colour = full.colour
        else:
            colour = jnp.asarray(linear_colour(layer.name, layer.colour), full.colour.dtype)
        made = Coat(layer.name, opacity, colour, self._heights[layer.height])
        self._coats[layer.name] = layer, made
        return made


def _shown(coat: Coat) -> tuple[int, int, int]:
    red, green, blue = np.rint(255 * np.asarray(srgb_encode(coat.colour)))
    return int(red), int(green), int(blue)


def _free(name: str, palette: dict[str, str]) -> str:
    """A name that no paint of the palette has."""
    found, number = name, 2
    while found in palette:
        found, number = f"{name} ({number})", number + 1
    return found


def _new(folder: Path) -> Path:
    path, number = folder / f"{NAME}.toml", 2
    while path.exists():
        path, number = folder / f"{NAME}_{number}.toml", number + 1
    return path
