"""Figures drawn by a second process."""

import multiprocessing
import os

import numpy as np
import pytest

from irisjax.plot.beside import beside, here

NOISE = np.random.default_rng(0).uniform(size=(2, 100, 100, 3))  # of half a megabyte


def test_another_process_draws_the_same_picture():
    """Numbers and pictures that fill pipes, one after another; what is wrong is said here."""
    with beside() as draw:
        later = [draw("side_by_side", *NOISE) for _ in range(2)]
        pictures = [picture() for picture in later]
        with pytest.raises(AttributeError, match="no_figure"):
            draw("no_figure")()
    assert pictures == [here("side_by_side", *NOISE)()] * 2


def test_a_process_that_died_is_done_without():
    with beside() as draw:
        (process,) = multiprocessing.active_children()
        process.kill()
        assert draw("side_by_side", *NOISE)().startswith(b"\x89PNG")


def test_one_core_draws_for_itself(monkeypatch):
    monkeypatch.setattr(os, "cpu_count", lambda: 1)
    with beside() as draw:
        assert draw is here
