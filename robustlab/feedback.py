r"""Feedback connection of a plant and a controller: its signals, and the sign of the feedback.

.. math:: y = P u, \qquad u = s K y, \quad s = \pm 1

The inputs of a controller from a design record what they take (`robustlab.signals.Taken`): ``u = K y`` (s = 1) or
``u = K (r - y)`` (s = -1, the reference r at zero). Signals are matched by name, or else by position. Every function
that closes a loop uses this module.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from robustlab.display import listed
from robustlab.errors import InputError, NoTrustworthyNumber
from robustlab.operators import TransferMatrix
from robustlab.signals import Signal, Taken, is_constant, law, real_array, same_units
from robustlab.statespace import StateSpaceModel, as_model, feedback

Sign = Literal[-1, 1]
SIGNS: dict[int, str] = {-1: "u = -K y", 1: "u = K y"}
WORDS: dict[int, str] = {-1: "negative", 1: "positive"}
STATE_SIGN = "say it: sign=-1 (u = -K y) or sign=1 (u = K y)"
RENAME = "signals meet by name: rename them, or leave the names out for their order to count (K.renamed)"
PADE = 4  # order of the delays where a sign is chosen by the stability of the loop
LARGEST_GAIN = 1e100  # of a bare number or matrix: above it a loop overflows
# Numbered names have no meaning.
COUNTED = re.compile(r"[uy]\d+")


@dataclass(frozen=True, eq=False)
class FeedbackLoop:
    """A plant and a controller that fit each other, ``u = sign K y``."""

    plant: Any  # with the inputs that K drives and the outputs that it takes, in K's order
    K: Any  # without inputs for references, which are zero; None if the plant is the open loop itself
    sign: Sign  # -1 for negative feedback, 1 for positive feedback
    said: str  # the loop in words, and the origin of its sign


def closing(
    plant: Any, K: Any, sign: int | None = None, where: str = "loop", assumed: Sign | None = -1
) -> FeedbackLoop:
    """Connect K to a plant by feedback; K left out: close an open loop.

    ``plant``, ``K``: models of any kind, also uncertain, delayed, or frequency data.
    ``sign``: of the feedback; None: that recorded in K.
    ``assumed``: of a K without a sign; None: the sign that makes the loop stable, if only one does.
    """
    if sign not in (None, -1, 1) or isinstance(sign, bool):
        raise InputError(f"{where}: sign", f"{sign!r}", "-1 (negative feedback) or 1 (positive feedback)")
    signed = plant if K is None else without_references(as_controller(K, where))
    taken = [s for s in signed.inputs if isinstance(s, Taken)]
    if taken and len(taken) < len(signed.inputs):
        found = f"{len(taken)} of {len(signed.inputs)} inputs of K say what they take"
        raise InputError(where, found, "all, or none")
    p, k, matched = (_ordered_loop(plant, where), None, True) if K is None else _matched_loop(plant, signed, where)
    own = {s.sign for s in taken}
    if len(own) > 1:  # both signs occur: they are included in K by now
        if sign is not None or k is None:
            raise InputError(f"{where}: sign", f"{law(taken)}", "one sign for all inputs, or a plant and its K")
        return FeedbackLoop(p, k, 1, f"{law(taken)}, as the controller says")
    recorded = own.pop() if own else None
    if recorded is not None and (matched or sign == recorded):
        if sign not in (None, recorded):
            hint = "leave the sign out; or K.renamed(inputs=list(K.input_names)), which says nothing of it"
            raise InputError(f"{where}: sign", f"{sign} ({SIGNS[int(sign or 0)]})", f"{recorded}: {law(taken)}", hint)
        return FeedbackLoop(p, k, _sign(recorded), f"{law(taken)}, as the controller says")
    if sign is not None:
        return FeedbackLoop(p, k, _sign(sign), f"{SIGNS[sign]}, as requested")
    if recorded is None and assumed is not None:
        return FeedbackLoop(p, k, assumed, f"{SIGNS[assumed]}, {WORDS[assumed]} feedback by default")
    return _by_stability(p, k, signed.inputs, where)


def feedback_loop(
    plant: Any, K: Any, sign: int | None = None, where: str = "feedback", assumed: Sign | None = -1
) -> tuple[Any, Sign, str]:
    """Return K with inputs and outputs for all of the plant's, zero where it takes or drives none, sign, and words."""
    if is_constant(K):
        found = closing(plant, None if any(isinstance(s, Taken) for s in plant.inputs) else K, sign, where)
        if found.plant is not plant:
            names = [listed(s.name for s in side) for side in (plant.outputs, found.plant.outputs)]
            raise InputError(where, f"the loop's outputs are {names[0]}", f"{names[1]}, as its inputs take them")
        return K, found.sign, found.said
    found = closing(plant, K, sign, where, assumed)
    ins, outs = ([s.name for s in side] for side in (plant.inputs, plant.outputs))
    drives, takes = ([s.name for s in side] for side in (found.plant.inputs, found.plant.outputs))
    k = found.K
    if drives != ins or takes != outs:
        into, of = np.eye(len(ins))[[ins.index(s) for s in drives]], np.eye(len(outs))[[outs.index(s) for s in takes]]
        k = into.T @ k @ of
        if isinstance(k, StateSpaceModel):
            k = k.renamed(plant.outputs, plant.inputs)
    return k, found.sign, found.said


