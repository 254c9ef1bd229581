"""Cases, conversion of their answers to plain numbers and words, and comparison of two answers.

An answer is a tree of mappings. Its leaves are compared by what they are:

- ``{"lower": .., "upper": ..}``, with or without other keys: a bracket. A later one must overlap it, and its gap, over
  its upper end, may be larger by 1e-3. The algorithm may change.
- A number: to the relative tolerance of its key in ``RTOLS`` of the subject, else to ``RTOL``, and never finer than
  three times the noise that was learned by running the case again.
- ``work``: a count of work, at most 1.3 times the recorded one.
- Words, verdicts, statuses, truth values, counts in text: exactly.
"""

import json
import math
import os
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

import robustlab as rl

HERE = Path(__file__).parent
ROOT = HERE.parents[1]
SHARED = ROOT.parent / "shared" / "data"
DATA = HERE / "data"
SUBJECTS = ("bounds", "margins", "models", "sets", "records", "files", "designs", "robust_designs", "campaign",
            "commands", "recipes", "naming")  # fmt: skip
# A longer list is stored as its length, its norm, its first and its last number.
LONG = 6
GAP = 1e-3
ATOL = 1e-12
WORK = 1.3


@dataclass(frozen=True)
class Case:
    """A named computation, ``run``.

    ``shared``: it needs the data next to the checkout; ``rtol``: the least tolerance of its numbers.
    """

    name: str
    run: Callable[[], Mapping[str, Any]]
    slow: bool = False
    shared: bool = False
    rtol: float = 0.0


def cases_of(subject: str) -> dict[str, Case]:
    """All cases of a subject by name; those that need data which are absent are left out."""
    return {case.name: case for case in import_module(f"characterisation.{subject}").cases()}


def answer(case: Case) -> tuple[dict[str, Any], float]:
    """Return the answer of a case and its CPU seconds; a refusal is an answer, too."""
    started = _spent()
    try:
        found = plain(case.run())
    except (rl.InputError, rl.NoTrustworthyNumber) as error:
        found = {"refused": "InputError" if isinstance(error, rl.InputError) else "NoTrustworthyNumber"}
    return found, round(_spent() - started, 2)


def _spent() -> float:
    """CPU seconds of this process and of its children that have ended."""
    return sum(os.times()[:4])


def plain(value: Any) -> Any:
    """Return a tree for JSON: long lists are summarised, numbers that are not finite become words."""
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple, np.ndarray)):
        items = np.asarray(value) if _numeric(value) else None
        if items is None:
            return {str(k): plain(item) for k, item in enumerate(value)}
        if items.size <= LONG:
            return {str(k): plain(item) for k, item in enumerate(items.ravel())}
        ends = {"first": plain(items.ravel()[0]), "last": plain(items.ravel()[-1])}
        return {"count": str(items.shape), "norm": plain(np.linalg.norm(items.ravel())), **ends}
    if isinstance(value, (bool, np.bool_)):
        return bool(value)
    if isinstance(value, (complex, np.complexfloating)):
        return {"re": plain(value.real), "im": plain(value.imag)}
    if isinstance(value, (int, float, np.number)):
        return float(value) if math.isfinite(value) else str(float(value))
    return value if value is None else str(value)


def _numeric(value: Any) -> bool:
    try:
        return np.asarray(value).dtype.kind in "fiuc" and np.asarray(value).size > 0
    except ValueError:  # rows of different lengths
        return False


def entry_of(case: Case, found: Any, cpu: float) -> dict[str, Any]:
    """A case as it is recorded."""
    return {"cpu": cpu, "slow": case.slow, "shared": case.shared, "rtol": case.rtol, "answer": found}


def stored(subject: str) -> dict[str, Any]:
    """Return the record of a subject: name of a case -> answer, noise, cpu, slow, shared."""
    path = DATA / f"{subject}.json"
    return json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}


def store(subject: str, entries: Mapping[str, Any]) -> None:
    """Write a subject's record, a case a line."""
    lines = [f"{json.dumps(name)}: {json.dumps(entry, ensure_ascii=False)}" for name, entry in entries.items()]
    (DATA / f"{subject}.json").write_text("{\n" + ",\n".join(lines) + "\n}\n", encoding="utf-8")


