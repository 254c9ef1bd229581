"""The loop of a campaign: what is missing goes to idle workers, what comes back goes to the store.

A piece that fails is narrowed down to the guilty sample: a piece whose worker died is tried once more (the worker may
have been killed for no fault of the sample), then tile by tile, then sample by sample. A sample on which two workers
died, or one hung, is lost: it is stored with its Delta and the reason, and the rest goes on.
"""

from __future__ import annotations

import json
import math
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import NamedTuple

from robustlab.campaign.evaluation import Evaluator, Failure, Outcome, Piece, Rows, Workers
from robustlab.campaign.store import Store
from robustlab.errors import NoTrustworthyNumber

# What is promised: so many samples may be lost, and a sample has so many workers before it is.
MAX_LOST_SHARE = 0.01
MAX_ATTEMPTS = 2
# How the work is cut; the samples do not depend on it.
# s of work in a piece: long against the time to send and store it, short against what a killed run may lose.
PIECE_SECONDS = 0.7
# A piece grows by this factor at most, until its speed is known; a larger one risks a long first piece.
GROWTH = 4
# Samples in a piece: its rows are held in memory and written in one transaction.
LONGEST_PIECE = 100_000
# A piece may take so much longer than its samples are expected to take, beside the limit of one sample.
PATIENCE = 5.0
# s between looks at workers that say nothing.
POLL_SECONDS = 1.0


