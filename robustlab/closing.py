r"""How a controller closes a loop: which signals of the plant it takes and drives, and the sign of the feedback.

.. math:: y = P u, \qquad u = s K y, \quad s = \pm 1

A controller that came from a design knows what its inputs take (`robustlab.signals.Taken`): ``u = K y`` (s = 1) or
``u = K (r - y)`` (s = -1, the reference r at zero). Signals are matched by name, where names meet, before places. Every
function that closes a loop asks here, so that the loop that is judged is the one that is meant.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from robustlab.errors import InputError, NoTrustworthyNumber
from robustlab.operators import TransferMatrix
from robustlab.shown import listed
from robustlab.signals import Signal, Taken, is_constant, law, real_array, same_units
from robustlab.statespace import StateSpaceModel, as_model, feedback

Sign = Literal[-1, 1]
SIGNS: dict[int, str] = {-1: "u = -K y", 1: "u = K y"}
WORDS: dict[int, str] = {-1: "negative", 1: "positive"}
SAY_WHICH = "say it: sign=-1 (u = -K y) or sign=1 (u = K y)"
PADE = 4  # order of the delays where a sign is chosen by the stability of the loop; what is proved afterwards is exact
LARGEST_GAIN = 1e100  # of a bare number or matrix: a loop of it overflows
# Names that were given by counting say nothing about what a signal is.
COUNTED = re.compile(r"[uy]\d+")


@dataclass(frozen=True, eq=False)
class Closing:
    """A plant and a controller that fit each other, ``u = sign K y``.

    Attributes
    ----------
    plant
        With the inputs that K drives and the outputs that it takes, in K's order.
    K
        Without inputs for references, which are at zero; None where the plant is the open loop itself.
    sign
        -1 for negative feedback, 1 for positive feedback.
    said
        The loop in words, and who says so.
    """

    plant: Any
    K: Any
    sign: Sign
    said: str


def closing(plant: Any, K: Any, sign: int | None = None, where: str = "loop", assumed: Sign | None = -1) -> Closing:
    """How K closes its loop around a plant; K left out: how an open loop is closed.

    ``plant``, ``K``: models of any kind, also uncertain, delayed, or frequency data.
    ``sign``: of the feedback; None: what K says of itself.
    ``assumed``: of a K that says nothing; None: the sign that leaves the loop stable, if only one does.
    Raises InputError: a sign that contradicts K; a K that does not say its sign, or takes other signals than this plant
    has, while both signs leave the loop stable; sizes that do not fit. UnitMismatch: signals in different units meet.
    """
    if sign not in (None, -1, 1) or isinstance(sign, bool):
        raise InputError(f"{where}: sign", f"{sign!r}", "-1 (negative feedback) or 1 (positive feedback)")
    speaks = plant if K is None else without_references(as_controller(K, where))
    taken = [s for s in speaks.inputs if isinstance(s, Taken)]
    if taken and len(taken) < len(speaks.inputs):
        found = f"{len(taken)} of {len(speaks.inputs)} inputs of K say what they take"
        raise InputError(where, found, "all, or none")
    p, k, met = (_ordered_loop(plant, where), None, True) if K is None else _met(plant, speaks, where)
    own = {s.sign for s in taken}
    if len(own) > 1:  # some signals are taken, others subtracted: the signs are in K by now
        if sign is not None or k is None:
            raise InputError(f"{where}: sign", f"{law(taken)}", "one sign for all inputs, or a plant and its K")
        return Closing(p, k, 1, f"{law(taken)}, as the controller says")
    said = own.pop() if own else None
    if said is not None and (met or sign == said):
        if sign not in (None, said):
            hint = "leave the sign out; or K.renamed(inputs=list(K.input_names)), which says nothing of it"
            raise InputError(f"{where}: sign", f"{sign} ({SIGNS[int(sign or 0)]})", f"{said}: {law(taken)}", hint)
        return Closing(p, k, _sign(said), f"{law(taken)}, as the controller says")
    if sign is not None:
        return Closing(p, k, _sign(sign), f"{SIGNS[sign]}, as asked")
    if said is None and assumed is not None:
        return Closing(p, k, assumed, f"{SIGNS[assumed]}, {WORDS[assumed]} feedback; nothing else is said of it")
    return _by_stability(p, k, speaks.inputs, where)


def fed_back(
    plant: Any, K: Any, sign: int | None = None, where: str = "feedback", assumed: Sign | None = -1
) -> tuple[Any, Sign, str]:
    """K with an input for every output of the plant and an output for every input, the sign, and the loop in words.

    For closing around a plant that keeps all its signals: what K does not take or drive gets zeros.
    """
    if is_constant(K):
        found = closing(plant, None if any(isinstance(s, Taken) for s in plant.inputs) else K, sign, where)
        if found.plant is not plant:
            said = [listed(s.name for s in side) for side in (plant.outputs, found.plant.outputs)]
            raise InputError(where, f"the loop's outputs are {said[0]}", f"{said[1]}, as its inputs take them")
        return K, found.sign, found.said
    found = closing(plant, K, sign, where, assumed)
    ins, outs = ([s.name for s in side] for side in (plant.inputs, plant.outputs))
    drives, takes = ([s.name for s in side] for side in (found.plant.inputs, found.plant.outputs))
    k = found.K
    if drives != ins or takes != outs:
        into, of = _places(ins, drives), _places(outs, takes)
        k = into.T @ k @ of
        if isinstance(k, StateSpaceModel):
            k = k.renamed(plant.outputs, plant.inputs)
    return k, found.sign, found.said


def wired(K: Any, measurements: Sequence[Signal], controls: Sequence[Signal], where: str) -> Any:
    """K as a generalised plant with these measurements and controls takes it, ``u = K y`` in its lower LFT.

    Inputs and outputs are brought into the plant's order where their names meet; an input that takes ``r - y`` where
    the plant offers y gets the opposite sign.

    Raises InputError: K takes other signals than there are; UnitMismatch: signals in different units meet.
    """
    if (len(K.inputs), len(K.outputs)) != (len(measurements), len(controls)):
        return K  # the size is refused by the one who closes the loop
    offered = [s if isinstance(s, Taken) else Taken(*s) for s in measurements]
    columns, rows = _matched(K.inputs, offered, where), _matched(K.outputs, controls, where)
    taken = [K.inputs[j] for j in columns]
    same_units(where, zip(taken, measurements, strict=True))
    signs = [s.sign * o.sign or 1 if isinstance(s, Taken) else 1 for s, o in zip(taken, offered, strict=True)]
    if [*rows, *columns] == [*range(len(rows)), *range(len(columns))] and min(signs, default=1) > 0:
        return K
    ordered = K[[K.outputs[i].name for i in rows], [s.name for s in taken]] @ np.diag([float(sign) for sign in signs])
    if not isinstance(ordered, StateSpaceModel):
        return ordered
    turned = [s.negated() if sign < 0 and isinstance(s, Taken) else s for s, sign in zip(taken, signs, strict=True)]
    return ordered.renamed(turned)


def silenced(K: Any, where: str) -> Any:
    """A controller that says nothing of its sign any more, its signals still named by those of the plant."""
    k = without_references(as_controller(K, where))
    ins = [s.name for s in k.inputs]
    labels = [_label(s) for s in k.inputs]
    plain = [Signal(at if labels.count(at) == 1 else s.name, s.unit) for at, s in zip(labels, k.inputs, strict=True)]
    through = StateSpaceModel([], [], [], np.eye(len(ins)), 0.0, plain, [Signal(name) for name in ins])
    return k.renamed(plain) if isinstance(k, StateSpaceModel) else k @ through


def as_controller(K: Any, where: str) -> Any:
    """A controller of any kind as a model with signals: designs and files give theirs, numbers become gains."""
    if is_constant(K):
        gain = real_array("K", K, 2, where)
        if np.abs(gain).max(initial=0.0) > LARGEST_GAIN:
            raise InputError(f"{where}: K", f"an entry of {np.abs(gain).max():g}", f"at most {LARGEST_GAIN:g}")
        return StateSpaceModel([], [], [], gain)
    if isinstance(K, TransferMatrix):  # a model of any kind
        return K
    return as_model(K, f"{where}: K")


def without_references(k: Any) -> Any:
    """A controller without its inputs for references: what it does to the loop."""
    names = [s.name for s in k.inputs]
    fed = [s.name for s in k.inputs if not (isinstance(s, Taken) and s.sign == 0)]
    return k if len(fed) == len(names) else k[[s.name for s in k.outputs], fed]


# --- which signal meets which -----------------------------------------------------------------------------------------


def _label(s: Signal) -> str:
    return s.of if isinstance(s, Taken) else s.name


def _matched(given: Sequence[Signal], wanted: Sequence[Signal], where: str) -> list[int]:
    """For each wanted signal the place of the given one: by name where all meet, by place where none does."""

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


RENAME = "signals meet by name: rename them, or leave the names out for their order to count (K.renamed)"


def _met(plant: Any, k: Any, where: str) -> tuple[Any, Any, bool]:
    """The plant with the signals that K takes and drives, K with one input for each, and whether names met."""
    ins, outs = list(plant.inputs), list(plant.outputs)
    drives, _ = _among(k.outputs, ins, f"{where}: inputs of the plant")
    takes, met = _among(k.inputs, outs, f"{where}: outputs of the plant")
    if drives is None or takes is None:
        found = f"K is {len(k.outputs)} x {len(k.inputs)}"
        raise InputError(where, found, f"{len(ins)} x {len(outs)} for a plant of {len(outs)} x {len(ins)}")
    same_units(where, [*((ins[i], s) for i, s in zip(drives, k.outputs, strict=True)),
                       *((outs[i], s) for i, s in zip(takes, k.inputs, strict=True))])  # fmt: skip
    once, signs = list(dict.fromkeys(takes)), {s.sign for s in k.inputs if isinstance(s, Taken)}
    if len(once) < len(takes) or len(signs) > 1:  # a signal comes in twice, or signals with different signs
        into = np.zeros((len(takes), len(once)))
        for row, (place, s) in enumerate(zip(takes, k.inputs, strict=True)):
            into[row, once.index(place)] = s.sign if len(signs) > 1 and isinstance(s, Taken) else 1.0
        k = k @ into
    if drives == list(range(len(ins))) and once == list(range(len(outs))):
        return plant, k, met
    return plant[[outs[i].name for i in once], [ins[i].name for i in drives]], k, met


def _among(given: Sequence[Signal], known: Sequence[Signal], where: str) -> tuple[list[int] | None, bool]:
    """Where the signals of K stand among the plant's, by name or by place; and whether it was by name."""
    labels, names = [_label(s) for s in given], [s.name for s in known]
    lost = [label for label in labels if label not in names]
    if labels and not lost:
        return [names.index(label) for label in labels], True
    if len(lost) < len(labels) and not all(COUNTED.fullmatch(label) for label in labels):
        raise InputError(where, f"no {lost[0]!r}, which K has", f"one of {listed(names)}", RENAME)
    by_unit = _by_unit(given, known)
    if by_unit is not None:
        return by_unit, False
    return (list(range(len(known))) if len(given) == len(known) else None), False


