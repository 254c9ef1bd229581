"""Compares the numbers that a file displays with those that its claims prove.

The digest, an attribute of the group of claims, is the content hash of the rest of the file: names, units, signs,
sample times, shapes, status, every number. In addition the main numbers of each kind of result (`SHOWN`) are compared
with the proved ones, so a recomputed digest cannot hide a changed number.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from robustlab.errors import InputError
from robustlab.files.hdf5 import read_tree
from robustlab.files.tree import (
    Dataset,
    Tree,
    Unread,
    check_header,
    digest_beside_claims,
    is_stamped,
    signal_name,
    text_attr,
)
from robustlab.verification.balls import PRECISIONS, precision
from robustlab.verification.checker import KINDS
from robustlab.verification.claim import Claim, Outcome, Verification
from robustlab.verification.models import gain_exceeds, model_of
from robustlab.verification.mu import ALLOWANCE


def claims_in_file(path: str | Path) -> list[Claim]:
    """Read the claims in the groups ``claims/0``, ``claims/1``, ... of an HDF5 file, by a kind and datasets each."""
    return claims_in(read_checked(path))


def read_checked(path: str | Path) -> Tree:
    """Read a file. Raises InputError: no HDF5 file, or a format 1 file with a wrong header or content hash."""
    root = read_tree(path)
    if is_stamped(root):
        check_header(root)
    return root


def claims_in(root: Tree) -> list[Claim]:
    """Return the claims of a file, in their order. Raises InputError: an invalid claim."""
    node = root.find("claims")
    if node is None:
        return []
    names = sorted(node.groups, key=lambda name: (int(name) if name.isdigit() else len(name), name))
    return [_claim(node.groups[name]) for name in names]


def _claim(node: Tree) -> Claim:
    kind, numbers = np.asarray(node.attrs.get("claim", "")), dict[str, Any]()
    if kind.ndim != 0 or not str(kind):
        raise InputError(node.file, f"{node.path}: no attribute claim", "the kind of the claim")
    for name, dataset in node.datasets.items():
        if isinstance(dataset.values, Unread):
            raise InputError(node.file, f"{node.child_path(name)} has dtype {dataset.values.dtype}", "numbers")
        numbers[name] = dataset.values
    return Claim(str(kind), numbers)


ROUNDING = 2e-6  # relative: claims are made 1e-6 above the computed number

# Displayed number -> the quantity of a claim that it must equal. "peak": the bound of a norm, a gain or mu, and
# "1/peak" the margin from it; "h2": of an H2 norm; "attained": a lower bound of mu; "inside": a norm of at most one, or
# parameters within their ranges; "gain": a lower bound of the model's gain at the displayed frequency. Braces: the
# model of that name in a claim, to the last bit, with "+" a part of it.
Rules = Mapping[str, str]
GAIN: Rules = {"upper": "peak"}
MARGIN: Rules = {"lower": "1/peak"}
MARGIN_FOUND: Rules = {**MARGIN, "upper": "1/attained"}
DESIGN: Rules = {"gamma": "peak", "K": "K_{}"}
H2_DESIGN: Rules = {"gamma": "h2", "K": "K_{}"}
ANY = "peak h2 1/peak"
SHOWN: Mapping[str, Rules] = {
    "HinfNorm": {**GAIN, "lower": "gain", "value": "gain"},
    **dict.fromkeys(("WorstCaseGain", "DelayGain", "IqcGain", "LPVGain"), GAIN),
    **dict.fromkeys(("DiskMargin", "DiskMargins", "DelayStability"), MARGIN),
    "CoprimeMargin": {**MARGIN, "value": "1/peak"},
    "IqcStability": {**MARGIN, "margin": "1/peak"},
    **dict.fromkeys(("Margin", "PerformanceMargin"), MARGIN_FOUND),
    **dict.fromkeys(("HinfSynthesis", "NcfSynthesis", "DKSynthesis"), DESIGN),
    **dict.fromkeys(("H2Synthesis", "LqgSynthesis"), H2_DESIGN),
    "MixedSynthesis": {**H2_DESIGN, "hinf_norm/upper": "peak"},
    "ReducedController": {**DESIGN, "gamma": ANY},
    "FixedSynthesis": {**DESIGN, "gamma": ANY},
    "TunedSynthesis": {**DESIGN, "gamma": ANY, "goals/*/value": ANY},
    "LPVSynthesis": {"gamma": "peak"},
    "H2Norm": {"value": "h2"},
    "MuBounds": {"upper": "peak", "lower": "attained"},
    "ReducedModel": {"error/upper": "peak", "model": "{}2 K_{}+"},
    "BuiltModel": {"M": "{}"},
    "Cover": {"sizes": "inside"},
    "AntiWindup": {"proved/upper": "peak", "controller": "K_{}+"},
}  # fmt: skip
CONTROLLER: Rules = {"gamma": ANY, "": "K_{}"}
MODELS = ("norm", "bounded-real", "loop-norm", "difference-norm", "mu-axis")  # claims about one model's gain
PATTERNS = ("{}", "K_{}", "P_{}", "W_{}", "{}0", "{}1", "{}2")  # of the models in claims
TRIVIAL = {"peak": math.inf, "h2": math.inf, "1/attained": math.inf, "1/peak": 0.0, "attained": 0.0, "gain": 0.0}


def displayed(
    root: Tree, claims: Sequence[Claim], found: Sequence[Verification]
) -> tuple[list[Verification], list[str], list[str]]:
    """Return the verdicts on the digest and on each main number of the file; its other numbers; remarks.

    ``claims``, ``found``: the claims of the file and their verifications; only those that were proved count.
    """
    proved = [claim for claim, one in zip(claims, found, strict=True) if one.outcome is Outcome.PROVED]
    controller = text_attr(root.attrs, "kind") == "controller"
    top = root if controller else root.groups.get("data", Tree(path="/data"))
    kind = "controller" if controller else text_attr(root.attrs, "type") or ""
    rules = CONTROLLER if controller else SHOWN.get(kind, {})
    rows = [_digest(root)]
    if not rules:
        rows.append(_row(f"no claim covers a file of kind {kind!r}", False))
    covered: set[str] = set()
    for path, rule in rules.items():
        places = dict(places_at(top, path))
        if not places and not controller:
            rows.append(_row(f"{top.path}/{path} is missing", False))
        for place, thing in places.items():
            rows += _compared(place, thing, rule, proved, top)
            covered |= _numbers_of(place, thing)
    for _, part in top.walk():  # results and models within the result are no main numbers, but may be proved
        if isinstance(part, Tree):
            for path, rule in SHOWN.get(_type(part), {}).items():
                places = dict(places_at(part, path))
                for place, thing in places.items():
                    if all(row.outcome is Outcome.PROVED for row in _compared(place, thing, rule, proved, part)):
                        covered |= _numbers_of(place, thing)
            if "A" in part.datasets and any(_same(part, pattern, proved) for pattern in PATTERNS):
                covered |= _numbers_of(part.path, part)
    unstamped = [] if "content_sha256" in root.attrs else ["the file carries no content_sha256"]
    return rows, _others(top, covered), unstamped


def _row(text: str, good: bool) -> Verification:
    return Verification(text, Outcome.PROVED if good else Outcome.NOT_PROVED, None, "", 0)


def _digest(root: Tree) -> Verification:
    digest = text_attr(root.groups["claims"].attrs, "content_sha256")
    if digest is None:
        return _row("the claims carry no digest of the file, as in files of earlier versions: names, units, signs, "
                    "sample times, status and other numbers are not bound to them", False)  # fmt: skip
    if digest != digest_beside_claims(root):
        return _row("the file was changed after its claims were written: their digest of it does not match", False)
    return _row("the rest of the file is, to the last bit, what the claims were written with", True)


def places_at(node: Tree, path: str) -> Iterator[tuple[str, Dataset | Tree]]:
    """Yield the items at a path, with their full paths; ``*`` is any group, an attribute counts as a number."""
    first, _, rest = path.partition("/")
    if not first:
        yield node.path, node
    elif first == "*":
        for group in node.groups.values():
            yield from places_at(group, rest)
    elif first in node.groups:
        yield from places_at(node.groups[first], rest)
    elif first in node.datasets:
        yield node.child_path(first), node.datasets[first]
    elif first in node.attrs:
        yield node.child_path(first), Dataset(np.asarray(node.attrs[first]))


def _numbers_of(place: str, thing: Dataset | Tree) -> set[str]:
    """Return the path of a number, or those of a model's numbers."""
    return {thing.child_path(name) for name in ("A", "B", "C", "D", "dt")} if isinstance(thing, Tree) else {place}


