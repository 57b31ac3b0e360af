"""The pages of docs/api have an entry for every public name, and no other entries."""

import ast
import re
from pathlib import Path

ROOT = Path(__file__).parent.parent
PACKAGE, DOCS = ROOT / "irisjax", ROOT / "docs"
PRIVATE = {"cli", "numerics"}


def _imported(package):
    """Return the names that a package imports from its modules, in its stub if it has one."""
    stub = package / "__init__.pyi"
    source = stub if stub.is_file() else package / "__init__.py"
    body = ast.parse(source.read_text(encoding="utf-8")).body
    found = [n for n in body if isinstance(n, ast.ImportFrom)]
    own = [n for n in found if n.module and (n.level or n.module.startswith("irisjax."))]
    return {alias.asname or alias.name for n in own for alias in n.names}


def test_every_public_name_has_an_entry_and_no_other():
    top = _imported(PACKAGE)
    public = set(top)
    for package in (p for p in PACKAGE.iterdir() if (p / "__init__.py").is_file()):
        if package.name not in PRIVATE:
            public |= {f"{package.name}.{name}" for name in _imported(package) - top}
    pages = "\n".join(p.read_text(encoding="utf-8") for p in sorted((DOCS / "api").glob("*.md")))
    entries = re.findall(r"^::: irisjax\.(\S+)", pages, flags=re.M)
    assert len(entries) == len(set(entries)), "an object has two entries"
    assert set(entries) == public
    overview = (DOCS / "api.md").read_text(encoding="utf-8")
    assert [name for name in sorted(top) if f"`{name}`" not in overview] == []
