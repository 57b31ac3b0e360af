"""The code of pages runs, block after block."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
PAGE = ROOT / "docs" / "how-to" / "own-inference.md"
BLOCKS = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), flags=re.S)


def run(monkeypatch, *blocks):
    monkeypatch.chdir(ROOT)
    names = {}
    for block in blocks:
        exec(compile(block, str(PAGE), "exec"), names)
    return names


def test_a_loss_of_ones_own_finds_the_iris(monkeypatch, capsys):
    first, *others = BLOCKS
    (block,) = (b for b in others if "optimistix" in b)
    found = run(monkeypatch, first, block)
    load, fraction, gain = found["problem"].natural(found["best"].value)
    assert load == pytest.approx(0.349, rel=0.1)  # the truth, in the file's header
    assert fraction == pytest.approx(0.5, abs=0.1)
    assert gain == pytest.approx(1.0, abs=0.06)
    assert "melanin_load" in capsys.readouterr().out
    for name in ("optimistix", "numpyro"):
        (block,) = (b for b in others if name in b)
        assert len([x for x in block.splitlines() if x and "import" not in x]) <= 10


@pytest.mark.peer
@pytest.mark.filterwarnings("ignore")  # ArviZ's and numpyro's own
def test_all_blocks_run_in_their_order(monkeypatch, capsys):
    found = run(monkeypatch, *BLOCKS)
    assert "melanin_load" in capsys.readouterr().out
    load = found["nuts"].get_samples()["melanin_load"].mean()
    assert load == pytest.approx(0.349, rel=0.15)
