"""Texts beside this module, with blanks to fill in."""

from collections.abc import Collection, Mapping
from pathlib import Path
from string import Template


def filled(name: str, present: Collection[str], values: Mapping[str, str]) -> str:
    """A template with `values` for its `$NAME`; its lines that begin with `?NAME` are left out
    unless that name is `present`.
    """
    lines = []
    for line in Path(__file__).with_name(name).read_text(encoding="utf-8").splitlines():
        if line.startswith("?"):
            needed, _, line = line[1:].partition(" ")
            if needed not in present:
                continue
        lines.append(line)
    return Template("\n".join(lines) + "\n").substitute(values)
