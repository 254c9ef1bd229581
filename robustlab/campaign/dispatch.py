"""The loop of a campaign: pieces of what the store lacks go to the workers, what comes back goes to the store."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, wait

from robustlab.campaign.evaluation import Evaluator, Rows, compute
from robustlab.campaign.store import Store
from robustlab.campaign.workers import Workers
from robustlab.errors import EnvironmentFault, NoTrustworthyNumber

MAX_LOST_SHARE = 0.01  # of the samples that may have no value
# How the work is cut; the samples do not depend on it.
PIECE_SECONDS = 0.7  # of work in a piece: long against sending and storing it, short against what a kill may lose
GROWTH = 4  # factor by which a piece grows at most, until its speed is known
LONGEST_PIECE = 100_000  # samples: its rows are held in memory and written in one transaction
POLL_SECONDS = 1.0


class _Pieces:
    """What is missing in the store, cut at the borders of tiles into pieces of about PIECE_SECONDS."""

    def __init__(self, gaps: list[tuple[int, int]], tile: int) -> None:
        self._gaps, self._tile, self._tiles, self._seconds = gaps[::-1], tile, 1, 0.0

    def __iter__(self) -> Iterator[tuple[int, int]]:
        while self._gaps:
            first, last = self._gaps.pop()
            first -= first % self._tile  # a tile is computed whole, whatever of it is stored
            end = first + self._tiles * self._tile
            if end < last:
                self._gaps.append((end, last))
            yield first, min(end, -(-last // self._tile) * self._tile)

    def learn(self, rows: Rows) -> None:
        """Take the time of a finished piece into account."""
        each = float(rows.seconds.mean())
        self._seconds = each if not self._seconds else 0.7 * self._seconds + 0.3 * each
        wanted = int(PIECE_SECONDS / max(self._seconds, 1e-9) / self._tile)
        self._tiles = max(1, min(wanted, GROWTH * self._tiles, LONGEST_PIECE // self._tile))


def compute_missing(store: Store, evaluator: Evaluator, workers: Workers, progress: Callable[[int], None]) -> None:
    """Compute what the store lacks; ``progress`` is called with the number of samples that were just stored.

    Raises NoTrustworthyNumber: more than 1 % of the samples have no value. EnvironmentFault: a worker ended.
    """
    n, identity, model = evaluator.settings.n, store.identity, store.model
    todo = _Pieces(store.missing(n), evaluator.tile)
    pieces, under_way = iter(todo), set[Future[Rows]]()
    lost = store.counts().lost
    _stop_if_too_many(store, lost, n)
    while True:
        while len(under_way) <= workers.count and (piece := next(pieces, None)) is not None:
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
            todo.learn(rows)
            rows = rows.up_to(n)
            store.save(rows)
            progress(len(rows))
            lost += len(rows.lost)
            if rows.lost:
                _stop_if_too_many(store, lost, n)


def _stop_if_too_many(store: Store, lost: int, n: int) -> None:
    if lost <= MAX_LOST_SHARE * n:
        return
    first = store.lost(3)
    raise NoTrustworthyNumber(
        store.where,
        f"{lost} of {n} samples are lost, more than {100 * MAX_LOST_SHARE:g} %",
        None,
        f"robustlab campaign replay {store.where} {first[0].index}",
        tuple(f"sample {row.index}: {row.reason}" for row in first),
    )
