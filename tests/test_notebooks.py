"""The notebooks run from top to bottom, in their quick form, and keep small outputs."""

import os
from pathlib import Path

import pytest

NOTEBOOKS = sorted((Path(__file__).parent.parent / "experiments").glob("*.ipynb"))


@pytest.mark.peer
@pytest.mark.filterwarnings("ignore")  # Jupyter's own
@pytest.mark.parametrize(
    "path",
    # The same steps as in the first, once more: 20 s each.
    [pytest.param(p, marks=pytest.mark.slow) if p.stem != "one_eye" else p for p in NOTEBOOKS],
    ids=lambda p: p.stem,
)
def test_notebook(path, monkeypatch):
    import nbclient
    import nbformat

    monkeypatch.setenv("IRISJAX_QUICK", "1")
    monkeypatch.setenv("PYDEVD_DISABLE_FILE_VALIDATION", "1")
    monkeypatch.setenv("PYTHONPATH", f"{path.parent.parent}:{os.environ.get('PYTHONPATH', '')}")
    book = nbformat.read(path, as_version=4)
    # Kept outputs: a reader sees them without running anything.
    assert all(c.outputs for c in book.cells[2:] if c.cell_type == "code")
    assert path.stat().st_size < 400_000
    nbclient.NotebookClient(
        book, timeout=300, resources={"metadata": {"path": str(path.parent)}}
    ).execute()
