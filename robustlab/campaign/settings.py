"""Settings of a campaign, and its identity: model, settings, code."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import cache
from importlib import metadata
from io import BytesIO
from pathlib import Path
from typing import Any, Literal

import numpy as np

from robustlab.errors import InputError, UsageError, did_you_mean
from robustlab.files.isolation import receive, send_tree
from robustlab.files.tree import Tree, canonical, content_sha256
from robustlab.provenance import robustlab_version
from robustlab.storage.codecs import decode_uncertain, encode_uncertain
from robustlab.storage.matrices import Problems
from robustlab.uncertainty.lft import UncertainModel

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
    # output, input: signals of the metric
    output: str | None = None
    input: str | None = None
    # Input name -> number, or samples on the times; a unit step where omitted.
    u: Mapping[str, float | Sequence[float]] | None = None
    # t_end, points: end time in s and number of times; from the nominal poles where `t_end` is omitted
    t_end: float | None = None
    points: int = 401
    hold: Literal["zoh", "foh"] = "zoh"  # input between samples
    starts: int = 64  # for searches: number of first Sobol points
    band: float = 0.02  # share of the final value that counts as settled

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            raise UsageError(
                "campaign", f"kind {self.kind!r}", f"one of {', '.join(KINDS)}", did_you_mean(self.kind, KINDS)
            )
        for name, low, high in (("n", 1, MAX_SAMPLES), ("seed", 0, 2**63), ("points", 2, 10**6), ("starts", 1, 10**6)):
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= high:
                raise InputError("campaign", f"{name} is {value!r}", f"a whole number from {low} to {high}")
        if self.t_end is not None and not 0 < self.t_end < float("inf"):
            raise InputError("campaign", f"t_end is {self.t_end!r}", "a positive number of seconds")

    def to_json(self) -> dict[str, Any]:
        data = asdict(self)
        if self.u is not None:
            data["u"] = {name: np.asarray(value, dtype=float).tolist() for name, value in self.u.items()}
        return data


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
        """SHA-256 over all three parts."""
        return hashlib.sha256(json.dumps(self.to_json(), sort_keys=True).encode()).hexdigest()

    def to_json(self) -> dict[str, Any]:
        return {"model": self.model, "settings": self.settings.to_json(), "code": dict(self.code)}

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> Identity:
        """Inverse of `to_json`."""
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
