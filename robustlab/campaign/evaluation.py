"""Settings and identity (model, settings, code) of a campaign, and the value of sample i as a pure function of these.

Samples are computed in fixed tiles: members of a tile share their scaling.
"""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from functools import cache
from importlib import metadata
from io import BytesIO
from pathlib import Path
from typing import Any, Literal

import numpy as np

from robustlab import checks
from robustlab.arrays import Array
from robustlab.budget import one_thread
from robustlab.errors import EnvironmentFault, InputError, NoTrustworthyNumber, UsageError, did_you_mean, plain_text
from robustlab.files.isolation import receive, send_tree
from robustlab.files.tree import Tree, canonical, content_sha256
from robustlab.provenance import robustlab_version
from robustlab.storage.codecs import decode_uncertain, encode_uncertain
from robustlab.storage.matrices import Problems
from robustlab.uncertainty.lft import UncertainModel
from robustlab.worst_case_analysis.batched_members import Deltas, delta_of_sample, encoded
from robustlab.worst_case_analysis.metrics import make_metric
from robustlab.worst_case_analysis.worst_case_search import worst_case

KINDS = ("samples", "vertices", "search")
MAX_SAMPLES = 10**12

# Sources that determine a sample's value; changes elsewhere (reports, commands) keep stored samples valid.
_CODE = (
    "campaign/evaluation.py",
    "dynamics/simulation.py",
    "linear_analysis",
    "norms",
    "statespace.py",
    "uncertainty",
    "worst_case_analysis",
)
DONE, LOST = 0, 1
TILE = 64  # samples in a tile; it affects the last digits of a value
TILE_WORK = 2e9  # approximate operations in a tile: a large model has smaller tiles, so that a kill loses little
UNLIMITED_EFFORT = 1e9  # effort with which a search ends only when nothing improves


@dataclass(frozen=True)
class CampaignSettings:
    """Settings of the samples 0 .. n - 1."""

    metric: str  # a metric of `robustlab.worst_case_analysis.worst_case`
    n: int  # number of samples, vertices, or searches
    # `"samples"`: random members, drawn as `robustlab.worst_case_analysis.sample` draws them. `"vertices"`: every
    # real delta is -1 or +1; index i is the i-th vertex of all, or a random one where there are more than n.
    # `"search"`: index i is one whole worst-case search from starting points of its own.
    kind: Literal["samples", "vertices", "search"] = "samples"
    seed: int = 0  # seed of the random numbers; index i draws from `SeedSequence(seed, spawn_key=(i,))`
    output: str | None = None  # signals of the metric
    input: str | None = None
    u: Mapping[str, float | Sequence[float]] | None = (
        None  # input -> number, or samples on the times; default: unit step
    )
    t_end: float | None = None  # end time in s; from the nominal poles where omitted
    points: int = 401  # number of times
    hold: Literal["zoh", "foh"] = "zoh"  # input between samples
    starts: int = 64  # for searches: number of first points
    band: float = 0.02  # share of the final value that counts as settled

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            expected = f"one of {', '.join(KINDS)}"
            raise UsageError("campaign", f"kind {self.kind!r}", expected, did_you_mean(self.kind, KINDS))
        for name, low, high in (("n", 1, MAX_SAMPLES), ("seed", 0, 2**63), ("points", 2, 10**6), ("starts", 1, 10**6)):
            checks.whole(f"campaign: {name}", getattr(self, name), low, high)
        if self.t_end is not None:
            checks.number("campaign: t_end", self.t_end, "a positive number of seconds", above=0)

    def to_json(self) -> dict[str, Any]:
        u = {name: np.asarray(value, dtype=float).tolist() for name, value in (self.u or {}).items()}
        return {**asdict(self), "u": None if self.u is None else u}


