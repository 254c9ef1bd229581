"""Executors of a campaign: processes on this machine, or the workers of a Dask cluster (``robustlab[cluster]``)."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, ProcessPoolExecutor
from contextlib import AbstractContextManager, contextmanager, suppress
from dataclasses import dataclass
from typing import Any, NamedTuple

from robustlab.errors import DependencyMissing, EnvironmentFault, InputError

CONNECT_SECONDS = 10.0
EMPTY_SECONDS = 60.0  # to wait for the first worker of a cluster


@dataclass(frozen=True)
class Crew:
    """Workers of a campaign; the samples do not depend on them."""

    workers: int | None = None  # processes on this machine; one per processor where omitted
    cluster: str | None = None  # instead: address of a Dask scheduler, whose workers are used

    def __post_init__(self) -> None:
        count = self.workers
        if count is not None and (isinstance(count, bool) or not isinstance(count, int) or count < 1):
            raise InputError("campaign", f"{count!r} workers", "a whole number, at least 1")


class Workers(NamedTuple):
    """An executor, its number of parallel pieces of work, and a function that raises if it has ended."""

    executor: Executor
    n: int
    check: Callable[[], None]


def started_workers(crew: Crew, samples: int) -> AbstractContextManager[Workers]:
    """Provide the workers of a crew and end them on exit."""
    return _on_cluster(crew.cluster) if crew.cluster is not None else _on_this_machine(crew.workers, samples)


@contextmanager
def _on_this_machine(wanted: int | None, samples: int) -> Iterator[Workers]:
    processors = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    count, others = min(wanted or processors, max(1, samples)), set(multiprocessing.active_children())
    executor = ProcessPoolExecutor(count, multiprocessing.get_context("spawn"), _end_with_parent)
    try:
        with _ctrl_c_ignored():
            executor.submit(int)  # starts all processes, which inherit that Ctrl-C is ignored
        yield Workers(executor, count, lambda: None)
    finally:
        for child in set(multiprocessing.active_children()) - others:
            child.terminate()
        executor.shutdown(cancel_futures=True)  # quick without them; unawaited, it races the interpreter's own end


@contextmanager
def _ctrl_c_ignored() -> Iterator[None]:
    if threading.current_thread() is not threading.main_thread():  # signals cannot be set here
        yield
        return
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


def _end_with_parent() -> None:
    """Make a worker process end with its parent."""
    parent: Any = multiprocessing.parent_process()

    def wait() -> None:
        parent.join()
        os._exit(0)

    threading.Thread(target=wait, daemon=True).start()


@contextmanager
def _on_cluster(address: str) -> Iterator[Workers]:
    try:
        from distributed import Client
    except ImportError:
        raise DependencyMissing(
            "campaign --cluster", "needs dask.distributed", None, "pip install 'robustlab[cluster]'"
        ) from None
    where = f"--cluster {address}"
    try:
        client: Any = Client(address, timeout=CONNECT_SECONDS, set_as_default=False)
    except (OSError, ValueError) as error:
        found = f"no Dask scheduler answers ({error})"
        raise EnvironmentFault(where, found, None, "dask scheduler --port 8786") from None

    def check() -> None:
        if client.status not in ("running", "connecting"):
            raise EnvironmentFault(where, "the scheduler is gone")

    try:
        try:
            client.wait_for_workers(1, timeout=EMPTY_SECONDS)
        except TimeoutError:
            hint = f"dask worker {address} --nthreads 1"
            raise EnvironmentFault(where, "has no workers", None, hint) from None
        count = len(client.scheduler_info(n_workers=-1)["workers"])
        yield Workers(client.get_executor(pure=False), count, check)
    finally:
        with suppress(OSError, TimeoutError):
            client.close(timeout=2)
