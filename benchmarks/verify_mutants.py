"""Mutate claims: change one number or many, cut evidence, exchange blocks, models and kinds.

Levels move mostly towards false claims, by as little as 1e-12; structured numbers (P, D, G) are changed with their
structure as often as against it, so that a mutant gets beyond the first test.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import Any

import numpy as np
from verify_claims import closed

import robustlab as rl

Rng = np.random.Generator
Numbers = dict[str, Any]
Mutant = tuple[str, Numbers]

LEVELS = ("level", "gamma", "value", "size")
MODEL = ("A", "B", "C", "D")
PIECES = ("low", "high", "D_w", "D_z", "G", "box")
TWICE = 0.3  # share of mutants that are changed once more


def relative(rng: Rng, least: float = -6.0) -> float:
    """A change between a power of ten and one, of either sign."""
    return float(rng.choice([-1.0, 1.0]) * 10 ** rng.uniform(least, 0))


def names(numbers: Numbers, *among: str) -> list[str]:
    """Floating datasets with entries, of these names where any are given."""
    return [
        x for x, v in numbers.items() if np.size(v) and np.asarray(v).dtype.kind in "fc" and (not among or x in among)
    ]


def one_number(rng: Rng, kind: str, numbers: Numbers, other: Numbers) -> Mutant | None:
    """An entry changed by a relative 1e-6 to 1."""
    found = names(numbers)
    name = str(rng.choice(found))
    X = np.array(numbers[name])
    at = tuple(rng.integers(0, s) for s in X.shape)
    factor = 1 + relative(rng)
    X[at] = X[at] * factor if X[at] != 0 and np.isfinite(X[at]) else relative(rng)
    result = {**numbers, name: X}
    if rng.random() < 0.7:
        kept_structure(name, at, X, result)
    return kind, result


def kept_structure(name: str, at: tuple[Any, ...], X: Any, result: Numbers) -> None:
    """Apply the same change where the structure requires it: P symmetric, D and G Hermitian, D_z like D_w."""
    if name in ("P", "P_low"):
        X[(*at[:-2], at[-1], at[-2])] = X[at]
    elif name in ("D_w", "D_z", "G") and "blocks" in result:
        *front, i, j = at
        table = np.asarray(result["blocks"])
        if name == "G":
            if X[at].imag == 0 or i != j:
                mirror = (*front, j, i)
                if j < X.shape[-2] and i < X.shape[-1]:
                    X[mirror] = np.conj(X[at])
            return
        partner = "D_z" if name == "D_w" else "D_w"
        Y = np.array(result[partner])
        if partner not in result or not len(table):
            return
        ends = np.cumsum(table[:, 1 if name == "D_w" else 2])
        block = int(np.searchsorted(ends, i, side="right"))
        if block >= len(table):
            return
        mine = slices(table, 1 if name == "D_w" else 2)[block]
        yours = slices(table, 2 if name == "D_w" else 1)[block]
        own = tuple(front)
        if table[block, 0] == 2:
            value = X[at].real if i == j else X[(*own, mine.start, mine.start)].real
            X[(*own, mine, mine)] = value * np.eye(mine.stop - mine.start)
            Y[(*own, yours, yours)] = value * np.eye(yours.stop - yours.start)
        else:
            X[(*own, j, i)] = np.conj(X[at])
            if i == j:
                X[at] = X[at].real
            Y[(*own, yours, yours)] = X[(*own, mine, mine)]
        result[partner] = Y


def slices(table: Any, column: int) -> list[slice]:
    ends = np.concatenate([[0], np.cumsum(table[:, column])])
    return [slice(int(a), int(b)) for a, b in itertools.pairwise(ends)]


def level(rng: Rng, kind: str, numbers: Numbers, other: Numbers) -> Mutant | None:
    """The claimed number moved, four times of five towards what is false, by 1e-12 to 1."""
    found = names(numbers, *LEVELS)
    name = str(rng.choice(found))
    worse = -1.0 if (name in ("gamma", "value") or kind in ("mu-upper", "mu-axis")) else 1.0
    if name == "level" and kind in ("mu-boxes", "mu-upper-boxes"):
        worse = -1.0
    step = 10 ** rng.uniform(-12, 0) * (worse if rng.random() < 0.8 else -worse)
    X = np.array(numbers[name])
    if X.ndim and X.size and rng.random() < 0.5:
        i = rng.integers(0, X.size)
        X[i] = X[i] * (1 + step)
    elif name == "level" and "blocks" in numbers and X.ndim == 0 and rng.random() < 0.3:  # one block's alone
        X = np.full(len(numbers["blocks"]), float(X))
        if len(X):
            X[rng.integers(0, len(X))] *= 1 + step
    else:
        X = X * (1 + step)
    return kind, {**numbers, name: X}


def tightened(rng: Rng, kind: str, numbers: Numbers, other: Numbers) -> Mutant | None:
    """The claimed number taken to a place between nothing and itself that a proof may still reach or not."""
    found = names(numbers, "gamma", "value", "level")
    if not found or kind in ("mu-lower", "unstable-member"):
        return None
    name = found[0]
    return kind, {**numbers, name: np.array(numbers[name]) * (1 - 10 ** rng.uniform(-7, -0.5))}


def sign(rng: Rng, kind: str, numbers: Numbers, other: Numbers) -> Mutant | None:
    """The sign of an entry, a row, or a dataset."""
    name = str(rng.choice(names(numbers)))
    X = np.array(numbers[name])
    if X.ndim and rng.random() < 0.6:
        at = tuple(rng.integers(0, s) for s in X.shape[: rng.integers(1, X.ndim + 1)])
        X[at] = -X[at]
    else:
        X = -X
    return kind, {**numbers, name: X}


def zero(rng: Rng, kind: str, numbers: Numbers, other: Numbers) -> Mutant | None:
    """An entry, a row, or a dataset made zero."""
    name = str(rng.choice(names(numbers)))
    X = np.array(numbers[name])
    at = tuple(rng.integers(0, s) for s in X.shape[: rng.integers(0, X.ndim + 1)])
    X[at] = 0
    return kind, {**numbers, name: X}


def model(rng: Rng, kind: str, numbers: Numbers, other: Numbers) -> Mutant | None:
    """The model: its gain larger, its poles moved to the boundary or beyond."""
    own = [x for x in names(numbers) if x[-1:] in MODEL or x[:1] in MODEL or x in ("M",)]
    own = [x for x in own if x.rstrip("012") in MODEL or x in ("M",) or x[:2] in ("P_", "K_")]
    name = str(rng.choice(own))
    X, size = np.array(numbers[name]), 10 ** rng.uniform(-8, 0)
    if "A" in name and X.ndim == 2 and X.shape[0] == X.shape[1] and rng.random() < 0.7:
        values = np.linalg.eigvals(X)
        if float(numbers.get("dt", 0.0)):
            radius = np.abs(values).max()
            X = X * (1 + size) if rng.random() < 0.5 else X / max(radius, 1e-3) * (1 + relative(rng, -10.0) * 0.1)
        else:
            shift = size if rng.random() < 0.5 else -values.real.max() * (1 + relative(rng, -10.0))
            X = X + shift * np.eye(len(X))
    else:
        X = X * (1 + size)
    return kind, {**numbers, name: X}


def sample_time(rng: Rng, kind: str, numbers: Numbers, other: Numbers) -> Mutant | None:
    """Another dt, continuous made discrete and back."""
    dt = float(numbers["dt"])
    new = dt * (1 + relative(rng)) if dt and rng.random() < 0.6 else 0.0 if dt else float(rng.choice([1.0, 1e-3, 0.1]))
    return kind, {**numbers, "dt": np.array(abs(new))}


def intervals(rng: Rng, kind: str, numbers: Numbers, other: Numbers) -> Mutant | None:
    """Intervals (and boxes) left out, cut, moved, swapped, doubled."""
    k, result = len(numbers["low"]), dict(numbers)
    i, what = int(rng.integers(k)), int(rng.integers(7))
    order = np.arange(k)
    if what in (0, 1):
        order = np.delete(order, i if what or rng.random() < 0.5 else k - 1)
    elif what == 2:
        j = int(rng.integers(k))
        order[[i, j]] = order[[j, i]]
    elif what == 3:
        order = np.insert(order, i, i)
    elif what == 4:
        high = np.array(numbers["high"])
        dt = float(numbers.get("dt", 0.0))
        last = np.pi / dt if dt else 10 * max(1.0, float(numbers["low"].max()))
        high[i] = (high[i] if np.isfinite(high[i]) else last) * (1 - 10 ** rng.uniform(-15, 0))
        return kind, {**numbers, "high": high}
    elif what == 5:
        low = np.array(numbers["low"])
        low[i] = low[i] * (1 + 10 ** rng.uniform(-15, 0)) if low[i] else 10 ** rng.uniform(-12, 1)
        return kind, {**numbers, "low": low}
    else:  # scalings of the wrong interval
        j = int(rng.integers(k))
        for name in ("D_w", "D_z", "G"):
            X = np.array(numbers[name])
            X[i] = X[j]
            result[name] = X
        return kind, result
    for name in PIECES:
        if name in numbers:
            result[name] = np.asarray(numbers[name])[order]
    return kind, result


def widened(rng: Rng, kind: str, numbers: Numbers, other: Numbers) -> Mutant | None:
    """A band moved or widened, an interval made longer."""
    if "band" in numbers and rng.random() < 0.7:
        band = np.array(numbers["band"])
        i = rng.integers(2)
        band[i] = max(band[i] * (1 + (2 * i - 1) * 10 ** rng.uniform(-12, 0)), 0.0)
        result = {**numbers, "band": band}
        if rng.random() < 0.7:  # and the intervals with it
            low, high = np.array(numbers["low"]), np.array(numbers["high"])
            low[0], high[-1] = min(low[0], band[0]), max(high[-1], band[1])
            result |= {"low": low, "high": high}
        return kind, result
    if "low" not in numbers or len(numbers["low"]) < 2:
        return None
    low, high = np.array(numbers["low"]), np.array(numbers["high"])
    i = int(rng.integers(len(low) - 1))
    cut = low[i + 1] + (10 ** rng.uniform(-9, 0)) * (low[i + 1] + 1e-3)
    return kind, {**numbers, "high": np.where(np.arange(len(low)) == i, np.maximum(high, cut), high)}


def boxes(rng: Rng, kind: str, numbers: Numbers, other: Numbers) -> Mutant | None:
    """Faces of boxes moved, ranges and size made larger."""
    X = np.array(numbers["box"])
    if rng.random() < 0.25:
        ranges = np.array(numbers["ranges"])
        at = rng.integers(len(ranges)), rng.integers(2)
        ranges[at] *= 1 + 10 ** rng.uniform(-12, 0)
        return kind, {**numbers, "ranges": ranges}
    k, i, side = (int(rng.integers(s)) for s in X.shape)
    if rng.random() < 0.5:  # the same face in all boxes that have it
        X[X[k, i, side] == X] *= 1 + relative(rng, -14.0)
    else:
        X[k, i, side] += (X[k, i, 1] - X[k, i, 0]) * relative(rng, -14.0) * 0.5
    return kind, {**numbers, "box": X}


def shrunk(rng: Rng, kind: str, numbers: Numbers, other: Numbers) -> Mutant | None:
    """Delta smaller, larger, or with one block changed."""
    if "delta" not in numbers or not np.size(numbers["delta"]):
        return None
    delta, size = np.array(numbers["delta"]), 1 + relative(rng, -12.0)
    if rng.random() < 0.5:
        return kind, {**numbers, "delta": delta * size}
    if delta.ndim == 1:  # the parameters of a member
        delta[rng.integers(len(delta))] *= size
        return kind, {**numbers, "delta": delta}
    table = np.asarray(numbers["blocks"])
    i = int(rng.integers(len(table)))
    w, z = slices(table, 1)[i], slices(table, 2)[i]
    delta[w, z] = delta[w, z] * size
    return kind, {**numbers, "delta": delta}


def structure(rng: Rng, kind: str, numbers: Numbers, other: Numbers) -> Mutant | None:
    """Blocks swapped, of another kind, put together, taken apart; sizes of the loop's channels."""
    if "n_meas" in numbers:
        name = str(rng.choice(["n_meas", "n_con"]))
        return kind, {**numbers, name: np.array(int(numbers[name]) + int(rng.choice([-1, 1])), dtype=np.int64)}
    table = np.array(numbers["blocks"])
    i, j = (int(rng.integers(len(table))) for _ in range(2))
    what = rng.integers(4)
    if what == 0:
        table[[i, j]] = table[[j, i]]
    elif what == 1:
        table[i, 0] = rng.integers(0, 3)
    elif what == 2 and len(table) > 1:
        i = min(i, len(table) - 2)
        both = table[i] + table[i + 1]
        both[0] = rng.integers(0, 3)
        table = np.vstack([table[:i], both, table[i + 2 :]])
    elif table[i, 1] == table[i, 2] and table[i, 1] > 1:
        part = [int(rng.integers(0, 3)), 1, 1]
        table = np.vstack([table[:i], [part] * int(table[i, 1]), table[i + 1 :]])
    return kind, {**numbers, "blocks": table.astype(np.int64)}


