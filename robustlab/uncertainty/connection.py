"""Interconnection by the names of signals: an output feeds every input that has its name."""

# u = K y + E v, o = F y with y all outputs and u all inputs of the parts, v and o the requested inputs and outputs; a
# summing junction is a part, too: a static gain of ones and minus ones.

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np

from robustlab.errors import InputError, NoTrustworthyNumber, UnitMismatch, did_you_mean, error_context, unknown_name
from robustlab.linear_analysis.structural import strong_components
from robustlab.signals import Signal, is_constant
from robustlab.statespace import StateSpaceModel
from robustlab.uncertainty.lft import UncertainModel, Wiring, as_uncertain, interconnected

FORM = '"e = r - y": a new name, then names with + or - between them'
_NAME = r"[^\s=+-]+"
_SUM = re.compile(rf"\s*({_NAME})\s*=\s*([+-]?\s*{_NAME}(?:\s*[+-]\s*{_NAME})*)\s*")


class _Part(NamedTuple):
    """A part of the interconnection, with its name in messages."""

    label: str
    model: UncertainModel


@error_context("connect")
def connect(
    *parts: Any, inputs: Sequence[str] | str, outputs: Sequence[str] | str, sums: Sequence[str] | str = ()
) -> StateSpaceModel | UncertainModel:
    r"""Connect models by the names of their signals: an output feeds every input of the same name.

    Parameters
    ----------
    *parts
        Models, sets, designs and python-control's objects. A gain needs names too: a StateSpaceModel without states.
    inputs
        Names of the external inputs of the result, in order. Each feeds every input of its name.
    outputs
        Names of the outputs of the result, in order: outputs of parts, sums, or external inputs.
    sums
        Summing junctions, each a text: ``"e = r - y"`` makes the scalar signal e; a name in a sum has no spaces, signs
        or equals signs.

    Returns
    -------
    StateSpaceModel or UncertainModel
        An uncertain model where a part is one. All states of all parts are kept, in their order. A block name in
        several parts is the same uncertainty. A unit given once for a signal, or for one term of a sum, holds for all.

    Raises
    ------
    InputError
        A signal of two outputs, an input without a source, an unknown name, an invalid sum, different sample times, a
        block name of two different uncertainties.
    UnitMismatch
        A signal with different units, or a sum of different units.
    NoTrustworthyNumber
        An algebraic loop that is not well posed (of a set: at Delta = 0).

    Examples
    --------
    >>> plant = StateSpaceModel([[-1.0]], [[1.0]], [[1.0]], [[0.0]], inputs=["u"], outputs=["y"])
    >>> gain = StateSpaceModel([], [], [], [[4.0]], inputs=["e"], outputs=["u"])
    >>> loop = connect(plant, gain, inputs=["r"], outputs=["y", "e"], sums=["e = r - y"])
    >>> loop.poles(), loop.dc_gain().ravel()
    (array([-5.+0.j]), array([0.8, 0.2]))
    """
    for key, names in (("inputs", inputs), ("outputs", outputs), ("sums", sums)):
        if not isinstance(names, Iterable) or not all(isinstance(name, str) for name in names):
            raise InputError(f"connect: {key}", repr(names), "a text, or a list of texts")
    ins, outs, texts = ([given] if isinstance(given, str) else list(given) for given in (inputs, outputs, sums))
    given: list[_Part] = []
    for label, part in ((f"part {k + 1}", part) for k, part in enumerate(parts)):
        if is_constant(part):
            hint = 'rl.StateSpaceModel([], [], [], D, inputs=["e"], outputs=["u"]) is a gain with names'
            found = "a number or a matrix: its signals have no names"
            raise InputError(f"connect: {label}", found, "a model", hint)
        given.append(_Part(label, as_uncertain(getattr(part, "K", part), f"connect: {label}")))
    wired = [*given, *(_summing(text) for text in texts)]
    if not wired:
        raise InputError("connect", "no part", "at least one")
    _check(given, wired, ins, outs)
    units = _units(wired)
    # An external input that is an output, too, passes through its own part: outputs are outputs of parts.
    wired += [_Part(f"output {name!r}", _gain([[1.0]], [name], name)) for name in outs if name in ins]
    makers = np.array([s.name for part in wired for s in part.model.outputs])
    fed = np.array([s.name for part in wired for s in part.model.inputs])
    # An external name is made by its own part only, which comes last.
    by_part = np.where(np.isin(makers, ins), "", makers)
    K, E, F = (rows[:, None] == np.array(cols) for rows, cols in ((fed, by_part), (fed, ins), (np.array(outs), makers)))
    wiring = Wiring(K.astype(float), E.astype(float), F.astype(float))
    sides = [[Signal(name, units.get(name, "")) for name in side] for side in (ins, outs)]
    try:
        found = interconnected([part.model for part in wired], wiring, sides[0], sides[1], "connect")
    except NoTrustworthyNumber as error:
        raise _with_loop(error, wired, wiring, makers) from None
    return found if any(isinstance(part, UncertainModel) for part in parts) else found.nominal


def _gain(d: Any, inputs: Sequence[str], output: str) -> UncertainModel:
    return as_uncertain(StateSpaceModel([], [], [], d, 0.0, inputs, [output]))


