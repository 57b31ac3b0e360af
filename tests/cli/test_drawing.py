"""Figures drawn by a second process."""

import os
import signal

import numpy as np
import pytest

from irisjax.plot import beside as beside_module
from irisjax.plot.beside import beside, here

UNEVEN = {"load": np.zeros(3), "share": np.zeros(4)}
SAMPLES = {"load": np.random.default_rng(0).normal(size=40_000), "share": np.linspace(0, 1, 40_000)}


def test_another_process_draws_the_same_picture():
    """Samples and pictures that fill pipes, one after another; what is wrong is said here."""
    with beside() as draw:
        later = [draw("corner_figure", SAMPLES) for _ in range(3)]
        pictures = [picture() for picture in later]
        with pytest.raises(ValueError, match="same shape"):
            draw("corner_figure", UNEVEN)()
    assert pictures == [here("corner_figure", SAMPLES)()] * 3


@pytest.mark.skipif(os.name == "nt", reason="signals of POSIX")
def test_a_process_that_died_is_done_without(monkeypatch):
    begun = []
    popen = beside_module.subprocess.Popen
    monkeypatch.setattr(
        beside_module.subprocess, "Popen", lambda *a, **k: begun.append(popen(*a, **k)) or begun[0]
    )
    with beside() as draw:
        os.kill(begun[0].pid, signal.SIGKILL)
        assert draw("corner_figure", SAMPLES)().startswith(b"\x89PNG")


def test_one_core_draws_for_itself(monkeypatch):
    monkeypatch.setattr(os, "cpu_count", lambda: 1)
    with beside() as draw:
        assert draw is here
