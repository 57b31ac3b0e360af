"""A worker of dask.distributed, set up as the command sets up its own process."""

import os

import jax
from distributed import Worker, WorkerPlugin

from irisjax.cli.compiled import keep_compiled


class Ready(WorkerPlugin):
    """A plugin that sets workers up before they import what they are to do, later ones too.

    Attributes:
        shares: Among how many workers the cores of this machine are shared; `None` leaves them.
    """

    name = "irisjax"

    def __init__(self, shares: int | None):
        self.shares = shares

    def setup(self, worker: Worker) -> None:
        """Take a share of the cores, choose the precision and keep compiled programs."""
        if self.shares is not None and hasattr(os, "sched_setaffinity"):
            cores = sorted(os.sched_getaffinity(0))
            place = int(worker.name) % len(cores)
            # Threads that start later inherit it.
            os.sched_setaffinity(0, cores[place :: self.shares] or [cores[place]])
        jax.config.update("jax_enable_x64", True)
        keep_compiled()
