"""Texts beside this module, with blanks to fill in."""

from collections.abc import Mapping
from pathlib import Path
from string import Template


def filled(name: str, values: Mapping[str, str | None]) -> str:
    """A template with `values` for its `$NAME`, without the lines that begin with the `?NAME` of
    a value that is absent.
    """
    lines = []
    for line in Path(__file__).with_name(name).read_text(encoding="utf-8").splitlines():
        if line.startswith("?"):
            needed, _, line = line[1:].partition(" ")
            if values.get(needed) is None:
                continue
        lines.append(line)
    return Template("\n".join(lines) + "\n").substitute(values)