@dataclass(frozen=True)
class Identity:
    """Identity of a campaign; two campaigns with equal identities have equal samples."""

    model: str  # SHA-256 of the uncertain model's content
    settings: CampaignSettings
    code: Mapping[str, str]  # versions and source hash of the code; see `code_identity`

    @classmethod
    def of(cls, uncertain: UncertainModel, settings: CampaignSettings) -> Identity:
        """Return the identity of a campaign with the installed code."""
        return cls(content_sha256(_tree(uncertain)), settings, code_identity())

    @property
    def hash(self) -> str:
        return hashlib.sha256(json.dumps(self.to_json(), sort_keys=True).encode()).hexdigest()

    def to_json(self) -> dict[str, Any]:
        return {"model": self.model, "settings": self.settings.to_json(), "code": dict(self.code)}

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> Identity:
        return cls(data["model"], CampaignSettings(**data["settings"]), data["code"])


def differences(old: Identity, new: Identity) -> list[str]:
    """Return the changes from ``old`` to ``new``, one line each."""
    lines = [] if old.model == new.model else [f"the uncertain model: {old.model[:12]} -> {new.model[:12]}"]
    for part in ("settings", "code"):
        before, after = old.to_json()[part], new.to_json()[part]
        for name in dict.fromkeys([*before, *after]):
            values = before.get(name), after.get(name)
            if values[0] != values[1]:
                texts = ("none" if value is None else str(value) for value in values)
                lines.append(f"{part}.{name}: {' -> '.join(t if len(t) <= 60 else f'{t[:57]}...' for t in texts)}")
    return lines


@cache
def code_identity() -> dict[str, str]:
    """Return versions of robustlab, numpy and scipy, and a hash over the sources that determine a sample's value."""
    root = Path(__file__).resolve().parents[1]
    digest = hashlib.sha256()
    for name in _CODE:
        place = root / name
        for file in sorted(place.rglob("*.py")) if place.is_dir() else [place]:
            digest.update(file.relative_to(root).as_posix().encode() + b"\0" + file.read_bytes() + b"\0")
    versions = {name: metadata.version(name) for name in ("numpy", "scipy")}
    return {"robustlab": robustlab_version(), **versions, "sources": digest.hexdigest()[:16]}


def model_to_bytes(uncertain: UncertainModel) -> bytes:
    """Serialise the model for the store and for workers: a JSON header and plain arrays, no pickle."""
    stream = BytesIO()
    send_tree(stream, _tree(uncertain))
    return stream.getvalue()