def _type(node: Tree) -> str:
    name = node.datasets.get("type")
    return str(name.values) if name is not None and not isinstance(name.values, Unread) else ""


def _compared(place: str, thing: Dataset | Tree, rule: str, proved: Sequence[Claim], near: Tree) -> list[Verification]:
    """Return a row for each number, or for the model, compared with the claims; ``near``: the result that has it."""
    place = signal_name(place).strip("/") or "the controller"
    if isinstance(thing, Tree):
        same = any(_same(thing, pattern, proved) for pattern in rule.split() if "{" in pattern)
        return [_row(f"{place} is {'the' if same else 'not the'} model of a claim that was proved", same)]
    if isinstance(thing.values, Unread) or thing.values.dtype.kind not in "fi" or not thing.values.size or "{" in rule:
        return [_row(f"{place} is not what the claims prove: a {'model' if '{' in rule else 'number'}", False)]
    values = np.ravel(thing.values).tolist()
    names = [place] if len(values) == 1 else [f"{place}[{i}]" for i in range(len(values))]
    known = [v for word in rule.split() for claim in proved for v in _quantity(claim, word)]
    if rule == "gain":
        at = near.datasets.get("frequency", Dataset(np.array("")))
        below = [v * (1 - ROUNDING / 2) for v in values]
        known = [v for v in below if any(_reached(claim, at.values, v) for claim in proved if claim.kind in MODELS)]
    return [_number(name, float(x), rule.split(maxsplit=1)[0], known) for name, x in zip(names, values, strict=True)]


