"""The store of a campaign: one SQLite file with a row per sample, written by the process that holds its lock."""

from __future__ import annotations

import hashlib
import json
import sqlite3
import struct
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from robustlab.arrays import Array
from robustlab.campaign.evaluation import DONE, LOST, CampaignSettings, Identity, Rows, model_to_bytes
from robustlab.errors import EnvironmentFault, InputError
from robustlab.uncertainty.lft import UncertainModel

FORMAT_VERSION = 1
APPLICATION_ID = 0x524C4350  # "RLCP"
MAGIC = b"SQLite format 3\x00"
NEW = "robustlab campaign run --help"

_TABLES = (
    "CREATE TABLE campaign (name TEXT PRIMARY KEY, value BLOB NOT NULL) WITHOUT ROWID",
    """CREATE TABLE sample (
    idx INTEGER PRIMARY KEY,
    status INTEGER NOT NULL,  -- 0 done, 1 lost
    value REAL,               -- the metric; NULL where lost
    delta BLOB NOT NULL,      -- normalised Delta, float64, see worst_case_analysis.batched_members.encoded
    seconds REAL NOT NULL,
    reason TEXT               -- why the sample is lost
)""",
)


@dataclass(frozen=True)
class Sample:
    """A row: index, status (DONE or LOST), value (NaN where lost), Delta as numbers, reason."""

    index: int
    status: int
    value: float
    delta: bytes
    reason: str

    @property
    def numbers(self) -> Array:
        """Delta as coordinates for `robustlab.worst_case_analysis.batched_members.decoded`."""
        return np.frombuffer(self.delta, dtype="<f8").astype(np.float64)


class Store:
    """An open store; use `create`, `open` and `close`."""

    def __init__(self, path: Path, db: sqlite3.Connection) -> None:
        self.path, self._db = path, db
        self.where = str(path)

    # --- opening and closing -----------------------------------------------------------------------------------------

    @staticmethod
    def exists(path: Path) -> bool:
        """Return True for a file with content; a process killed at its start leaves 0 bytes."""
        return path.is_file() and path.stat().st_size > 0

    @classmethod
    def delete(cls, path: Path) -> None:
        """Delete a store and its SQLite side files, also if damaged, but never another type of file."""
        if cls.exists(path):
            _check_file(path)
        try:
            for suffix in ("", "-wal", "-shm", "-journal"):
                path.with_name(path.name + suffix).unlink(missing_ok=True)
        except OSError as error:
            raise EnvironmentFault(str(path), f"cannot be replaced ({error.strerror or error})") from None

    @classmethod
    def create(cls, path: Path, uncertain: UncertainModel, settings: CampaignSettings) -> Store:
        """Create the store of a campaign atomically."""
        identity = Identity.of(uncertain, settings)
        with _named(path):
            db = sqlite3.connect(path, isolation_level=None)
            store, numbers = cls(path, db), (f"application_id={APPLICATION_ID}", f"user_version={FORMAT_VERSION}")
            for statement in ("BEGIN IMMEDIATE", *(f"PRAGMA {number}" for number in numbers), *_TABLES):
                db.execute(statement)
            store.put("identity", json.dumps(identity.to_json(), sort_keys=True))
            store.put("hash", identity.hash)
            store.put("model", model_to_bytes(uncertain))
            db.execute("COMMIT")
            store._write_ahead()
        return store

    @classmethod
    def open(cls, path: Path, *, write: bool = False) -> Store:
        """Open the store of an earlier campaign, checked page by page."""
        _check_file(path)
        with _named(path):
            mode = "rw" if write else "ro"
            db = sqlite3.connect(f"{path.absolute().as_uri()}?mode={mode}", uri=True, isolation_level=None, timeout=10)
            store = cls(path, db)
            try:
                store._check()
                if write:
                    store._write_ahead()
            except BaseException:
                db.close()
                raise
        return store

    def _write_ahead(self) -> None:
        self._db.execute("PRAGMA journal_mode=WAL")
        self._db.execute("PRAGMA synchronous=FULL")

    def _check(self) -> None:
        (version,) = self._db.execute("PRAGMA user_version").fetchone()
        if version > FORMAT_VERSION:
            found = f"written by store version {version}, this robustlab reads <= {FORMAT_VERSION}; upgrade"
            raise InputError(self.where, found, None, "pip install --upgrade robustlab")
        (verdict,) = self._db.execute("PRAGMA quick_check(1)").fetchone()
        if verdict != "ok":
            raise _damaged(self.where, str(verdict).splitlines()[-1])
        try:
            intact = self.identity.hash == self.get("hash")
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            raise _damaged(self.where, f"its settings cannot be read ({error})") from None
        if not intact:
            raise _damaged(self.where, "its settings do not match their hash")

    def close(self, *, finished: bool = False) -> None:
        """Close the store; a finished one becomes a single file that can be read from a read-only folder."""
        try:
            if finished:
                self._db.execute("PRAGMA journal_mode=DELETE")
        except sqlite3.Error:
            pass  # another process reads it: the write-ahead file remains, and nothing is lost
        finally:
            self._db.close()

    # --- campaign ----------------------------------------------------------------------------------------------------

    def put(self, name: str, value: str | bytes) -> None:
        with _named(self.path):
            self._db.execute("INSERT OR REPLACE INTO campaign VALUES (?, ?)", (name, value))

    def get(self, name: str) -> Any:
        return next(self._asked("SELECT value FROM campaign WHERE name = ?", name), (None,))[0]

    @property
    def identity(self) -> Identity:
        return Identity.from_json(json.loads(self.get("identity")))

    def facts(self) -> dict[str, Any]:
        """Return the facts stored at the end of the campaign: digest, check of the worst sample; empty before."""
        return json.loads(self.get("finished") or "{}")

    # --- samples -----------------------------------------------------------------------------------------------------

    def save(self, rows: Rows) -> None:
        values, columns = (
            list[tuple[Any, ...]](),
            (rows.values.tolist(), rows.deltas.astype("<f8"), rows.seconds.tolist()),
        )
        for index, (value, delta, seconds) in enumerate(zip(*columns, strict=True), rows.first):
            reason = rows.lost.get(index)
            status, number = (DONE, value) if reason is None else (LOST, None)
            values.append((index, status, number, delta.tobytes(), seconds, reason))
        with _named(self.path), self._db:  # commits, or rolls back on an error
            self._db.execute("BEGIN IMMEDIATE")
            self._db.executemany("INSERT OR REPLACE INTO sample VALUES (?, ?, ?, ?, ?, ?)", values)

    def missing(self, n: int) -> list[tuple[int, int]]:
        """Return gaps ``(first, last)`` in 0 .. n - 1, each without its last index."""
        gaps, expected = [], 0
        for (index,) in self._asked("SELECT idx FROM sample WHERE idx BETWEEN 0 AND ? ORDER BY idx", n - 1):
            if index > expected:
                gaps.append((expected, index))
            expected = index + 1
        return [*gaps, (expected, n)] if expected < n else gaps

    def counts(self) -> tuple[int, int]:
        """Return the numbers of samples with a value and of lost ones."""
        found = dict(self._asked("SELECT status, COUNT(*) FROM sample GROUP BY status"))
        return found.get(DONE, 0), found.get(LOST, 0)

    def lost(self, most: int) -> list[Sample]:
        return list(self.samples("WHERE status = ? ORDER BY idx LIMIT ?", LOST, most))

    def worst(self, sense: int) -> Sample | None:
        """Return the first sample with the largest ``sense * value``."""
        return next(self.samples("WHERE status = ? ORDER BY value * ? DESC, idx LIMIT 1", DONE, sense), None)

    def totals(self, sense: int, limit: float | None) -> tuple[int, int, float]:
        """Return the numbers of infinite values and of those worse than ``limit``, and the time of all samples in s."""
        question = "SELECT TOTAL(abs(value) = ?), TOTAL(value * ? > ?), TOTAL(seconds) FROM sample"
        worse = None if limit is None else sense * limit
        unbounded, beyond, seconds = next(self._asked(question, np.inf, sense, worse))
        return int(unbounded), int(beyond), seconds

    def digest(self) -> str:
        """Return SHA-256 over index, status, value, Delta and reason of all rows by index."""
        digest = hashlib.sha256()
        for row in self.samples():
            digest.update(struct.pack("<qBd", row.index, row.status, row.value if row.status == DONE else np.nan))
            reason = row.reason.encode()
            digest.update(row.delta + struct.pack("<q", len(reason)) + reason)
        return digest.hexdigest()

    def samples(self, condition: str = "ORDER BY idx", *values: Any) -> Iterator[Sample]:
        """Stream rows, all by index where no condition is given."""
        question = f"SELECT idx, status, value, delta, reason FROM sample {condition}"  # noqa: S608  our own texts
        for index, status, value, delta, reason in self._asked(question, *values):
            yield Sample(index, status, np.nan if value is None else value, delta, reason or "")

    def _asked(self, question: str, *values: Any) -> Iterator[Any]:
        with _named(self.path):
            yield from self._db.execute(question, values)