def wired(K: Any, measurements: Sequence[Signal], controls: Sequence[Signal], where: str) -> Any:
    """Return K for the lower LFT ``u = K y`` of a generalised plant: with its order and signs."""
    if (len(K.inputs), len(K.outputs)) != (len(measurements), len(controls)):
        return K  # the caller refuses the size
    measured = [s if isinstance(s, Taken) else Taken(*s) for s in measurements]
    columns, rows = _matched(K.inputs, measured, where), _matched(K.outputs, controls, where)
    taken = [K.inputs[j] for j in columns]
    same_units(where, zip(taken, measurements, strict=True))
    signs = [s.sign * y.sign or 1 if isinstance(s, Taken) else 1 for s, y in zip(taken, measured, strict=True)]
    if [*rows, *columns] == [*range(len(rows)), *range(len(columns))] and min(signs, default=1) > 0:
        return K
    ordered = K[[K.outputs[i].name for i in rows], [s.name for s in taken]] @ np.diag([float(sign) for sign in signs])
    if not isinstance(ordered, StateSpaceModel):
        return ordered
    turned = [s.negated() if sign < 0 and isinstance(s, Taken) else s for s, sign in zip(taken, signs, strict=True)]
    return ordered.renamed(turned)


def without_sign(K: Any, where: str) -> Any:
    """Return a controller without the recorded sign, its inputs named by the plant's signals."""
    k = without_references(as_controller(K, where))
    ins = [s.name for s in k.inputs]
    labels = [_label(s) for s in k.inputs]
    plain = [Signal(at if labels.count(at) == 1 else s.name, s.unit) for at, s in zip(labels, k.inputs, strict=True)]
    through = StateSpaceModel([], [], [], np.eye(len(ins)), 0.0, plain, [Signal(name) for name in ins])
    return k.renamed(plain) if isinstance(k, StateSpaceModel) else k @ through


def as_controller(K: Any, where: str) -> Any:
    """Return a controller of any kind as a model with signals; numbers become gains."""
    if is_constant(K):
        gain = real_array("K", K, 2, where)
        if np.abs(gain).max(initial=0.0) > LARGEST_GAIN:
            raise InputError(f"{where}: K", f"an entry of {np.abs(gain).max():g}", f"at most {LARGEST_GAIN:g}")
        return StateSpaceModel([], [], [], gain)
    if isinstance(K, TransferMatrix):  # a model of any kind
        return K
    return as_model(K, f"{where}: K")


def without_references(k: Any) -> Any:
    """Return a controller without its inputs for references."""
    names = [s.name for s in k.inputs]
    fed = [s.name for s in k.inputs if not (isinstance(s, Taken) and s.sign == 0)]
    return k if len(fed) == len(names) else k[[s.name for s in k.outputs], fed]


def _label(s: Signal) -> str:
    return s.of if isinstance(s, Taken) else s.name


def _matched(given: Sequence[Signal], wanted: Sequence[Signal], where: str) -> list[int]:
    """Return the position of the given signal for each wanted one: by name if all match, by position if none does."""

    def key(s: Signal) -> tuple[str, bool]:
        return _label(s), isinstance(s, Taken) and s.sign == 0

    have, want = [key(s) for s in given], [key(s) for s in wanted]
    if have == want:
        return list(range(len(given)))
    if len(set(have)) == len(have) and set(have) == set(want):
        return [have.index(k) for k in want]
    known = all(isinstance(s, Taken) for s in given) and bool(given)
    counted = any(COUNTED.fullmatch(_label(s)) for s in [*given, *wanted])
    partly = set(have) & set(want) and not all(COUNTED.fullmatch(s.name) for s in given)
    if partly or (known and not counted):
        raise InputError(where, f"K has {listed(_label(s) for s in given)}", listed(_label(s) for s in wanted), RENAME)
    return _by_unit(wanted, given) or list(range(len(given)))