def _by_unit(given: Sequence[Signal], known: Sequence[Signal]) -> list[int] | None:
    """Where the signals stand whose names do not meet, if each has a unit that just one of the known ones has."""
    units, there = [s.unit for s in given], [s.unit for s in known]
    if not all(units) or len(set(units)) < len(units) or any(there.count(unit) != 1 for unit in units):
        return None
    return [there.index(unit) for unit in units]


def _ordered_loop(loop: Any, where: str) -> Any:
    """An open loop whose outputs stand in the order in which its inputs take them."""
    if len(loop.inputs) != len(loop.outputs):
        raise InputError(where, f"an open loop of {len(loop.outputs)} x {len(loop.inputs)}", "a square one, or a K")
    wanted = [_label(s) for s in loop.inputs if isinstance(s, Taken)]
    names = [s.name for s in loop.outputs]
    if wanted == names or set(wanted) != set(names):
        return loop
    return loop[wanted, [s.name for s in loop.inputs]]


def _places(every: Sequence[str], some: Sequence[str]) -> np.ndarray[Any, np.dtype[np.float64]]:
    found = np.zeros((len(some), len(every)))
    found[range(len(some)), [list(every).index(name) for name in some]] = 1.0
    return found


# --- the sign that nobody says ----------------------------------------------------------------------------------------