def _number(name: str, x: float, word: str, known: Sequence[float]) -> Verification:
    if x == TRIVIAL.get(word):
        return _row(f"{name} is {x:.9g}, a trivial bound", True)
    wanted = max(x, 1.0) if word == "inside" else x
    if not known:
        return _row(f"{name} is {x:.9g}, and no proved claim contains it", False)
    near = min(known, key=lambda v: abs(v - wanted) if v != wanted else -1.0)
    return _row(f"{name} is {x:.9g}, the claim proves {near:.9g}", near == wanted or
                abs(near - wanted) <= ROUNDING * abs(wanted) < math.inf)  # fmt: skip


def _quantity(claim: Claim, word: str) -> list[float]:
    """Return the numbers of a claim for a word of `Rules`."""
    number, below = KINDS[claim.kind].number, KINDS[claim.kind].below
    values = np.ravel(claim.numbers[number]).tolist() if number else []
    if word.startswith("1/"):
        return [1 / v if v else math.inf for v in _quantity(claim, word[2:])]
    if word == "h2":
        return values if number == "value" else []
    if word == "attained":
        return [1 / max(_sizes(claim))] if claim.kind == "unstable-member" else values if below else []
    if word == "inside":
        return [1.0] if claim.kind == "set" and "delta" in claim.numbers else values
    if claim.kind in ("stable", "delayed-stable"):
        return [0.0]  # nothing is uncertain
    return [1 / v for v in values] if number == "size" else values if number in ("gamma", "level") and not below else []


def _reached(claim: Claim, frequency: Any, level: float) -> bool:
    """Prove that the gain of the claim's model at a frequency (rad/s, a number) is at least this level."""
    if np.shape(frequency) != () or np.asarray(frequency).dtype.kind != "f" or not frequency >= 0 or not level > 0:
        return False
    with precision(PRECISIONS[1]):
        return gain_exceeds(model_of(claim), float(frequency), level)


def _sizes(claim: Claim) -> list[float]:
    """Return the allowed size of each block of a Delta, relative to its range where that is not -1 to 1."""
    blocks, ranges = claim.numbers["blocks"], np.asarray(claim.numbers.get("ranges", 0.0))
    sizes = [ALLOWANCE / level for level in np.broadcast_to(claim.numbers["level"], len(blocks)).tolist()]
    if ranges.shape != (len(blocks), 2) or ranges.dtype.kind != "f":
        return sizes
    at = 0
    for i, (kind, rows, _) in enumerate(blocks.tolist()):
        if kind == 0:
            end = abs(float(ranges[i, int(claim.numbers["delta"][at, at].real > 0)]))
            sizes[i] = sizes[i] / end if end else math.inf
        at += rows
    return sizes


def _same(node: Tree, pattern: str, claims: Sequence[Claim]) -> bool:
    """Test whether a claim has the model in this group under the pattern's names, dt included."""
    own: dict[str, Any] = {letter: node.datasets[letter].values for letter in "ABCD" if letter in node.datasets}
    dt: Any = node.datasets["dt"].values if "dt" in node.datasets else node.attrs.get("dt", 0.0)
    if len(own) < 4 or any(isinstance(X, Unread) or X.ndim != 2 for X in own.values()):
        return False
    for claim in claims:
        named: list[Any] = [claim.numbers.get(pattern.rstrip("+").format(letter)) for letter in "ABCD"]
        if all(X is not None and X.ndim == 2 for X in named) and np.array_equal(dt, claim.numbers.get("dt", dt)):
            found = _in_parts(own, named) if pattern.endswith("+") else map(np.array_equal, own.values(), named)
            if all(found):
                return True
    return False


def _in_parts(own: Mapping[str, Any], named: Sequence[Any]) -> Iterator[bool]:
    """Test whether a model is a block of a larger one, with consecutive states, inputs and outputs."""
    n, (p, m), (N, (P, M)) = len(own["A"]), own["D"].shape, (len(named[0]), named[3].shape)
    places = [(slice(i, i + n), slice(j, j + m), slice(k, k + p))
              for i in range(N - n + 1) for j in range(M - m + 1) for k in range(P - p + 1)]  # fmt: skip
    A, B, C, D = named
    yield any(all(map(np.array_equal, own.values(), (A[x, x], B[x, u], C[y, x], D[y, u]))) for x, u, y in places)


def _others(node: Tree, covered: set[str], above: str = "") -> list[str]:
    """Return the names of numbers that are not covered; a group without any covered one has one name."""
    names = [f"{above}{signal_name(link)}" for link, dataset in node.datasets.items()
            if _is_number(dataset) and node.child_path(link) not in covered]  # fmt: skip
    for link, group in node.groups.items():
        name = f"{above}{signal_name(link)}"
        if any(path.startswith(f"{group.path}/") for path in covered):
            names += _others(group, covered, f"{name}/")
        elif group.path not in ("/claims", "/provenance") and any(map(_is_number, dict(group.walk()).values())):
            names.append(name)
    return names


def _is_number(thing: Dataset | Tree) -> bool:
    return isinstance(thing, Dataset) and not isinstance(thing.values, Unread) and thing.values.dtype.kind in "fibc"
