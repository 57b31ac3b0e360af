"""A worker of dask.distributed, set up as the command sets up its own process."""

import os

import jax
from distributed import Worker, WorkerPlugin

from irisjax.cli.compiled import keep_compiled


class WorkerSetup(WorkerPlugin):
    """A plugin that sets up workers, also later ones, before they import the functions they run.

    Attributes:
        shares: Number of workers among which this machine's cores are shared; `None` to use all.
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
