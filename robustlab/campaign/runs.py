"""Running, resuming and reading campaigns, by processes on this machine or the workers of a Dask cluster."""

from __future__ import annotations

import json
import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ProcessPoolExecutor, wait
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, NamedTuple

from robustlab import checks
from robustlab.campaign.campaign_result import CampaignResult, result_of
from robustlab.campaign.evaluation import (
    CampaignSettings,
    Evaluator,
    Identity,
    Rows,
    code_identity,
    compute,
    differences,
    model_from_bytes,
)
from robustlab.campaign.store import Store, locked
from robustlab.errors import DependencyMissing, EnvironmentFault, InputError, NoTrustworthyNumber
from robustlab.uncertainty.lft import UncertainModel
from robustlab.worst_case_analysis.members import decoded

MAX_LOST_SHARE = 0.01  # largest share of samples without a value
# Sizes of pieces of work; the samples do not depend on them.
PIECE_SECONDS = 0.7  # long compared with sending and storing a piece, short compared with the loss by a kill
GROWTH = 4  # largest factor by which a piece grows
LONGEST_PIECE = 100_000  # samples: the rows are held in memory and written in one transaction
POLL_SECONDS = 1.0
CONNECT_SECONDS = 10.0
EMPTY_SECONDS = 60.0  # to wait for the first worker of a cluster


@dataclass(frozen=True)
class Crew:
    """Workers of a campaign; the samples do not depend on them."""

    workers: int | None = None  # processes on this machine; one per processor where omitted
    cluster: str | None = None  # instead: address of a Dask scheduler, whose workers are used

    def __post_init__(self) -> None:
        if self.workers is not None:
            checks.whole("campaign: workers", self.workers, 1)


ALL_PROCESSORS = Crew()


def run_campaign(
    uncertain: UncertainModel,
    settings: CampaignSettings,
    store: str | Path,
    *,
    crew: Crew = ALL_PROCESSORS,
    existing: Literal["resume", "restart"] = "resume",
    limit: float | None = None,
    progress: Callable[[int], None] = lambda _: None,
) -> CampaignResult:
    """Compute all samples of a campaign in worker processes and store each when computed; or resume a campaign.

    The same model, settings and code give the same samples, independent of workers and interruptions. A sample that
    raises is lost alone; if a worker process ends, the run ends, and a later one resumes the store.

    ``existing``: if ``store`` holds another campaign, ``"resume"`` rejects it, ``"restart"`` deletes it.
    ``limit``: count the samples that are worse. ``progress``: called with
    the number of newly stored samples, first with that of the samples already stored.
    """
    evaluator = Evaluator(uncertain, settings)
    identity, path = Identity.of(uncertain, settings), Path(store)
    with locked(path):
        if existing == "restart" or not Store.exists(path):
            Store.delete(path)
            opened = Store.create(path, uncertain, settings)
        else:
            opened = Store.open(path, write=True)
            _same_campaign(opened, identity)
        return _work(opened, evaluator, crew, limit, progress)


def resume_campaign(
    store: str | Path,
    *,
    crew: Crew = ALL_PROCESSORS,
    limit: float | None = None,
    progress: Callable[[int], None] = lambda _: None,
) -> CampaignResult:
    """Resume a campaign from its store, which holds model and settings; see `run_campaign`."""
    path = Path(store)
    Store.open(path).close()  # checks the file before a lock file is created
    with locked(path):
        opened = Store.open(path, write=True)
        old = opened.identity
        _same_campaign(opened, Identity(old.model, old.settings, code_identity()))
        return _work(opened, _evaluator(opened), crew, limit, progress)


def read_campaign(store: str | Path, limit: float | None = None) -> CampaignResult:
    """Read a store, also while a run writes it; see `CampaignResult`."""
    with closing(Store.open(Path(store))) as opened:
        return result_of(opened, _evaluator(opened), limit)


def saved_samples(store: str | Path) -> tuple[int, int]:
    with closing(Store.open(Path(store))) as opened:
        return sum(opened.counts()), opened.identity.settings.n


# --- parts -----------------------------------------------------------------------------------------------------------


def _work(
    store: Store, evaluator: Evaluator, crew: Crew, limit: float | None, progress: Callable[[int], None]
) -> CampaignResult:
    """Complete an open, locked store, check its worst sample, read and close it."""
    finished, n, before = False, evaluator.settings.n, sum(store.counts())
    try:
        progress(before)
        if before < n:
            started = (
                _on_cluster(crew.cluster) if crew.cluster is not None else _on_this_machine(crew.workers, n - before)
            )
            with started as workers:
                compute_missing(store, evaluator, workers, progress)
        if before < n or not store.facts():
            _note_end(store, evaluator)
        finished = True
        return result_of(store, evaluator, limit)
    except EnvironmentFault as fault:
        hint = f"{fault.hint or 'mend it'}; then robustlab campaign resume {store.where}"
        raise type(fault)(fault.where, fault.found, fault.expected, hint, fault.more) from fault
    finally:
        store.close(finished=finished)


