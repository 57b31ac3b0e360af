"""Recipes of painted eyes, TOML files of coats, and tables of a user's paints."""

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import tomlkit

from irisjax.anatomy.eye import EYE_LIMITS, Eye
from irisjax.io.images import read_image
from irisjax.io.sections import Keys, check_sections, toml_of
from irisjax.io.tables import naming
from irisjax.io.text import read_columns, read_text
from irisjax.numerics.checks import Range
from irisjax.ocularist.coats import HEIGHT, PUPIL_RADIUS, prosthesis
from irisjax.ocularist.components import COMPONENTS
from irisjax.ocularist.kubelka_munk import COEFFICIENT, KubelkaMunkMixer
from irisjax.ocularist.mixing import NO_COLOUR, AbstractMixer, HslMixer, linear_colour
from irisjax.ocularist.painting import SCAN
from irisjax.ocularist.recipes import CoatRecipe

MIXING = ("hsl", "kubelka-munk")
"""Ways to mix paints."""

_HSL, _KUBELKA_MUNK = MIXING
_WAVELENGTH = "wavelength_nm"  # name of the first column of a table of paints
_SURFACE = "saunderson"  # key of the header's line that gives k₁ and k₂


class Recipe(NamedTuple):
    """A painted eye as its file describes it: coats, the bottom one first, and the pupil (mm).

    Attributes:
        mixing: One of `MIXING`.
        paints: File of absorption and scattering, for Kubelka and Munk's mixing only.
        palette: Paints added or replaced, `#rrggbb` by name.
        folder: Folder that names of files are relative to.
    """

    coats: tuple[CoatRecipe, ...]
    mixing: str = _HSL
    paints: str | None = None
    palette: Mapping[str, str] = {}
    pupil_radius: float = PUPIL_RADIUS
    folder: Path = Path()

    def eye(self) -> Eye:
        """The paper's eye with the recipe's pupil."""
        return prosthesis(self.pupil_radius)

    def mixer(self) -> AbstractMixer:
        """The mixer of the paints, or `ValueError` for a file of paints that it does not use."""
        if self.mixing == _HSL and self.paints is not None:
            raise ValueError(_NO_USE)
        model = HslMixer if self.mixing == _HSL else KubelkaMunkMixer
        mixer = model.default() if self.paints is None else read_paints(self.folder / self.paints)
        return mixer.with_paints(self.palette) if self.palette else mixer

    def scans(self) -> dict[str, np.ndarray]:
        """Pictures of the coats that are scans, by the names of their files."""
        pictures: dict[str, np.ndarray] = {}
        for number, coat in enumerate(self.coats, 1):
            for file in self._replace(coats=(coat,)).scan_files() - pictures.keys():
                try:
                    pictures[file] = read_image(self.folder / file).pixels
                except (OSError, ValueError) as error:
                    path = self.folder / file
                    reason = f"{path}: {error.strerror}" if isinstance(error, OSError) else error
                    raise ValueError(f"coat {number} ({SCAN}): {reason}") from None
        return pictures

    def scan_files(self) -> set[str]:
        """Names of these files as in the recipe, without entries that are no names."""
        files = (c.parameters.get("file") for c in self.coats if c.component == SCAN)
        return {f for f in files if isinstance(f, str) and f}

    def moved(self, folder: Path) -> "Recipe":
        """The recipe with its files named relative to another folder."""

        def seen(file: Any) -> Any:
            if not isinstance(file, str) or Path(file).is_absolute():
                return file
            return Path(os.path.relpath(self.folder / file, folder)).as_posix()

        coats = list(self.coats)
        for i, (coat, given) in enumerate((coat, coat.parameters) for coat in self.coats):
            if coat.component == SCAN and "file" in given:
                coats[i] = coat._replace(parameters={**given, "file": seen(given["file"])})
        return self._replace(coats=tuple(coats), paints=seen(self.paints), folder=folder)


def read_recipe(path: str | Path) -> Recipe:
    """Read and check a recipe; a `ValueError` names file, line, what is wrong and what is allowed.
    A coat without a height has that of the coat before it, 0 mm the first one.
    """
    path = Path(path)
    sections, where = check_sections(read_text(path), str(path), _SECTIONS, "coat")
    tables = sections.get("coat")
    if not tables:
        raise ValueError(f"{path}: no coats; write [[coat]] for each, the bottom one first")
    for nth, table in enumerate(tables):
        if missing := [key for key in ("component", "paints") if key not in table]:
            raise ValueError(f"{where('coat', None, nth)}: coat needs {missing[0]}")
    painting = sections.get("painting", {})
    if "paints" in painting and painting.setdefault("mixing", _KUBELKA_MUNK) == _HSL:
        raise ValueError(f"{where('painting', 'mixing')}: {_NO_USE}")
    defaults: dict[str, Any] = dict(parameters={}, share=0.0, opacity=1.0, seed=0, height=0.0)
    coats = []
    for table in tables:
        first, second = table.pop("paints")
        coats.append(CoatRecipe(**(defaults | table), first=first, second=second))
        # That of the coat before: at the base's height, a coat added at the end of a recipe would
        # lie below all others and not be seen.
        defaults["height"] = coats[-1].height
    palette = sections.get("palette", {})
    return Recipe(tuple(coats), **painting, palette=palette, folder=path.parent)


