"""Running, resuming and reading campaigns, by processes on this machine or the workers of a Dask cluster; results."""

from __future__ import annotations

import json
import math
import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ProcessPoolExecutor, wait
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np

from robustlab import checks
from robustlab.campaign.evaluation import (
    DONE,
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
from robustlab.display import AllFields, Displayable, Facts, Part, member, member_rows, number
from robustlab.errors import DependencyMissing, EnvironmentFault, InputError, NoTrustworthyNumber
from robustlab.result import Status, Table, Tabular
from robustlab.uncertainty.lft import UncertainModel
from robustlab.worst_case_analysis.batched_members import decoded
from robustlab.worst_case_analysis.statistics import clopper_pearson, quantile_bounds
from robustlab.worst_case_analysis.worst_case_search import LABEL, LABEL_SMALLEST, UNBOUNDED

CONFIDENCE = 0.95  # of each bound of a probability
TWO_SIDED = 2.0 * CONFIDENCE - 1.0  # of both together
SHARES = (0.5, 0.9, 0.99, 0.999)
SHOWN_LOST = 100
LISTED_LOST = 10  # of these in a text
_COUNTED = {"samples": ("sample", "samples"), "vertices": ("vertex", "vertices"), "search": ("search", "searches")}


@dataclass(frozen=True)
class Quantile(AllFields):
    """A share, the sample quantile, and a bound of the set's quantile at CONFIDENCE."""

    share: float
    value: float  # the order statistic with number `ceil(share n)`, counted from the best
    bound: float  # infinite where there are too few samples


@dataclass(frozen=True)
class Violation(AllFields):
    """Number of samples worse than a limit, lost ones counted, and Clopper-Pearson bounds, each at CONFIDENCE."""

    limit: float
    count: int
    of: int
    lower: float
    upper: float


@dataclass(frozen=True)
class LostSample(AllFields):
    """A sample without a value: its index, the reason, and its Delta."""

    index: int
    reason: str
    delta: Mapping[str, Any]


def _quantiles(store: Store, sense: int, lost: int) -> tuple[Quantile, ...]:
    """Return the quantiles that the number of samples allows; lost samples count as worst."""
    values = np.fromiter((row.value for row in store.samples("WHERE status = ?", DONE)), dtype=float)
    scores = np.append(sense * values, np.full(lost, np.inf))
    # Where fewer than one sample is expected above a share, the worst sample has the same information.
    shares = [share for share in SHARES if len(scores) * (1.0 - share) >= 1.0 or share <= 0.5]
    found = [quantile_bounds(scores, share, TWO_SIDED) for share in shares]
    return tuple(Quantile(q.share, sense * q.value, sense * q.upper) for q in found)


@dataclass(frozen=True)
class CampaignResult(Tabular, Displayable, AllFields):
    """The results of a campaign's store."""

    # CONVERGED: all samples are stored, and the worst one is confirmed by a second method. INACCURATE: it is not.
    # INCONCLUSIVE: samples are missing.
    status: Status
    store: str  # the file
    kind: str  # of samples
    metric: str
    unit: str
    n: int  # samples requested
    done: int  # of these with a value
    lost: int  # and without one
    unbounded: int  # samples whose value is infinite (unstable members)
    sense: int  # 1 where the largest value is the worst, -1 where the smallest is
    worst: float  # the worst value
    worst_index: int  # the sample that has it
    delta: Mapping[str, Any]  # its normalised Delta
    physical: Mapping[str, tuple[float, str]]  # its parameters as (value, unit)
    at: float  # where the worst value is attained, by the second method
    location: str
    again: float  # the worst value by the second method
    nominal: float  # the metric at Delta = 0
    quantiles: tuple[Quantile, ...]  # for samples only, once all are stored
    # Largest probability, at 95 % confidence, of a member worse than the worst sample; NaN where not sampled.
    unseen: float
    violation: Violation | None  # number of samples worse than a limit, where one was given
    lost_samples: tuple[LostSample, ...]  # the first hundred of them
    digest: str  # SHA-256 over all rows; equal for equal results, independent of interruptions
    seconds: float  # time of all samples together
    seed: int  # of the random numbers
    label: str  # meaning of the worst value

    def facts(self) -> Facts:
        one, many = _COUNTED[self.kind]
        worst = f"{number(self.worst, self.unit, 9)} in {one} {self.worst_index}"
        what, _, unit = self.location.partition(" ")
        if what and not math.isnan(self.at):
            worst += f", at {what} = {number(self.at, unit.strip('[]'), 6)}"
        missing = self.n - self.done - self.lost
        words = ((self.lost, "lost"), (missing, "missing yet"), (self.unbounded, "without a bounded value"))
        counts = [f"{self.done} of {self.n} {many}", *(f"{c} {word}" for c, word in words if c)]
        limit, v, sure = "", self.violation, "with 95 % confidence"
        if v is not None:
            bounds = f"probability {v.lower:.4g} .. {v.upper:.4g}, each side {sure}"
            limit = f"{number(v.limit, self.unit, 9)}: {v.count} of {v.of} (lost ones counted); {bounds}"
        unseen = "" if math.isnan(self.unseen) else f"at most {self.unseen:.3g} of the set, {sure}"
        return [
            (f"worst {self.metric}", worst if self.done else ""),
            ("through the second path", number(self.again, self.unit, 9)),
            ("nominal", number(self.nominal, self.unit, 9)),
            ("worst member", member(self.delta, self.physical)),
            (many, ", ".join([*counts, f"seed {self.seed}"])),
            ("members worse than all of these", unseen),
            ("worse than", limit),
            ("meaning", self.label),
            ("store", self.store),
            ("digest", self.digest),
            ("time of all samples", number(self.seconds, "s")),
        ]

    def details(self) -> list[Part]:
        rows = [(f"{100 * q.share:g} %", f"{q.value:.9g}", f"{q.bound:.9g}") for q in self.quantiles]
        lost = [(str(sample.index), sample.reason) for sample in self.lost_samples[:LISTED_LOST]]
        return [
            Part("", ("share", "not worse than", "with 95 % confidence"), rows),
            member_rows(self.delta, self.physical)._replace(title="worst member:"),
            Part("", ("lost", "reason"), lost),
        ]

    def table(self) -> Table:
        """The metric and the normalised Delta of every sample, read from the store."""
        with closing(Store.open(Path(self.store))) as store:
            rows = list(store.samples())
        deltas = np.array([row.numbers for row in rows]).reshape(len(rows), -1)
        columns = {self.metric: np.array([row.value for row in rows])}
        if deltas.shape[1] == len(self.delta):
            columns |= {name: deltas[:, k] for k, name in enumerate(self.delta)}
        return Table(("sample", [row.index for row in rows]), columns, {self.metric: self.unit})


def result_of(store: Store, evaluator: Evaluator, limit: float | None = None) -> CampaignResult:
    """Read a store. Raises InputError: the rows of a finished campaign were changed."""
    settings, blocks, sense = evaluator.settings, evaluator.uncertain.blocks, evaluator.sense
    (done, lost), facts, worst = store.counts(), store.facts(), store.worst(sense)
    n, (unbounded, above, seconds) = done + lost, store.totals(sense, limit)
    complete, digest, status = n >= settings.n, store.digest(), Status.INCONCLUSIVE
    if facts and complete:
        if facts["digest"] != digest:
            raise InputError(store.where, "its rows were changed after the campaign ended (the digest differs)")
        status = Status.CONVERGED if worst is not None and facts["agrees"] else Status.INACCURATE
    delta = decoded(blocks, worst.numbers) if worst else {}
    sampled, violation = settings.kind == "samples" and done > 0, None
    if limit is not None and done:
        lower, _ = clopper_pearson(above, n, TWO_SIDED)
        _, upper = clopper_pearson(above + lost, n, TWO_SIDED)
        violation = Violation(limit, above + lost, n, lower, upper)
    label = LABEL if sense > 0 else LABEL_SMALLEST
    return CampaignResult(
        status=status,
        store=store.where,
        kind=settings.kind,
        metric=settings.metric,
        unit=evaluator.metric.unit,
        n=settings.n,
        done=done,
        lost=lost,
        unbounded=unbounded,
        sense=sense,
        worst=worst.value if worst else math.nan,
        worst_index=worst.index if worst else -1,
        delta=delta,
        physical=evaluator.uncertain.physical(delta) if worst else {},
        at=float(facts.get("at", math.nan)),
        location=evaluator.metric.location,
        again=float(facts.get("again", math.nan)),
        nominal=float(facts.get("nominal", math.nan)),
        quantiles=_quantiles(store, sense, lost) if sampled and complete else (),
        unseen=clopper_pearson(lost, n, TWO_SIDED)[1] if sampled else math.nan,
        violation=violation,
        lost_samples=tuple(LostSample(r.index, r.reason, decoded(blocks, r.numbers)) for r in store.lost(SHOWN_LOST)),
        digest=digest,
        seconds=seconds,
        seed=settings.seed,
        label=UNBOUNDED if worst and not math.isfinite(worst.value) else label,
    )


MAX_LOST_SHARE = 0.01  # largest share of samples without a value
# Sizes of pieces of work; the samples do not depend on them.
PIECE_SECONDS = 0.7  # long compared with sending and storing a piece, short compared with the loss by a kill
GROWTH = 4  # largest factor by which a piece grows
LONGEST_PIECE = 100_000  # samples: the rows are held in memory and written in one transaction
POLL_SECONDS = 1.0
CONNECT_SECONDS = 10.0
EMPTY_SECONDS = 60.0  # to wait for the first worker of a cluster


@dataclass(frozen=True)
class WorkerOptions:
    """Workers of a campaign; the samples do not depend on them."""

    workers: int | None = None  # processes on this machine; one per processor where omitted
    cluster: str | None = None  # instead: address of a Dask scheduler, whose workers are used

    def __post_init__(self) -> None:
        if self.workers is not None:
            checks.whole("campaign: workers", self.workers, 1)


ALL_PROCESSORS = WorkerOptions()


def run_campaign(
    uncertain: UncertainModel,
    settings: CampaignSettings,
    store: str | Path,
    *,
    workers: WorkerOptions = ALL_PROCESSORS,
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
        return _work(opened, evaluator, workers, limit, progress)


def resume_campaign(
    store: str | Path,
    *,
    workers: WorkerOptions = ALL_PROCESSORS,
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
        return _work(opened, _evaluator(opened), workers, limit, progress)


def read_campaign(store: str | Path, limit: float | None = None) -> CampaignResult:
    """Report counts, worst sample, quantiles and lost samples of a store, also during a run."""
    with closing(Store.open(Path(store))) as opened:
        return result_of(opened, _evaluator(opened), limit)


def saved_samples(store: str | Path) -> tuple[int, int]:
    with closing(Store.open(Path(store))) as opened:
        return sum(opened.counts()), opened.identity.settings.n


# --- parts -----------------------------------------------------------------------------------------------------------


def _work(
    store: Store, evaluator: Evaluator, workers: WorkerOptions, limit: float | None, progress: Callable[[int], None]
) -> CampaignResult:
    """Complete an open, locked store, check its worst sample, read and close it."""
    finished, n, before = False, evaluator.settings.n, sum(store.counts())
    try:
        progress(before)
        if before < n:
            cluster, count = workers.cluster, workers.workers
            with _on_cluster(cluster) if cluster is not None else _on_this_machine(count, n - before) as executor:
                compute_missing(store, evaluator, executor, progress)
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