def transposed(rng: Rng, kind: str, numbers: Numbers, other: Numbers) -> Mutant | None:
    """Matrices on their side: one, or the whole model."""
    found = [x for x in names(numbers) if np.ndim(numbers[x]) >= 2 and x not in ("box", "ranges")]
    name = str(rng.choice(found))
    return kind, {**numbers, name: np.swapaxes(numbers[name], -1, -2).copy()}


def foreign(rng: Rng, kind: str, numbers: Numbers, other: Numbers) -> Mutant | None:
    """Datasets of another claim's model put in where they fit."""
    shared = [x for x in numbers if x in other and np.shape(other[x]) == np.shape(numbers[x]) and np.size(other[x])]
    if not shared:
        return None
    chosen = rng.choice(shared, size=min(len(shared), int(rng.integers(1, 4))), replace=False)
    return kind, {**numbers, **{str(x): np.array(other[str(x)]) for x in chosen}}


def left_out(rng: Rng, kind: str, numbers: Numbers, other: Numbers) -> Mutant | None:
    """An optional dataset left out: other ways of proof are tried."""
    found = [x for x in ("P", "delta", "frequency", "band", "tolerance") if x in numbers]
    name = str(rng.choice(found))
    return kind, {x: v for x, v in numbers.items() if x != name}


