"""Figures drawn by a second process."""

import multiprocessing
import os

import numpy as np
import pytest

from irisjax.plot.beside import beside, here

NOISE = np.random.default_rng(0).uniform(size=(2, 100, 100, 3))  # of half a megabyte


def test_another_process_draws_the_same_picture():
    """Numbers and pictures that fill pipes, one after another; what is wrong is said here, and a
    process that died is done without.
    """
    with beside() as draw:
        later = [draw("side_by_side", *NOISE) for _ in range(2)]
        pictures = [picture() for picture in later]
        with pytest.raises(AttributeError, match="no_figure"):
            draw("no_figure")()
        (process,) = multiprocessing.active_children()
        process.kill()
        pictures.append(draw("side_by_side", *NOISE)())
    assert pictures == [here("side_by_side", *NOISE)()] * 3


def test_one_core_draws_for_itself(monkeypatch):
    monkeypatch.setattr(os, "cpu_count", lambda: 1)
    with beside() as draw:
        assert draw is here
