"""Recipes of painted eyes: TOML files that list coats in order, the bottom one first."""

import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from irisjax.anatomy.eye import LIMITS, Eye
from irisjax.io.entries import line_of, one_of, text, whole, within
from irisjax.io.images import read_image
from irisjax.io.paints import read_paints
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
_SHARE = Range(0.0, 1.0)
_SECTIONS = {
    "painting": ("mixing", "paints", "pupil_radius"),
    "palette": None,
    "coat": ("component", "parameters", "paints", "share", "opacity", "seed", "height"),
}


class Recipe(NamedTuple):
    """A painted eye as its file has it.

    - `coats`: the bottom one first. `mixing`: one of `MIXING`; `paints`: a file of absorption and
        scattering, for Kubelka and Munk's mixing. `palette`: paints added or replaced, `#rrggbb` by
        name. `pupil_radius`: mm. `folder`: against which files are named.
    """

    coats: tuple[CoatRecipe, ...]
    mixing: str = "hsl"
    paints: str | None = None
    palette: Mapping[str, str] = {}
    pupil_radius: float = 1.9
    folder: Path = Path()

    def eye(self) -> Eye:
        """The paper's eye with this pupil."""
        return prosthesis(self.pupil_radius)

    def mixer(self) -> AbstractMixer:
        """Of the paints; **raises** `ValueError` or `OSError` for a file that cannot be read."""
        if self.paints is not None:
            mixer: AbstractMixer = read_paints(self.folder / self.paints)
        else:
            mixer = HslMixer() if self.mixing == "hsl" else KubelkaMunkMixer.default()
        return mixer.with_paints(self.palette) if self.palette else mixer

    def scans(self) -> dict[str, np.ndarray]:
        """Pictures of the coats that are scans, by the names of their files."""
        files = {c.parameters.get("file") for c in self.coats if c.component == SCAN}
        return {f: read_image(self.folder / f).pixels for f in files if isinstance(f, str)}


def read_recipe(path: str | Path) -> Recipe:
    """Read and check a recipe.

    Raises:
        ValueError: naming file, line, what is wrong and what is allowed.
        OSError: for a file that cannot be opened.
    """
    path = Path(path)
    written = read_text(path)
    try:
        sections = tomllib.loads(written)
    except tomllib.TOMLDecodeError as error:
        raise ValueError(f"{path}: {error}") from None

    def refuse(section: str, key: str | None, nth: int, what: str) -> ValueError:
        line = line_of(written, section, key, nth)
        return ValueError(f"{path}{'' if line is None else f', line {line}'}: {what}")

    for name, section in sections.items():
        if name not in _SECTIONS:
            known = ", ".join(_SECTIONS)
            raise refuse(name, None, 0, f"unknown section {name!r}; known: {known}")
        wanted = list if name == "coat" else dict
        if not isinstance(section, wanted) or not all(
            isinstance(s, dict) for s in (section if wanted is list else ())
        ):
            form = "[[coat]]" if name == "coat" else f"[{name}]"
            raise refuse(name, None, 0, f"{name} must be written {form}")
        known = _SECTIONS[name]
        for nth, table in enumerate(section if wanted is list else [section]):
            for key in table:
                if known is not None and key not in known:
                    what = f"unknown {key!r} in {name}; known: {', '.join(known)}"
                    raise refuse(name, key, nth, what)

    def take(section: str, table: Mapping[str, Any], key: str, check, default, nth: int = 0):
        if key not in table:
            if default is None:
                raise refuse(section, None, nth, f"{section} needs {key}")
            return default
        try:
            return check(table[key])
        except ValueError as error:
            raise refuse(section, key, nth, f"{section}.{key} = {table[key]!r} {error}") from None

    head = sections.get("painting", {})
    given = sections.get("coat", [])
    if not given:
        raise ValueError(f"{path}: no coats; write [[coat]] for each, the bottom one first")
    coats = tuple(
        _coat(lambda key, check, default, t=table, n=nth: take("coat", t, key, check, default, n))
        for nth, table in enumerate(given)
    )
    palette = sections.get("palette", {})
    return Recipe(
        coats,
        take("painting", head, "mixing", one_of(*MIXING), "hsl"),
        take("painting", head, "paints", text, "") or None,
        {n: take("palette", palette, n, _colour(n), None) for n in palette},
        take("painting", head, "pupil_radius", within(LIMITS["pupil_radius"]), 1.9),
        path.parent,
    )


def recipe_text(recipe: Recipe) -> str:
    """A recipe as `read_recipe` reads it."""
    lines = ["# A painted eye for `irisjax paint`: coats in order, the bottom one first.", ""]
    lines += ["[painting]", f'mixing = "{recipe.mixing}"']
    if recipe.paints is not None:
        lines.append(f"paints = {_quoted(recipe.paints)}")
    lines.append(f"pupil_radius = {recipe.pupil_radius:g}")
    if recipe.palette:
        lines += ["", "[palette]"]
        lines += [f"{_quoted(n)} = {_quoted(c)}" for n, c in recipe.palette.items()]
    for coat in recipe.coats:
        lines += ["", "[[coat]]", f"component = {_quoted(coat.component)}"]
        if coat.parameters:
            inside = ", ".join(f"{k} = {_plain(v)}" for k, v in coat.parameters.items())
            lines.append(f"parameters = {{ {inside} }}")
        lines.append(f"paints = [{_quoted(coat.first)}, {_quoted(coat.second)}]")
        lines.append(f"share = {coat.share:.6g}")
        lines.append(f"opacity = {coat.opacity:.6g}")
        lines.append(f"seed = {coat.seed}")
        lines.append(f"height = {coat.height:.6g}")
    return "\n".join(lines) + "\n"


def _coat(take) -> CoatRecipe:
    parameters = take("parameters", _table, {})
    first, second = take("paints", _pair, None)
    return CoatRecipe(
        take("component", one_of(*COMPONENTS, SCAN), None),
        parameters,
        first,
        second,
        take("share", within(_SHARE), 0.0),
        take("opacity", within(_SHARE), 1.0),
        take("seed", whole(0, 2**32 - 1), 0),
        take("height", within(HEIGHT), 0.0),
    )


def _colour(name: str):
    def check(value):
        linear_colour(name, value)
        return value

    return check


def _table(value):
    if not isinstance(value, dict):
        raise ValueError("must be a table, { name = value }")
    return value


def _pair(value):
    names = [value] if isinstance(value, str) else value
    known = isinstance(names, Sequence) and all(isinstance(n, str) for n in names)
    if not known or len(names) not in (1, 2):
        raise ValueError("must be one or two names of paints")
    return names[0], names[-1]


def _quoted(text: str) -> str:
    escaped = text.replace("\\", "\\\\").replace('"', '\\"')
    return f'"{escaped}"'


def _plain(value: Any) -> str:
    return (
        _quoted(value)
        if isinstance(value, str)
        else f"{value:g}"
        if isinstance(value, float)
        else str(value).lower()
    )