def controller(rng: Rng, kind: str, numbers: Numbers, other: Numbers) -> Mutant | None:
    """K with the other sign, or another gain; P mostly not believed any more."""
    C, D = numbers["K_C"], numbers["K_D"]
    factor = -1.0 if rng.random() < 0.6 else 1 + relative(rng)
    result = {**numbers, "K_C": factor * C, "K_D": factor * D}
    if rng.random() < 0.5:
        result.pop("P", None)
    return kind, result


def mirrored(rng: Rng, kind: str, numbers: Numbers, other: Numbers) -> Mutant | None:
    """Scalings or a P of the wrong sign, in claims whose other inequalities hold with them.

    A, B and P negated: Lyapunov's and the bounded real inequality (continuous) stay what they are. D_w, D_z, G negated
    with a level far down: the form may become definite where M expands.
    """
    if "D_w" in numbers:
        down = 10 ** rng.uniform(-4, 0)
        levels = {x: np.array(numbers[x]) * down for x in ("level", "gamma") if x in numbers}
        return kind, {**numbers, **{x: -np.asarray(numbers[x]) for x in ("D_w", "D_z", "G")}, **levels}
    if "P" not in numbers:
        return None
    turned = [x for x in numbers if x.rstrip("12") in ("A", "B", "P", "P_low") or x in ("P_A", "P_B", "K_A", "K_B")]
    return kind, {**numbers, **{x: -np.asarray(numbers[x]) for x in turned}}


