"""Pieces of the work on a batch or a cube, run one after the other in this process, or by
dask.distributed in worker processes of this machine or of a cluster.

Results do not depend on where a piece runs, nor on how often: a piece whose worker or scheduler
dies runs again.
"""

import itertools
import logging
import sys
import time
from collections.abc import Callable, Hashable, Iterator, Mapping
from concurrent.futures import CancelledError
from contextlib import contextmanager
from importlib import import_module
from typing import Any, NamedTuple, TypeVar

from irisjax.cli import options as opt
from irisjax.numerics.checks import Range

_Key = TypeVar("_Key", bound=Hashable)

_PIECES_AHEAD = 4  # submitted for each core of the workers, so that none waits for work
_PATIENCE = 120  # seconds in which a lost scheduler may come back
_CONNECTING = 10  # seconds in which a scheduler must answer at first
_OUR_WORKERS = {
    # Dask's own choice for each of the first three costs a chain a tenth to a fifth of its time.
    # The C library keeps the memory that a step of a chain returns, for the next step.
    "distributed.nanny.pre-spawn-environ.MALLOC_TRIM_THRESHOLD_": 2**30,
    "distributed.nanny.pre-spawn-environ.MALLOC_MMAP_THRESHOLD_": 2**25,
    "distributed.worker.profile.enabled": False,
    # After this time dask would give a worker up for good if it happened to be down just then, and
    # the pieces would wait for ever; but the worker's nanny starts another.
    "distributed.deploy.lost-worker-timeout": "365 days",
    "distributed.scheduler.allowed-failures": 1,
}
_KILLED = "the worker died on it several times (has it enough memory?)"


