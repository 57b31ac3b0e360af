"""Recipes of painted eyes: TOML files that list coats in order, the bottom one first."""

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import tomlkit

from irisjax.anatomy.eye import LIMITS, Eye
from irisjax.io.images import read_image
from irisjax.io.paints import read_paints
from irisjax.io.sections import Check, Keys, checked, one_of, text, whole, within
from irisjax.io.text import read_text
from irisjax.numerics.checks import Range
from irisjax.ocularist.coats import HEIGHT, prosthesis
from irisjax.ocularist.components import COMPONENTS
from irisjax.ocularist.easel import SCAN
from irisjax.ocularist.kubelka_munk import KubelkaMunkMixer
from irisjax.ocularist.mixing import AbstractMixer, HslMixer
from irisjax.ocularist.palette import linear_colour
from irisjax.ocularist.recipes import CoatRecipe

MIXING = ("hsl", "kubelka-munk")
"""Ways to mix paints."""
PUPIL = 1.9
"""Radius of a painted eye's pupil by default, mm."""
_HSL, _KUBELKA_MUNK = MIXING


class Recipe(NamedTuple):
    """A painted eye as its file has it.

    - `coats`: the bottom one first. `mixing`: one of `MIXING`; `paints`: a file of absorption and
        scattering, for Kubelka and Munk's mixing and no other. `palette`: paints added or replaced,
        `#rrggbb` by name. `pupil_radius`: mm. `folder`: against which files are named.
    """

    coats: tuple[CoatRecipe, ...]
    mixing: str = _HSL
    paints: str | None = None
    palette: Mapping[str, str] = {}
    pupil_radius: float = PUPIL
    folder: Path = Path()

    def eye(self) -> Eye:
        """The paper's eye with this pupil."""
        return prosthesis(self.pupil_radius)

    def mixer(self) -> AbstractMixer:
        """Of the paints; **raises** `ValueError` or `OSError` for a file that cannot be read, and
        `ValueError` for one that this mixing has no use for.
        """
        mixer: AbstractMixer
        if self.mixing == _HSL:
            if self.paints is not None:
                raise ValueError(_NO_USE)
            mixer = HslMixer()
        elif self.paints is not None:
            mixer = read_paints(self.folder / self.paints)
        else:
            mixer = KubelkaMunkMixer.default()
        return mixer.with_paints(self.palette) if self.palette else mixer

    def scans(self) -> dict[str, np.ndarray]:
        """Pictures of the coats that are scans, by the names of their files."""
        return {f: read_image(self.folder / f).pixels for f in sorted(self.scan_files())}

    def scan_files(self) -> set[str]:
        """Names of these files, as the recipe has them; what is no name is left to `painted`."""
        files = (c.parameters.get("file") for c in self.coats if c.component == SCAN)
        return {f for f in files if isinstance(f, str) and f}

    def moved(self, folder: Path) -> "Recipe":
        """The same with its files named as they are found from another folder."""

        def seen(file):
            if not isinstance(file, str) or Path(file).is_absolute():
                return file
            return Path(os.path.relpath(self.folder / file, folder)).as_posix()

        coats = tuple(
            c._replace(parameters={**c.parameters, "file": seen(c.parameters["file"])})
            if c.component == SCAN and "file" in c.parameters
            else c
            for c in self.coats
        )
        return self._replace(coats=coats, paints=seen(self.paints), folder=folder)


def read_recipe(path: str | Path) -> Recipe:
    """Read and check a recipe. A coat without a height has that of the coat before it, 0 mm the
    first one.

    Raises:
        ValueError: naming file, line, what is wrong and what is allowed.
        OSError: for a file that cannot be opened.
    """
    path = Path(path)
    sections, where = checked(read_text(path), str(path), _SECTIONS, "coat")
    given = sections.get("coat")
    if not given:
        raise ValueError(f"{path}: no coats; write [[coat]] for each, the bottom one first")
    for nth, table in enumerate(given):
        for key in ("component", "paints"):
            if key not in table:
                raise ValueError(f"{where('coat', None, nth)}: coat needs {key}")
    head = sections.get("painting", {})
    if "paints" in head and head.setdefault("mixing", _KUBELKA_MUNK) == _HSL:
        raise ValueError(f"{where('painting', 'mixing')}: {_NO_USE}")
    return Recipe(_coats(given), **head, palette=sections.get("palette", {}), folder=path.parent)


def recipe_text(recipe: Recipe) -> str:
    """A recipe as `read_recipe` reads it, every number to its last digit."""
    document = tomlkit.document()
    document.add(
        tomlkit.comment("A painted eye for `irisjax paint`: coats in order, the bottom one first.")
    )
    document["painting"] = {"mixing": recipe.mixing, "pupil_radius": recipe.pupil_radius}
    if recipe.paints is not None:
        document["painting"]["paints"] = recipe.paints
    if recipe.palette:
        document["palette"] = dict(recipe.palette)
    coats = tomlkit.aot()
    for coat in recipe.coats:
        table = tomlkit.table()
        table["component"] = coat.component
        if coat.parameters:
            table["parameters"] = tomlkit.inline_table()
            table["parameters"].update(coat.parameters)
        table["paints"] = [coat.first, coat.second]
        for name in ("share", "opacity", "seed", "height"):
            table[name] = getattr(coat, name)
        coats.append(table)
    document["coat"] = coats
    return tomlkit.dumps(document)


def _coats(tables: Sequence[Mapping[str, Any]]) -> tuple[CoatRecipe, ...]:
    usual = {"parameters": {}, "share": 0.0, "opacity": 1.0, "seed": 0, "height": 0.0}
    coats: list[CoatRecipe] = []
    for table in tables:
        first, second = table["paints"]
        given = {key: value for key, value in table.items() if key != "paints"}
        coats.append(CoatRecipe(**(usual | given), first=first, second=second))
        # On the coat before it: at the base's height one that is added at the end of a recipe
        # would lie below all others and not be seen.
        usual["height"] = coats[-1].height
    return tuple(coats)


def _colour(name: str) -> Check:
    def check(value):
        linear_colour(name, value)
        return value

    return check


def _parameters(value):
    if not isinstance(value, dict):
        raise ValueError("must be a table, { name = value }")
    return value


def _pair(value):
    names = [value] if isinstance(value, str) else value
    known = isinstance(names, Sequence) and all(isinstance(n, str) for n in names)
    if not known or len(names) not in (1, 2):
        raise ValueError("must be one or two names of paints")
    return names[0], names[-1]


_NO_USE = f'a file of paints is for mixing = "{_KUBELKA_MUNK}"; {_HSL} mixes colours alone'
_SHARE = Range(0.0, 1.0)
_SECTIONS: dict[str, Keys] = {
    "painting": {
        "mixing": one_of(*MIXING),
        "paints": text,
        "pupil_radius": within(LIMITS["pupil_radius"]),
    },
    "palette": _colour,
    "coat": {
        "component": one_of(*COMPONENTS, SCAN),
        "parameters": _parameters,
        "paints": _pair,
        "share": within(_SHARE),
        "opacity": within(_SHARE),
        "seed": whole(0, 2**32 - 1),
        "height": within(HEIGHT),
    },
}