def hidden(rng: Rng, kind: str, numbers: Numbers, other: Numbers) -> Mutant | None:
    """A direct term of a loop that is not zero, though all its parts cancel but for the last of their places.

    Where the claim is a Gramian's, P and value are those of the new loop but for that term.
    """
    if "K_D" not in numbers or not np.size(numbers["K_D"]):
        return None
    y, u = int(numbers["n_meas"]), int(numbers["n_con"])
    K_D, D, e = np.zeros_like(numbers["K_D"]), np.array(numbers["P_D"]), 2.0 ** -int(rng.integers(40, 53))
    if y < 1 or u < 1 or D.shape[0] <= y or D.shape[1] <= u or K_D.shape != (u, y):
        return None
    K_D[0, 0] = 1 - e
    D[:-y], D[:, :-u], D[-y:, -u:] = 0, 0, 0
    D[0, -u], D[-y, 0], D[0, 0] = 1 + e, 1, -1
    result = {**numbers, "K_D": K_D, "P_D": D, "P_C": np.array(numbers["P_C"]), "K_C": np.array(numbers["K_C"])}
    if kind != "gramian" or float(numbers["dt"]):
        return kind, result
    result["P_C"][-y:], result["K_C"][:] = 0, 0
    P, K = (rl.StateSpaceModel(*(result[f"{which}_{x}"] for x in "ABCD")) for which in "PK")
    G = closed(P, K, y, u)
    one = np.eye(G.n_states)
    system = -np.kron(G.A.T, one) - np.kron(one, G.A.T)
    X = np.linalg.solve(system, (G.C.T @ G.C + one).ravel()).reshape(one.shape)
    X = (X + X.T) / 2
    return kind, {**result, "P": X, "value": np.array(1.1 * np.sqrt(max(np.trace(G.B.T @ X @ G.B), 1e-9)))}


