"""The pages of docs/api hold every name that `import irisjax as ij` offers."""

import re
from pathlib import Path

import irisjax as ij

DOCS = Path(__file__).parent.parent / "docs"


def test_every_public_name_has_an_entry():
    pages = "\n".join(p.read_text(encoding="utf-8") for p in sorted((DOCS / "api").glob("*.md")))
    entries = re.findall(r"^::: irisjax\.(\S+)", pages, flags=re.M)
    assert len(entries) == len(set(entries)), "an object has two entries"
    missing = ij._HOME.keys() - set(entries)
    assert missing == set()
    overview = (DOCS / "api.md").read_text(encoding="utf-8")
    assert [name for name in ij._HOME if f"`{name}`" not in overview] == []