def model_from_bytes(data: bytes, where: str) -> UncertainModel:
    """Inverse of `model_to_bytes`. Raises InputError: the bytes are no uncertain model."""
    try:
        return decode_uncertain(receive(BytesIO(data), where), Problems(where))
    except (ValueError, KeyError, TypeError, EOFError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(where, f"the model in it cannot be read ({error})") from None


def _tree(uncertain: UncertainModel) -> Tree:
    if not isinstance(uncertain, UncertainModel):
        raise InputError("campaign", type(uncertain).__name__, "an UncertainModel")
    tree = Tree(file="campaign")
    encode_uncertain(tree, uncertain)
    for _, item in tree.walk():
        item.attrs.update({name: canonical(value, tree.file) for name, value in item.attrs.items()})
    return tree


# --- samples ----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Rows:
    """Consecutive samples from a worker."""

    first: int  # index of the first one
    values: Array  # the metric, shape (k,); NaN where a sample is lost
    deltas: Array  # normalised Deltas, shape (k, width); see `robustlab.worst_case_analysis.batched_members.encoded`
    seconds: Array  # time each one took, shape (k,); samples computed together share their time evenly
    lost: Mapping[int, str] = field(default_factory=dict)  # index -> reason, for samples without a value


class Evaluator:
    """Computes the samples of one campaign."""

    def __init__(self, uncertain: UncertainModel, settings: CampaignSettings) -> None:
        self.uncertain, self.settings = uncertain, settings
        s, t = settings, None
        if s.t_end is not None:
            dt = uncertain.dt
            t = dt * np.arange(max(2, round(s.t_end / dt) + 1)) if dt else np.linspace(0.0, s.t_end, s.points)
        self._asked: dict[str, Any] = {
            "metric": s.metric, "output": s.output, "input": s.input, "t": t, "u": s.u, "hold": s.hold, "band": s.band,
        }  # fmt: skip
        self.metric = make_metric(uncertain, **self._asked, where="campaign")
        n = self.metric.uncertain.M.n_states
        work = (n + 1) ** 2 * (s.points + 100 + 30 * n)
        # The samples per tile depend on the campaign alone, not on the machine.
        self.tile = 1 if s.kind == "search" else max(1, min(TILE, int(TILE_WORK / work)))
        self.sense = 1 if self.metric.sense > 0 else -1  # -1 where the smallest value of the metric is the worst

    def _theta(self, first: int, last: int) -> Array:
        """Return the coordinates of samples (k, width).

        A vertex of the real deltas has the binary digits of its index; it is random if not all vertices are requested.
        """
        blocks, seed = self.uncertain.blocks, self.settings.seed
        if self.settings.kind == "search":
            return np.zeros((last - first, self.metric.set.size))
        if self.settings.kind == "samples":
            return Deltas(blocks, last, seed).numbers(slice(first, last))
        found, reals = [], [block.name for block in blocks if block.interval]
        for index in range(first, last):
            if 2 ** len(reals) <= self.settings.n:
                bits = index >> np.arange(len(reals))[::-1] & 1
            else:
                rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(index, 2)))
                bits = rng.integers(0, 2, len(reals))
            signs = dict(zip(reals, (2.0 * bits - 1.0).tolist(), strict=True))
            found.append(encoded(blocks, delta_of_sample(blocks, seed, index, boundary=True) | signs))
        return np.array(found)

    def rows(self, first: int, last: int) -> Rows:
        """Compute samples ``first .. last - 1`` below n, multiples of the tile; a failed tile sample by sample."""
        theta, count, lost = self._theta(first, last), min(last, self.settings.n) - first, dict[int, str]()
        values, seconds = np.full((2, last - first), np.nan)
        for start in range(0, last - first, self.tile):
            part, started = slice(start, start + self.tile), time.perf_counter()
            if self.tile > 1:
                try:
                    values[part] = self._values(theta[part])
                except Exception:  # noqa: BLE001  one sample fails the tile; it is found below
                    values[part] = np.nan
            if np.isnan(values[part]).any():
                for k in range(start, min(start + self.tile, count)):
                    values[k], theta[k], reason = self._alone(first + k, theta[k])
                    lost |= {first + k: reason} if reason else {}
            seconds[part] = (time.perf_counter() - started) / self.tile
        return Rows(first, values[:count], theta[:count], seconds[:count], lost)

    def _alone(self, index: int, theta: Array) -> tuple[float, Array, str]:
        """Compute the value and coordinates of one sample; its exception becomes the reason of a lost sample."""
        try:
            if self.settings.kind == "search":
                value, delta = self._search(index)
                return value, encoded(self.uncertain.blocks, delta), ""
            value = float(self._values(theta[None])[0])
        except Exception as error:  # noqa: BLE001  any failure concerns this sample alone
            return np.nan, theta, plain_text(f"{type(error).__name__}: {error}")[:500]
        return value, theta, "the metric is not a number" if np.isnan(value) else ""

    def _values(self, theta: Array) -> Array:
        return self.metric.of(self.metric.set.members(theta))

    def _search(self, index: int) -> tuple[float, dict[str, Any]]:
        s = self.settings
        seed = int(np.random.SeedSequence(s.seed, spawn_key=(index, 3)).generate_state(2)[0])
        found = worst_case(self.uncertain, **self._asked, n=s.starts, seed=seed, effort=UNLIMITED_EFFORT)
        if not found.status.trustworthy:
            values = f"{found.search_value:.9g} found, {found.value:.9g} when evaluated again"
            raise NoTrustworthyNumber("search", f"{found.status}: {values}")
        return found.value, dict(found.delta)


_evaluators: dict[str, Evaluator] = {}  # of this process: that of its last campaign


def compute(identity: Identity, model: bytes, first: int, last: int) -> Rows:
    """Compute samples ``first .. last - 1`` in a worker."""
    if identity.hash not in _evaluators:
        changes = differences(identity, Identity(identity.model, identity.settings, code_identity()))
        if changes:
            raise EnvironmentFault("worker", f"runs other code: {changes[0]}", "the same versions on every machine")
        _evaluators.clear()
        _evaluators[identity.hash] = Evaluator(model_from_bytes(model, "campaign"), identity.settings)
    with one_thread():
        return _evaluators[identity.hash].rows(first, last)