def stray(rng: Rng, kind: str, numbers: Numbers, other: Numbers) -> Mutant | None:
    """Add a dataset that belongs to claims of another kind."""
    made: Numbers = {
        "band": np.sort(10 ** rng.uniform(-2, 2, 2)), "size": np.array(10 ** rng.uniform(-3, 0)),
        "tolerance": np.array(10 ** rng.uniform(-9, 1)), "frequency": np.array(10 ** rng.uniform(-2, 2)),
        "level": np.array(10 ** rng.uniform(-1, 3)), "gamma": np.array(10 ** rng.uniform(-1, 3)),
    }  # fmt: skip
    name = str(rng.choice([*made, "loop", "model", "difference", "delta"]))
    if name == "delta" and "blocks" in numbers:
        table = np.asarray(numbers["blocks"])
        delta = np.zeros((table[:, 1].sum(), table[:, 2].sum()))
        for (_, r, c), w, z in zip(table.tolist(), slices(table, 1), slices(table, 2), strict=True):
            delta[w, z] = np.eye(r, c) * rng.normal()
        return kind, {**numbers, "delta": delta}
    if name == "model" and "P_A" in numbers:  # a model added to a loop, of the size of the loop's open channels
        y, u = int(numbers["n_meas"]), int(numbers["n_con"])
        p, m = (a - b for a, b in zip(np.shape(numbers["P_D"]), (y, u), strict=True))
        plain = {"A": -np.eye(2), "B": rng.normal(size=(2, max(m, 0))), "C": rng.normal(size=(max(p, 0), 2))}
        return kind, {**numbers, **plain, "D": np.zeros((max(p, 0), max(m, 0)))}
    if name == "loop" and {*"ABCD"} <= {*numbers}:  # a loop added to a model
        A, B, C, D = (np.asarray(numbers[x]) for x in "ABCD")
        loop = {"P_A": A - np.eye(len(A)), "P_B": np.pad(B, ((0, 0), (0, 1))), "P_C": np.pad(C, ((0, 1), (0, 0)))}
        loop |= {"P_D": np.pad(D, ((0, 1), (0, 1))), "K_A": np.zeros((0, 0)), "K_B": np.zeros((0, 1))}
        one = np.array(1, dtype=np.int64)
        return kind, {**numbers, **loop, "K_C": np.zeros((1, 0)), "K_D": np.zeros((1, 1)), "n_meas": one, "n_con": one}
    if name == "difference" and {*"ABCD"} <= {*numbers}:  # a difference added to a model
        half = {f"{x}1": np.asarray(numbers[x]) * (0.5 if x in "CD" else 1.0) for x in "ABCD"}
        p, m = np.shape(numbers["D"])
        none = {"A2": np.zeros((0, 0)), "B2": np.zeros((0, m)), "C2": np.zeros((p, 0)), "D2": np.zeros((p, m))}
        return kind, {**numbers, **half, **none}
    if name not in made or (name in numbers and name != "band"):
        return None
    result = {**numbers, name: made[name]}
    if name == "band" and "low" in numbers and len(numbers["low"]) and rng.random() < 0.7:
        result |= {"low": np.array(numbers["low"]), "high": np.array(numbers["high"])}
        result["low"][0], result["high"][-1] = result["band"]
    return kind, result