def _check_file(path: Path) -> None:
    from robustlab.files.file_types import require_file

    head = require_file(path)
    if not head.startswith(MAGIC):
        raise InputError(str(path), f"not a campaign store (first bytes {head[:4].hex(' ')})", "an SQLite file", NEW)
    if head[68:72] != APPLICATION_ID.to_bytes(4, "big"):  # application ID in SQLite's header
        raise InputError(str(path), "an SQLite file, but no campaign of robustlab", "a campaign store", NEW)


@contextmanager
def _named(path: Path) -> Iterator[None]:
    """Convert errors of SQLite to errors with the file's name."""
    try:
        yield
    except sqlite3.Error as error:
        # "no such table" is also an OperationalError, but of a damaged file.
        if isinstance(error, sqlite3.OperationalError) and "no such" not in str(error):
            raise EnvironmentFault(str(path), f"{error}; the samples saved before are kept") from error
        raise _damaged(str(path), str(error)) from error


def _damaged(where: str, what: str) -> InputError:
    hint = "copy it again from a backup, or start with --restart"
    return InputError(where, f"damaged campaign store: {what}", None, hint)


@contextmanager
def locked(path: Path) -> Iterator[None]:
    """Hold the lock ``NAME.lock`` of a store; it ends with its process."""
    from filelock import FileLock, Timeout

    folder = path.absolute().parent
    where, expected, lock = str(path), "a folder that can be written", FileLock(f"{path}.lock", timeout=0)
    if not folder.is_dir():  # the lock would create it
        raise EnvironmentFault(where, f"no such folder {folder}", expected)
    try:
        lock.acquire()
    except Timeout:
        raise EnvironmentFault(where, "locked by another run", None, "wait for it, or stop it") from None
    except (OSError, NotImplementedError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise EnvironmentFault(where, f"cannot be locked: {reason}", expected) from None
    try:
        yield
    finally:
        lock.release()