class Workers(opt.Group, panel="Workers"):
    workers: int | None = opt.whole(
        "number of processes of this machine among which the eyes of --batch, or the pixels of a "
        "cube, are shared, {}",
        Range(1, 512),
    )
    scheduler: str | None = opt.option(
        "address of a dask.distributed scheduler, among whose workers these are shared",
        metavar="ADDRESS",
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.workers is not None and self.scheduler is not None:
            raise ValueError("--workers starts processes here, --scheduler uses others: give one")

    def check(self, batch: object) -> None:
        """Raise `ValueError` for options that mean nothing without a batch."""
        if batch is None and (self.workers or self.scheduler):
            name = "--workers" if self.workers else "--scheduler"
            raise ValueError(f"{name} means something only with --batch")

    @property
    def in_other_processes(self) -> bool:
        return self.workers is not None or self.scheduler is not None


class LostPiece(NamedTuple):
    """A piece that has no result.

    Attributes:
        reason: What went wrong with it, in one line.
    """

    reason: str


def run_pieces(
    function: Callable[..., Any], pieces: Mapping[_Key, tuple[Any, ...]], workers: Workers
) -> Iterator[tuple[_Key, Any]]:
    """Yield names of pieces and the results of a module's `function` for their arguments, in the
    order in which they are done. Arguments are looked up when a piece begins.

    In other processes the result of a piece that fails is a `LostPiece`; here its exception is
    raised.
    """
    if not workers.in_other_processes:
        for name in pieces:
            yield name, function(*pieces[name])
        return
    with _start_scheduler(workers) as (address, shares):
        suspects: list[_Key] = []
        for name, result in _run_all(address, shares, function, pieces, dict.fromkeys(pieces)):
            if isinstance(result, LostPiece) and result.reason == _KILLED:
                suspects.append(name)
            else:
                yield name, result
        # A scheduler blames a worker's death on all pieces that waited for it: run them alone.
        for name in suspects:
            yield from _run_all(address, shares, function, pieces, {name: None})


def _run_all(
    address: str,
    shares: int | None,
    function: Callable[..., Any],
    pieces: Mapping[_Key, tuple[Any, ...]],
    left: dict[_Key, None],
) -> Iterator[tuple[_Key, Any]]:
    """Run the pieces that are left, connecting again if the scheduler is lost."""
    lost_since = None
    while left:
        before = len(left)
        with _connect(address, _CONNECTING if lost_since is None else _PATIENCE) as client:
            client.register_plugin(import_module("irisjax.cli.worker").WorkerSetup(shares))
            yield from _take_pieces(client, function, pieces, left)
        if left:  # the scheduler is gone, or has lost the pieces
            now = time.monotonic()
            lost_since = now if lost_since is None or len(left) < before else lost_since
            if now - lost_since > _PATIENCE:
                raise ValueError(f"{address}: the scheduler is lost; --resume continues")
            time.sleep(0.5)


def _take_pieces(
    client: Any,
    function: Callable[..., Any],
    pieces: Mapping[_Key, tuple[Any, ...]],
    left: dict[_Key, None],
) -> Iterator[tuple[_Key, Any]]:
    """Yield results of the pieces that are left, until none is or the scheduler has lost them."""
    waiting = iter(list(left))
    names: dict[Any, _Key] = {}
    finished = import_module("distributed").as_completed(loop=client.loop)

    def submit() -> None:
        ahead = _PIECES_AHEAD * max(1, sum(client.ncores().values()))
        for name in itertools.islice(waiting, max(0, ahead - len(names))):
            future = client.submit(function, *pieces[name], pure=False)
            names[future] = name
            finished.add(future)

    try:
        submit()
        for future in finished:
            name = names.pop(future)
            if future.status not in ("finished", "error"):
                return
            error = future.exception() if future.status == "error" else None
            result = future.result() if error is None else LostPiece(describe_fault(error))
            del left[name]
            yield name, result
            submit()
    except (OSError, RuntimeError, TimeoutError, CancelledError):
        if client.status == "running":
            raise  # it is not the connection that failed


@contextmanager
def _start_scheduler(workers: Workers) -> Iterator[tuple[str, int | None]]:
    """Yield a scheduler's address, and among how many workers this machine's cores are shared."""
    if workers.scheduler is not None:
        yield workers.scheduler, None
        return
    # After Ctrl-C Python would print warnings about the workers' pipes.
    sys.warnoptions.append("ignore::UserWarning:multiprocessing.resource_tracker")
    dask, distributed = import_module("dask"), import_module("distributed")
    with (
        dask.config.set(_OUR_WORKERS),
        distributed.LocalCluster(
            n_workers=workers.workers,
            threads_per_worker=1,
            processes=True,
            memory_limit=0,
            dashboard_address=None,
            silence_logs=logging.CRITICAL,
        ) as cluster,
    ):
        yield cluster.scheduler_address, workers.workers


@contextmanager
def _connect(address: str, patience: float) -> Iterator[Any]:
    """Yield a client of a scheduler, which must answer in time."""
    logging.getLogger("distributed").setLevel(logging.CRITICAL)  # this module reports errors
    start, client, distributed = time.monotonic(), None, import_module("distributed")
    while client is None:
        try:
            client = distributed.Client(address, timeout=_CONNECTING, set_as_default=False)
        except (OSError, ValueError) as error:
            if isinstance(error, ValueError) or time.monotonic() - start > patience:
                advice = "no dask scheduler answers there; write such as tcp://10.0.0.1:8786"
                raise ValueError(f"--scheduler {address}: {advice}") from None
            time.sleep(0.5)
    try:
        if not client.ncores():
            opt.notice(f"{address}: the scheduler has no workers yet; waiting for one")
        yield client
    finally:
        client.close(timeout=2)


def describe_fault(error: BaseException) -> str:
    """Describe an error in one line."""
    message = " ".join(str(error).split())
    if isinstance(error, ValueError | OSError):
        return message
    if type(error).__name__ == "KilledWorker":  # dask's, which is not always installed
        return _KILLED
    return f"internal error: {type(error).__name__}: {message}"