@dataclass
class _Pace:
    """Seconds per sample as measured, and the size of the next piece in tiles."""

    tile: int
    seconds: float = 0.0
    tiles: int = 1

    def learn(self, samples: int, seconds: float) -> None:
        """Take a finished piece into account."""
        each = seconds / samples
        self.seconds = each if not self.seconds else 0.7 * self.seconds + 0.3 * each
        wanted = PIECE_SECONDS / max(self.seconds, 1e-9) / self.tile
        most = min(GROWTH * self.tiles, LONGEST_PIECE // self.tile)
        self.tiles = max(1, min(int(wanted), most))

    def limit(self, samples: int, each: float) -> float:
        """Seconds after which a piece is taken for hung."""
        return each + PATIENCE * self.seconds * samples


class _Queue:
    """Pieces that are to be done: those that failed first, then what is missing in the store, in order."""

    def __init__(self, gaps: list[tuple[int, int]], n: int, pace: _Pace, limit: float) -> None:
        self._again: deque[Piece] = deque()
        self._gaps = deque(self._pieces_of(gaps, n, pace.tile))
        self._pace, self._limit = pace, limit

    @staticmethod
    def _pieces_of(gaps: list[tuple[int, int]], n: int, tile: int) -> Iterator[tuple[int, int, bool]]:
        """Gaps as (first, last, alone). A tile of which some samples are stored was being narrowed down."""
        for first, last in gaps:
            head = min(-(-first // tile) * tile, last)
            tail = last if last == n else max(last // tile * tile, head)
            for part in ((first, head, True), (head, tail, False), (tail, last, True)):
                if part[0] < part[1]:
                    yield part

    def __bool__(self) -> bool:
        return bool(self._again or self._gaps)

    def next(self) -> Piece | None:
        """The next piece, or None where all are done or under way."""
        if self._again:
            return self._again.popleft()
        if not self._gaps:
            return None
        first, last, alone = self._gaps.popleft()
        tiles = self._pace.tiles
        size = 1 if alone else tiles * self._pace.tile
        end = min(first + size, last)
        if end < last:
            self._gaps.appendleft((end, last, alone))
        if alone:
            return Piece(first, end, self._limit, alone=True)
        end = -(-end // self._pace.tile) * self._pace.tile  # the last tile is whole, whatever n is
        return Piece(first, end, self._pace.limit(end - first, self._limit))

    def narrow(self, piece: Piece, timeout: bool) -> bool:
        """Plan a failed piece anew; False where it is one sample that has had its chances."""
        if not timeout and piece.attempts + 1 < MAX_ATTEMPTS:
            self._again.append(piece.again())
            return True
        if piece.alone or (len(piece) == 1 and self._pace.tile == 1):
            return False
        tile = self._pace.tile
        if len(piece) > tile:
            starts = range(piece.first, piece.last, tile)
            self._again.extend(Piece(start, start + tile, self._pace.limit(tile, self._limit)) for start in starts)
        else:
            self._again.extend(Piece(i, i + 1, self._limit, alone=True) for i in range(piece.first, piece.last))
        return True


def compute_missing(
    store: Store, evaluator: Evaluator, workers: Workers, limit: float, progress: Callable[[int], None]
) -> None:
    """Compute what the store lacks.

    ``limit``: seconds that one sample may take.
    ``progress``: called with the number of samples that were just stored.
    Raises NoTrustworthyNumber: more than 1 % of the samples are lost.
    """
    n = evaluator.settings.n
    pace = _Pace(evaluator.tile)
    todo = _Queue(store.missing(n), n, pace, limit)
    lost, under_way = store.counts().lost, 0
    _stop_if_too_many(store, lost, n)
    while True:
        while workers.idle() and (piece := todo.next()) is not None:
            if piece.first >= n:
                continue  # a sample beyond n, from the last tile narrowed down
            workers.start(piece)
            under_way += 1
        if not under_way and not todo:
            return
        for outcome in workers.wait(POLL_SECONDS):
            under_way -= 1
            rows = _rows_of(outcome, todo, evaluator)
            if rows is None:
                continue
            if not outcome.piece.alone or not pace.seconds:
                pace.learn(len(rows), outcome.seconds)
            rows = rows.up_to(n)
            store.save(rows)
            progress(len(rows))
            lost += len(rows.lost)
            if rows.lost:
                _stop_if_too_many(store, lost, n)


def _rows_of(outcome: Outcome, todo: _Queue, evaluator: Evaluator) -> Rows | None:
    """What is to be stored of an outcome; None where the work is planned anew."""
    piece, answer = outcome.piece, outcome.answer
    if isinstance(answer, Failure):
        if todo.narrow(piece, answer.timeout):
            return None
        return evaluator.blank(piece.first, answer.reason, outcome.seconds)
    rows = Rows.from_bytes(answer)
    if (rows.first, len(rows), rows.deltas.shape[1]) != (piece.first, len(piece), evaluator.width):
        raise NoTrustworthyNumber(
            "campaign",
            f"a worker answered with samples {rows.first} .. {rows.first + len(rows) - 1}",
            f"{piece.first} .. {piece.last - 1}",
        )
    return rows


def _stop_if_too_many(store: Store, lost: int, n: int) -> None:
    if lost <= MAX_LOST_SHARE * n:
        return
    first = store.lost(3)
    raise NoTrustworthyNumber(
        store.where,
        f"{lost} of {n} samples are lost, more than {100 * MAX_LOST_SHARE:g} %",
        None,
        f"robustlab campaign replay {store.where} {first[0].index}; "
        f"then robustlab campaign resume {store.where} --retry-lost",
        tuple(f"sample {row.index}: {row.reason}" for row in first),
    )


class Again(NamedTuple):
    """A metric through its second path: value (NaN where no worker lived to tell), where attained, all digits there."""

    value: float
    at: float
    accurate: bool


def evaluate_again(workers: Workers, numbers: tuple[float, ...], limit: float) -> Again:
    """The metric at one Delta through its second path, in a worker, which it may crash or hang."""
    for attempt in range(MAX_ATTEMPTS):
        while not workers.idle():
            workers.wait(POLL_SECONDS)
        workers.start(Piece(0, 1, limit, alone=True, attempts=attempt, delta=numbers))
        outcomes = workers.wait(POLL_SECONDS)
        while not outcomes:
            outcomes = workers.wait(POLL_SECONDS)
        answer = outcomes[0].answer
        if not isinstance(answer, Failure):
            return Again(**json.loads(answer))
    return Again(math.nan, math.nan, False)
