"""`irisjax map --posterior` and `irisjax fit --batch --posteriors amortised`. Transport is `Quick`'s,
and flows are hardly trained.
"""

import h5netcdf
import numpy as np
import pytest
from stand_ins import FREE

from cube_files import GRID
from irisjax.cli import batch, flows
from irisjax.cli import map as command
from irisjax.infer.amortised import train_flow
from irisjax.io.fits import read_fits


@pytest.fixture
def trained(quick, monkeypatch):
    """How often a flow was trained."""
    count = []

    def train(*arguments, **how):
        count.append(how)
        return train_flow(*arguments, **how, simulated=2048, epochs=2)

    monkeypatch.setattr(flows, "train_flow", train)
    monkeypatch.setattr("irisjax.infer.pixels._DRAWS", 256)
    return count


@pytest.mark.peer
def test_posteriors_of_a_cube(done, trained, monkeypatch, tmp_path):
    monkeypatch.setattr(command, "picture", lambda figure, suffix: b"a picture")
    made, out, grid = tmp_path / "made", tmp_path / "maps", ",".join(f"{x:g}" for x in GRID)
    size = ("--size", 16, "--wavelengths", grid, "--process", "ilit-2006")
    line, _ = done("simulate-cube", "-o", made, *size)
    given = (*line.split()[1:], "--free", "melanin_load,hemoglobin", "--fix", "gain=1")
    given = (*given, "--posterior", "--flows", tmp_path / "known")
    _, err = done(*given, "-o", out)
    assert "training a flow" in err
    with h5netcdf.File(out / "maps.nc") as maps:
        good = maps["flag"][...] == 0
        share = maps["efficiency"][...][good]
        assert good.any() and (share > 0.05).mean() > 0.8
        for name in ("melanin_load", "hemoglobin"):
            mean, sd = (maps[f"{name}_posterior_{w}"][...][good] for w in ("mean", "sd"))
            # Two well determined parameters have posteriors close to normal.
            assert (np.abs(mean - maps[name][...][good]) < 3 * sd).mean() > 0.95
            ratio = sd / maps[f"{name}_sd"][...][good]
            assert 0.5 < np.median(ratio) < 2
    assert (out / "efficiency.png").exists()
    # A second cube of the same camera.
    _, err = done(*given, "-o", tmp_path / "again")
    assert "training" not in err
    assert len(trained) == 1
    assert (tmp_path / "again" / "maps.nc").read_bytes() == (out / "maps.nc").read_bytes()


@pytest.mark.peer
def test_posteriors_of_a_batch(done, copies, trained, monkeypatch, tmp_path):
    eyes, out = copies("a", "b", "c"), tmp_path / "out"
    sampled = []
    monkeypatch.setattr(
        batch.report, "report_eye", lambda *a, **_: sampled.append(a[1].name) or True
    )
    given = ("fit", "--batch", eyes, "-o", out, "--posteriors", "amortised", *FREE)
    done(*given)
    rows = [line.split(",") for line in (out / "fits.csv").read_text().splitlines()]
    found = [dict(zip(rows[0], row, strict=True)) for row in rows[1:]]
    assert [row["posterior"] for row in found] == ["converged"] * 3
    assert float(found[0]["efficiency"]) > 0.05 and not sampled
    ends = [float(found[0][f"melanin_load_q{q}"]) for q in ("2.5", "50", "97.5")]
    assert ends == sorted(ends)
    assert read_fits(out, ("ok", "doubtful")).draws is not None
    assert len(list((out / "flows").iterdir())) == 1
    # Too few effective draws: a chain.
    monkeypatch.setattr(batch, "EFFICIENT", 2.0)
    done(*given, "--overwrite")
    assert sampled == ["a", "b", "c"] and len(trained) == 1
