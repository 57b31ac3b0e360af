"""Pieces of the work on a batch or on a cube: done one after the other in this process, or by
dask.distributed in worker processes of this machine or of a cluster.

Results do not depend on where a piece is done, nor on how often: a piece whose worker or scheduler
dies is done again.
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

_PIECES_AHEAD = 4  # for each core of the workers: none of these waits, and a scheduler has few
_PATIENCE = 120  # seconds in which a lost scheduler may come back
_CONNECTING = 10  # seconds in which one must answer at first
_OUR_WORKERS = {  # dask's own choice for each costs a chain a tenth to a fifth of its time
    # Memory that a step of a chain returns is wanted by the next one: the C library keeps it.
    "distributed.nanny.pre-spawn-environ.MALLOC_TRIM_THRESHOLD_": 2**30,
    "distributed.nanny.pre-spawn-environ.MALLOC_MMAP_THRESHOLD_": 2**25,
    "distributed.worker.profile.enabled": False,
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
    def elsewhere(self) -> bool:
        """Whether the work is done in other processes."""
        return self.workers is not None or self.scheduler is not None


class Lost(NamedTuple):
    """A piece that has no result.

    Attributes:
        why: What went wrong with it, in one line.
    """

    why: str


def each(
    function: Callable[..., Any], pieces: Mapping[_Key, tuple[Any, ...]], workers: Workers
) -> Iterator[tuple[_Key, Any]]:
    """Yield names of pieces and what a module's `function` returns for their arguments, in the
    order in which they are done. Arguments are looked up when a piece is begun.

    In other processes an exception of one piece is its result, as `Lost`; here it is raised.
    """
    if not workers.elsewhere:
        for name in pieces:
            yield name, function(*pieces[name])
        return
    with _scheduler_of(workers) as (address, shares):
        suspects: list[_Key] = []
        for name, result in _done(address, shares, function, pieces, dict.fromkeys(pieces)):
            if isinstance(result, Lost) and result.why == _KILLED:
                suspects.append(name)
            else:
                yield name, result
        # A scheduler blames a worker's death on all that waited for that worker: once more, alone.
        for name in suspects:
            yield from _done(address, shares, function, pieces, {name: None})


def _done(
    address: str,
    shares: int | None,
    function: Callable[..., Any],
    pieces: Mapping[_Key, tuple[Any, ...]],
    left: dict[_Key, None],
) -> Iterator[tuple[_Key, Any]]:
    """Do the pieces that are left, whatever happens to the scheduler."""
    since = None
    while left:
        done = len(left)
        with _connected(address, _CONNECTING if since is None else _PATIENCE) as client:
            client.register_plugin(import_module("irisjax.cli.worker").Ready(shares))
            yield from _until_lost(client, function, pieces, left)
        if left:  # the scheduler is gone, or has forgotten
            lost = time.monotonic()
            since = lost if since is None or len(left) < done else since
            if lost - since > _PATIENCE:
                raise ValueError(f"{address}: the scheduler is lost; --resume continues")
            time.sleep(0.5)


def _until_lost(
    client: Any,
    function: Callable[..., Any],
    pieces: Mapping[_Key, tuple[Any, ...]],
    left: dict[_Key, None],
) -> Iterator[tuple[_Key, Any]]:
    """Take pieces from those that are left until none is, or the scheduler has lost them."""
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
            result = future.result() if error is None else Lost(fault_of(error))
            del left[name]
            yield name, result
            submit()
    except (OSError, RuntimeError, TimeoutError, CancelledError):
        if client.status == "running":
            raise  # no fault of the connection


@contextmanager
def _scheduler_of(workers: Workers) -> Iterator[tuple[str, int | None]]:
    """A scheduler's address, and among how many workers this machine's cores are shared."""
    if workers.scheduler is not None:
        yield workers.scheduler, None
        return
    # After Ctrl-C Python would add lines of its own about what the workers' pipes leave behind.
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
def _connected(address: str, patience: float) -> Iterator[Any]:
    """A client of a scheduler that answers in time."""
    logging.getLogger("distributed").setLevel(logging.CRITICAL)  # we say what there is to say
    begin, client, distributed = time.monotonic(), None, import_module("distributed")
    while client is None:
        try:
            client = distributed.Client(address, timeout=_CONNECTING, set_as_default=False)
        except (OSError, ValueError) as error:
            if isinstance(error, ValueError) or time.monotonic() - begin > patience:
                why = "no dask scheduler answers there; write such as tcp://10.0.0.1:8786"
                raise ValueError(f"--scheduler {address}: {why}") from None
            time.sleep(0.5)
    try:
        if not client.ncores():
            opt.notice(f"{address}: the scheduler has no workers yet; waiting for one")
        yield client
    finally:
        client.close(timeout=2)


def fault_of(error: BaseException) -> str:
    """Return what is wrong with an eye, in a line."""
    words = " ".join(str(error).split())
    if isinstance(error, ValueError | OSError):
        return words
    if type(error).__name__ == "KilledWorker":  # dask's, which is not always installed
        return _KILLED
    return f"internal error: {type(error).__name__}: {words}"