def recipe_text(recipe: Recipe) -> str:
    """A recipe as the text of its file, every number to its last digit."""
    painting = {"mixing": recipe.mixing, "pupil_radius": recipe.pupil_radius}
    painting |= {} if recipe.paints is None else {"paints": recipe.paints}
    coats = tomlkit.aot()
    for coat in recipe.coats:
        table = tomlkit.table()
        table["component"] = coat.component
        if coat.parameters:
            table["parameters"] = tomlkit.inline_table()
            table["parameters"].update(coat.parameters)
        table["paints"] = [coat.first, coat.second]
        table.update({n: getattr(coat, n) for n in ("share", "opacity", "seed", "height")})
        coats.append(table)
    palette = {"palette": dict(recipe.palette)} if recipe.palette else {}
    text = toml_of({"painting": painting, **palette, "coat": coats})
    return f"# A painted eye for `irisjax paint`: coats in order, the bottom one first.\n\n{text}"


def read_paints(path: str | Path) -> KubelkaMunkMixer:
    """Read a mixer from a text table like the package's own `ocularist/tables/paints.csv`.

    The first column is `wavelength_nm`, increasing. Each paint has a column `PAINT_K` and one
    `PAINT_S`, absorption and scattering, in one unit for all paints. Separators and encodings are
    those of `irisjax.io.text`. A line `# saunderson: 0.04 0.6` gives k₁ and k₂ of the paints'
    surface where K and S exclude it. A `ValueError` names the file, the line and the problem.
    """
    with naming(path):
        table = read_columns(read_text(path))
        if table.names[0] != _WAVELENGTH:
            raise ValueError(f"the first column must be {_WAVELENGTH}, not {table.names[0]!r}")
        pairs = _paired_columns(table.names[1:])
        if not pairs:
            raise ValueError("no paint beside the wavelengths")
        for i, j in np.argwhere(~COEFFICIENT.holds(table.values))[:1]:
            message = f"{table.names[j]} = {table.values[i, j]:g} is outside {COEFFICIENT}"
            raise ValueError(f"{table.where[i]}: {message}")
        coefficients = table.values[:, 1:].T
        k, s = (coefficients[[pair[i] for pair in pairs.values()]] for i in (0, 1))
        for p, i in np.argwhere(k + s == 0)[:1]:
            raise ValueError(f"{table.where[i]}: K and S of {list(pairs)[p]} are both 0")
        surface, entry = None, table.header.get(_SURFACE)
        if entry is not None:
            try:
                outside, inside = map(float, entry.replace(",", " ").split())
            except ValueError:
                raise ValueError(f"{_SURFACE}: {entry!r} is not two numbers") from None
            surface = outside, inside
        return KubelkaMunkMixer(tuple(pairs), tuple(table.values[:, 0].tolist()), k, s, surface)


def _paired_columns(columns: Sequence[str]) -> dict[str, tuple[int, int]]:
    """Indices of the columns `PAINT_K` and `PAINT_S` of each paint, in the order of the K."""
    names = [column.strip() for column in columns]
    for name in names:
        if not name[:-2] or name[-2:] not in ("_K", "_S"):
            raise ValueError(f"column {name!r} is neither PAINT_K nor PAINT_S")
        if names.count(name) > 1:
            raise ValueError(f"column {name!r} appears twice")
        partner = name[:-1] + ("S" if name.endswith("K") else "K")
        if partner not in names:
            raise ValueError(f"column {name} has no {partner} beside it")
    paints = [name[:-2] for name in names if name.endswith("_K")]
    return {p: (names.index(f"{p}_K"), names.index(f"{p}_S")) for p in paints}


def _colour(value: Any) -> Any:
    try:
        linear_colour("", value)
    except ValueError:
        raise ValueError(NO_COLOUR) from None
    return value


def _pair(value: Any) -> tuple[str, str]:
    names = [value] if isinstance(value, str) else value
    valid = isinstance(names, Sequence) and all(isinstance(n, str) for n in names)
    if not valid or len(names) not in (1, 2):
        raise ValueError("must be one or two names of paints")
    return names[0], names[-1]


_NO_USE = f'a file of paints is for mixing = "{_KUBELKA_MUNK}"; {_HSL} mixes colours alone'
_SECTIONS: dict[str, Keys] = {
    "painting": {"mixing": MIXING, "paints": str, "pupil_radius": EYE_LIMITS["pupil_radius"]},
    "palette": lambda name: _colour,
    "coat": {
        "component": (*COMPONENTS, SCAN),
        "parameters": dict,
        "paints": _pair,
        "share": Range(0.0, 1.0),
        "opacity": Range(0.0, 1.0),
        "seed": range(2**32),
        "height": HEIGHT,
    },
}