def leaves(tree: Any, at: str = "") -> Iterator[tuple[str, Any]]:
    """Dotted path and value of every leaf; a bracket is one leaf, a pair."""
    if not isinstance(tree, Mapping):
        yield at, tree
        return
    bracket = {"lower", "upper"} <= set(tree) and all(_number(tree[key]) is not None for key in ("lower", "upper"))
    if bracket:
        yield f"{at}.bracket".lstrip("."), (_number(tree["lower"]), _number(tree["upper"]))
    for key, item in tree.items():
        if not (bracket and key in ("lower", "upper")):
            yield from leaves(item, f"{at}.{key}".lstrip("."))


def _number(value: Any) -> float | None:
    if isinstance(value, bool) or value is None:
        return None
    if isinstance(value, (int, float)):
        return float(value)
    return float(value) if value in ("inf", "-inf") else None


def _same(key: str, old: Any, new: Any, rtol: float) -> bool:
    """Whether two numbers, or two brackets, are the same within a tolerance."""
    if key == "work":
        return new <= WORK * old
    if old == new:
        return True
    if isinstance(old, tuple):
        far = max((abs(x) for x in (*old, *new) if math.isfinite(x)), default=0.0)
        return max(new[0] - old[1], old[0] - new[1]) <= rtol * far + ATOL and _gap(new) <= _gap(old) + GAP
    return math.isfinite(old - new) and abs(old - new) <= rtol * max(abs(old), abs(new)) + (ATOL if rtol else 0.0)


def _gap(bracket: tuple[float, float]) -> float:
    low, high = bracket
    return 0.0 if low == high else 1.0 if math.isinf(high) else (high - low) / abs(high)


def differences(subject: str, entry: Mapping[str, Any], found: Any) -> dict[str, tuple[Any, Any]]:
    """Path -> (old, new) of every leaf of the record that is no longer so."""
    module = import_module(f"characterisation.{subject}")
    rtols: Mapping[str, float] = getattr(module, "RTOLS", {})
    now, wrong = dict(leaves(found)), {}
    for path, old in leaves(entry["answer"]):
        key, new = path.removesuffix(".bracket").rpartition(".")[2], now.get(path, "gone")
        pair = (old, new) if isinstance(old, tuple) and isinstance(new, tuple) else (_number(old), _number(new))
        if None in pair:
            same = old == new
        else:
            rtol = module.RTOL if isinstance(old, tuple) else rtols.get(key, module.RTOL)
            noise = 3 * entry.get("noise", {}).get(path, 0.0)
            same = _same(key, *pair, max(rtol, entry.get("rtol", 0.0), noise))
        if not same:
            wrong[path] = old, new
    return wrong


def seeds(*numbers: int) -> np.random.Generator:
    """A generator of a case's own."""
    return np.random.default_rng([2029, *numbers])


# Keys of the moment, and of what another method may choose otherwise: a critical member, coordinates, proofs.
MOMENT = """
seconds created elapsed origin file files path paths sha256 version command schema provenance evaluations_per host
python size
"""
CHOICE = """
delta physical pole intervals open shares D_z G K K_shaped closed_loop proof boxes history evaluations gradients notes
facts hints claims
"""
# A longer word is a hash.
LONGEST = 40
DROPPED = frozenset(f"{MOMENT} {CHOICE}".split())


def kept(tree: Any) -> Any:
    """A program's JSON without what is of the moment, of choice, or a sentence; poles in an order of their own."""
    if isinstance(tree, Mapping):
        found = {
            key: kept(_sorted(item) if key == "poles" else item) for key, item in tree.items() if key not in DROPPED
        }
        return {key: item for key, item in found.items() if item is not None}
    if isinstance(tree, list):
        return tree if _numeric(tree) else {str(k): kept(item) for k, item in enumerate(tree)}
    return None if isinstance(tree, str) and (" " in tree or "/" in tree or len(tree) > LONGEST) else tree


def _sorted(poles: list[Mapping[str, float]]) -> Any:
    return {part: sorted(pole[part] for pole in poles) for part in ("re", "im")}