def _note_end(store: Store, evaluator: Evaluator) -> None:
    """Evaluate the worst sample and the nominal model by the second method; store this and the digest."""
    worst = store.worst(evaluator.sense)
    facts: dict[str, Any] = {"digest": store.digest(), "agrees": False}
    if worst is not None:
        metric = evaluator.metric
        again = metric.evaluate(decoded(evaluator.uncertain.blocks, worst.numbers))
        agrees = again.accurate and metric.agrees(worst.value, again.value)
        facts.update(agrees=agrees, again=again.value, at=again.at, nominal=metric.evaluate({}).value)
    store.put("finished", json.dumps(facts))


def _evaluator(store: Store) -> Evaluator:
    identity, uncertain = store.identity, model_from_bytes(store.get("model"), store.where)
    if Identity.of(uncertain, identity.settings).model != identity.model:
        raise InputError(store.where, "damaged campaign store: its model does not match its hash")
    return Evaluator(uncertain, identity.settings)


def _same_campaign(store: Store, identity: Identity) -> None:
    if changes := differences(store.identity, identity):
        since = "changed since sample 0" if sum(store.counts()) else "differs from the one that was begun"
        store.close()
        hint = "--restart computes all samples anew, another --store keeps this one"
        more = tuple(f"{store.where}: {line}" for line in changes[1:])
        raise InputError(store.where, f"the campaign {since} ({changes[0]})", None, hint, more)


# --- workers ---------------------------------------------------------------------------------------------------------


class Workers(NamedTuple):
    """An executor, its number of parallel pieces of work, and a function that raises if it has ended."""

    executor: Executor
    n: int
    check: Callable[[], None]


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

    def wait() -> None:
        parent: Any = multiprocessing.parent_process()
        parent.join()
        os._exit(0)

    threading.Thread(target=wait, daemon=True).start()


@contextmanager
def _on_cluster(address: str) -> Iterator[Workers]:
    try:
        from distributed import Client
    except ImportError:
        hint = "pip install 'robustlab[cluster]'"
        raise DependencyMissing("campaign --cluster", "needs dask.distributed", None, hint) from None
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


# --- work of the missing samples -------------------------------------------------------------------------------------


def compute_missing(store: Store, evaluator: Evaluator, workers: Workers, progress: Callable[[int], None]) -> None:
    """Compute the missing samples; ``progress`` is called with the number of newly stored samples."""
    n, identity, model, lost = evaluator.settings.n, store.identity, store.get("model"), store.counts()[1]
    gaps, tile, tiles, under_way = store.missing(n)[::-1], evaluator.tile, 1, set[Future[Rows]]()

    def cut() -> Iterator[tuple[int, int]]:
        """Cut the missing samples at the borders of tiles, which are always computed as a whole."""
        while gaps:
            first, last = gaps.pop()
            first -= first % tile
            end = first + tiles * tile
            if end < last:
                gaps.append((end, last))
            yield first, min(end, -(-last // tile) * tile)

    pieces = cut()
    while True:
        if lost > MAX_LOST_SHARE * n:
            found = f"{lost} of {n} samples are lost, more than {100 * MAX_LOST_SHARE:g} %"
            hint = "rl.sample(set, n, seed).deltas[INDEX] is the member of a lost sample"
            more = tuple(f"sample {row.index}: {row.reason}" for row in store.lost(3))
            raise NoTrustworthyNumber(store.where, found, None, hint, more)
        while len(under_way) <= workers.n and (piece := next(pieces, None)) is not None:
            under_way.add(workers.executor.submit(compute, identity, model, *piece))
        if not under_way:
            return
        workers.check()
        done, under_way = wait(under_way, POLL_SECONDS, FIRST_COMPLETED)
        for future in done:
            try:
                rows = future.result()
            except Exception as error:
                found = f"a worker failed ({type(error).__name__}: {error})"[:500]
                raise EnvironmentFault("campaign", found, None, "give it more memory, or fewer --workers") from error
            wanted = int(PIECE_SECONDS / max(float(rows.seconds.mean()), 1e-9) / tile)
            tiles = max(1, min(wanted, GROWTH * tiles, LONGEST_PIECE // tile))
            store.save(rows)
            progress(len(rows.values))
            lost += len(rows.lost)