def _matched_loop(plant: Any, k: Any, where: str) -> tuple[Any, Any, bool]:
    """Return the plant with the signals that K takes and drives, K with one input for each, and whether names match."""
    ins, outs = list(plant.inputs), list(plant.outputs)
    drives, _ = _positions(k.outputs, ins, f"{where}: inputs of the plant")
    takes, by_name = _positions(k.inputs, outs, f"{where}: outputs of the plant")
    if drives is None or takes is None:
        found = f"K is {len(k.outputs)} x {len(k.inputs)}"
        raise InputError(where, found, f"{len(ins)} x {len(outs)} for a plant of {len(outs)} x {len(ins)}")
    same_units(where, [*((ins[i], s) for i, s in zip(drives, k.outputs, strict=True)),
                       *((outs[i], s) for i, s in zip(takes, k.inputs, strict=True))])  # fmt: skip
    once, signs = list(dict.fromkeys(takes)), {s.sign for s in k.inputs if isinstance(s, Taken)}
    if len(once) < len(takes) or len(signs) > 1:  # a signal is taken twice, or both signs occur
        into = np.zeros((len(takes), len(once)))
        for row, (position, s) in enumerate(zip(takes, k.inputs, strict=True)):
            into[row, once.index(position)] = s.sign if len(signs) > 1 and isinstance(s, Taken) else 1.0
        k = k @ into
    if drives == list(range(len(ins))) and once == list(range(len(outs))):
        return plant, k, by_name
    return plant[[outs[i].name for i in once], [ins[i].name for i in drives]], k, by_name


def _positions(given: Sequence[Signal], known: Sequence[Signal], where: str) -> tuple[list[int] | None, bool]:
    """Return the positions of K's signals among the plant's, by name, unit or order; and whether by name."""
    labels, names = [_label(s) for s in given], [s.name for s in known]
    missing = [label for label in labels if label not in names]
    if labels and not missing:
        return [names.index(label) for label in labels], True
    if len(missing) < len(labels) and not all(COUNTED.fullmatch(label) for label in labels):
        raise InputError(where, f"no {missing[0]!r}, which K has", f"one of {listed(names)}", RENAME)
    by_unit = _by_unit(given, known)
    if by_unit is not None:
        return by_unit, False
    return (list(range(len(known))) if len(given) == len(known) else None), False


def _by_unit(given: Sequence[Signal], known: Sequence[Signal]) -> list[int] | None:
    """Return the positions of the given signals if each has a unit that exactly one of the known ones has."""
    units, there = [s.unit for s in given], [s.unit for s in known]
    if not all(units) or len(set(units)) < len(units) or any(there.count(unit) != 1 for unit in units):
        return None
    return [there.index(unit) for unit in units]


def _ordered_loop(loop: Any, where: str) -> Any:
    """Return an open loop with its outputs in the order in which its inputs take them."""
    if len(loop.inputs) != len(loop.outputs):
        raise InputError(where, f"an open loop of {len(loop.outputs)} x {len(loop.inputs)}", "a square one, or a K")
    wanted = [_label(s) for s in loop.inputs if isinstance(s, Taken)]
    names = [s.name for s in loop.outputs]
    if wanted == names or set(wanted) != set(names):
        return loop
    return loop[wanted, [s.name for s in loop.inputs]]


def _by_stability(plant: Any, k: Any, takes: Sequence[Signal], where: str) -> FeedbackLoop:
    """Connect with the only sign that makes the nominal loop stable; negative if none does."""
    around = StateSpaceModel([], [], [], np.eye(len(plant.inputs))) if k is None else k
    one, other = _rational(plant), _rational(around)
    mismatch = f"it takes {listed(_label(s) for s in takes)}, this plant has {listed(s.name for s in plant.outputs)}"
    doubt = mismatch if any(isinstance(s, Taken) for s in takes) else "the controller does not say its sign"
    if one is None or other is None:
        raise InputError(f"{where}: sign of the feedback", doubt, "an explicit sign", STATE_SIGN)
    stable = [s for s in (-1, 1) if _stable(one, other, s)]
    if len(stable) == 2:
        found = f"{doubt}, and both signs leave the loop stable"
        raise InputError(f"{where}: sign of the feedback", found, "an explicit sign", STATE_SIGN)
    sign = _sign(stable[0] if stable else -1)
    why = "only this sign leaves the loop stable" if stable else f"{doubt}, and no sign leaves the loop stable"
    return FeedbackLoop(plant, k, sign, f"{SIGNS[sign]}: {why}")


def _rational(model: Any) -> StateSpaceModel | None:
    """Return the nominal model with Padé's approximation of delays; None for frequency data."""
    if hasattr(model, "pade"):
        return model.pade(PADE)
    nominal = model if isinstance(model, StateSpaceModel) else getattr(model, "nominal", None)
    return nominal if isinstance(nominal, StateSpaceModel) else None


def _stable(plant: StateSpaceModel, k: StateSpaceModel, sign: int) -> bool:
    try:
        return feedback(plant, k, sign).is_stable()
    except (InputError, NoTrustworthyNumber):
        return False


def _sign(value: int) -> Sign:
    return 1 if value > 0 else -1