PLAIN = ("norm", "bounded-real", "stable", "gramian")
AXIS = ("mu-axis", "worst-gain", "unstable-member", "mu-boxes", "worst-gain-boxes")


def exchanged(rng: Rng, kind: str, numbers: Numbers, other: Numbers) -> Mutant | None:
    """Change the kind of claim, and derive its datasets from the existing ones."""
    families = (PLAIN, AXIS, ("mu-upper", "mu-lower"))
    own = next((f for f in families if kind in f), None)
    if own is None:
        return None
    new = str(rng.choice([x for x in own if x != kind]))
    result = dict(numbers)
    value = next(
        (np.asarray(numbers[x]).ravel()[0] for x in ("gamma", "level", "value") if np.size(numbers.get(x, []))), 1.0
    )
    for name in ("gamma", "level", "value", "size"):
        result.setdefault(name, np.array(float(value)) if name != "size" else np.array(1.0))
    if new.endswith("boxes") and "box" not in result and "low" in result:
        k, b = len(result["low"]), len(result["blocks"])
        result["ranges"] = np.tile([-1.0, 1.0], (b, 1))
        result["box"] = np.tile([-1.0, 1.0], (k, b, 1)) * float(result["size"])
        real = np.asarray(result["blocks"])[:, 0] == 0
        result["box"][:, ~real] = [-1.0, 1.0]
    return new, result


WEIGHTS: dict[Callable[..., Mutant | None], float] = {
    one_number: 5.0, level: 4.0, tightened: 3.0, model: 4.0, intervals: 4.0, boxes: 3.0, widened: 2.0, shrunk: 3.0,
    structure: 3.0, foreign: 2.0, sign: 1.5, zero: 1.5, sample_time: 1.0, transposed: 1.0, left_out: 1.0,
    controller: 2.0, mirrored: 1.5, hidden: 1.0, stray: 2.0, exchanged: 1.5,
}  # fmt: skip


def mutant(rng: Rng, kind: str, numbers: Numbers, other: Numbers) -> tuple[str, str, Numbers]:
    """Return the mutations' names, the kind and the datasets of a mutant."""
    weights, mutations = np.array([*WEIGHTS.values()]), [*WEIGHTS]
    names: list[str] = []
    while not names or rng.random() < TWICE:
        change = mutations[int(rng.choice(len(weights), p=weights / weights.sum()))]
        try:
            made = change(rng, kind, numbers, other)
        except (IndexError, KeyError, ValueError):
            made = None  # the claim lacks what it would change, or an earlier mutation took it away
        if made is not None:
            kind, numbers = made
            names.append(change.__name__)
    return " + ".join(names), kind, numbers