def _summing(text: str) -> _Part:
    """Return the part for a text like ``"e = r - y"``."""
    where = f"connect: sum {text!r}"
    found = _SUM.fullmatch(text) if len(text) <= 10_000 else None
    if found is None:
        raise InputError(where, "no sum", FORM)
    signs: dict[str, float] = {}
    for sign, name in re.findall(rf"([+-]?)\s*({_NAME})", found[2]):
        if name in signs:
            raise InputError(where, f"{name!r} occurs twice", "each signal once")
        signs[name] = -1.0 if sign == "-" else 1.0
    return _Part(f"sum {text!r}", _gain([list(signs.values())], list(signs), found[1]))


def _check(given: Sequence[_Part], parts: Sequence[_Part], ins: list[str], outs: list[str]) -> None:
    """Check sample times, that every input has one source, and that every requested name exists."""
    timed = [part for part in given if part.model.M.n_states or part.model.dt]
    for first, part in ((timed[0], part) for part in timed[1:]):
        if part.model.dt != first.model.dt:
            found, expected = f"sample time {part.model.dt:g} s", f"{first.model.dt:g} s as in {first.label}"
            raise InputError(f"connect: {part.label}", found, expected, "rl.discretise and rl.d2c change sample times")
    made: dict[str, str] = {}  # the part that makes each signal
    for label, name in [(part.label, s.name) for part in parts for s in part.model.outputs]:
        if name in made:
            hint = f"rename one output, and add both in a sum: sums=['{name} = ...']"
            found = f"{made[name]} and {label} both make it"
            raise InputError(f"connect: signal {name!r}", found, "one output for a name", hint)
        made[name] = label
    fed = [(part.label, s.name) for part in parts for s in part.model.inputs]
    free, known = sorted({name for _, name in fed} - set(made)), [*made, *ins]
    for side, names in (("input", ins), ("output", outs)):
        twice = [name for name in names if names.count(name) > 1]
        if twice:
            raise InputError(f"connect: {side} {twice[0]!r}", "is given twice", "each name once")
    for name in ins:
        where = f"connect: input {name!r}"
        if name in made:
            hint = f"add both in a sum with a new name: sums=['{name}_sum = {name} + ...']"
            raise InputError(where, f"{made[name]} makes this signal", "a signal that no part makes", hint)
        if name not in free:
            expected = f"one of {', '.join(free)}" if free else "none: every input is fed by a part"
            raise InputError(where, "no part and no sum takes it", expected, did_you_mean(name, free))
    for name in outs:
        if name not in known:
            raise unknown_name(f"connect: output {name!r}", "no such signal", name, known)
    unfed = [(label, name) for label, name in fed if name not in known]
    if unfed:
        lines = [f"connect: {label}: input {name!r}: nobody feeds it" for label, name in unfed]
        where, _, found = lines[0].rpartition(": ")
        hint = did_you_mean(unfed[0][1], known) or "name it among inputs= where it comes from outside"
        raise InputError(where, found, "an output or a sum of this name, or it among inputs=", hint, tuple(lines[1:]))


def _units(parts: Sequence[_Part]) -> dict[str, str]:
    """Return the unit of each signal that has one anywhere; terms of a sum have one unit."""
    group: dict[str, set[str]] = {}  # the signals of one unit with each signal
    for part in parts:
        sides = [s.name for s in (*part.model.inputs, *part.model.outputs)]
        for names in [sides] if part.label.startswith("sum ") else [[name] for name in sides]:
            merged = set(names).union(*(group.get(name, ()) for name in names))
            group |= dict.fromkeys(merged, merged)
    units: dict[str, str] = {}
    stated: dict[str, str] = {}  # where the unit of each signal was given first
    for part in parts:
        for signal in (*part.model.inputs, *part.model.outputs):
            if not signal.unit:
                continue
            if units.setdefault(signal.name, signal.unit) != signal.unit:
                where, found = f"connect: signal {signal.name!r}", f"[{signal.unit}] in {part.label}"
                raise UnitMismatch(where, found, stated[signal.name])
            for name in group[signal.name]:
                through = "" if name == signal.name else ", for a sum adds them"
                units.setdefault(name, signal.unit)
                stated.setdefault(name, f"[{signal.unit}] as {signal.name!r} in {part.label}{through}")
    return units


def _with_loop(error: NoTrustworthyNumber, parts: Sequence[_Part], wiring: Wiring, makers: Any) -> NoTrustworthyNumber:
    """Return the error of an algebraic loop, with the signals of the loop."""
    from scipy.linalg import block_diag

    around = np.asarray(block_diag(*(part.model.nominal.D for part in parts))) @ wiring.K != 0
    label = strong_components(around)
    size = np.bincount(label)
    names = [name for k, name in enumerate(makers) if size[label[k]] > 1 or around[k, k]]
    at = " at Delta = 0" if any(part.model.blocks for part in parts) else ""
    found = f"the algebraic loop through {', '.join(names)} is not well posed{at}: the gain around it is one"
    hint = "a sign in a sum, or a part without its dynamics (a lag, a sample of delay) makes such a loop"
    return NoTrustworthyNumber(error.where, found, "direct paths that do not close a loop of gain one", hint)
