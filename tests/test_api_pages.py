"""The pages of docs/api hold every name that `import irisjax as ij` offers."""

import re
from pathlib import Path
from types import ModuleType

import irisjax as ij

_NAMES = {name for name in ij.__all__ if not isinstance(getattr(ij, name), ModuleType)}
DOCS = Path(__file__).parent.parent / "docs"


def test_every_public_name_has_an_entry():
    pages = "\n".join(p.read_text(encoding="utf-8") for p in sorted((DOCS / "api").glob("*.md")))
    entries = re.findall(r"^::: irisjax\.(\S+)", pages, flags=re.M)
    assert len(entries) == len(set(entries)), "an object has two entries"
    missing = _NAMES - set(entries)
    assert missing == set()
    overview = (DOCS / "api.md").read_text(encoding="utf-8")
    assert [name for name in sorted(_NAMES) if f"`{name}`" not in overview] == []