def _by_stability(plant: Any, k: Any, takes: Sequence[Signal], where: str) -> Closing:
    """The only sign that leaves the nominal loop stable; negative where none does.

    Raises InputError: both signs do, or it cannot be told of these kinds of models.
    """
    around = StateSpaceModel([], [], [], np.eye(len(plant.inputs))) if k is None else k
    one, other = _rational(plant), _rational(around)
    whose = f"it takes {listed(_label(s) for s in takes)}, this plant has {listed(s.name for s in plant.outputs)}"
    lacks = whose if any(isinstance(s, Taken) for s in takes) else "the controller does not say its sign"
    if one is None or other is None:
        raise InputError(f"{where}: sign of the feedback", lacks, "one that is said", SAY_WHICH)
    stable = [s for s in (-1, 1) if _stable(one, other, s)]
    if len(stable) == 2:
        found = f"{lacks}, and both signs leave the loop stable"
        raise InputError(f"{where}: sign of the feedback", found, "one that is said", SAY_WHICH)
    sign = _sign(stable[0] if stable else -1)
    why = "only this sign leaves the loop stable" if stable else f"{lacks}, and no sign leaves the loop stable"
    return Closing(plant, k, sign, f"{SIGNS[sign]}: {why}")


def _rational(thing: Any) -> StateSpaceModel | None:
    """The nominal model, delays as Padé's approximation; None of frequency data."""
    if hasattr(thing, "pade"):
        return thing.pade(PADE)
    nominal = thing if isinstance(thing, StateSpaceModel) else getattr(thing, "nominal", None)
    return nominal if isinstance(nominal, StateSpaceModel) else None


def _stable(plant: StateSpaceModel, k: StateSpaceModel, sign: int) -> bool:
    try:
        return feedback(plant, k, sign).is_stable()
    except (InputError, NoTrustworthyNumber):
        return False


def _sign(value: int) -> Sign:
    return 1 if value > 0 else -1
