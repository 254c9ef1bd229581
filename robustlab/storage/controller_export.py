r"""Export controllers as C99 source: a struct of state, an init and a step function, without allocation.

.. math:: y_k = C x_k + D u_k, \qquad x_{k+1} = A x_k + B u_k

Numbers are exact hexadecimal constants. With limits, the states are corrected by back-calculation. Names of signals
appear in comments only, never in code.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from robustlab.arrays import Array
from robustlab.dynamics.extended.feed_forward import FeedForward
from robustlab.dynamics.plant_base import Plant
from robustlab.errors import InputError, UnitMismatch, UsageError, error_context
from robustlab.files.atomic import atomic_write
from robustlab.provenance import Provenance
from robustlab.signals import Taken, law
from robustlab.statespace import Signal, StateSpaceModel, as_model
from robustlab.storage.interchange import save
from robustlab.synthesis.problem.controller import Controller
from robustlab.uncertainty.lft import UncertainModel

PREFIX = re.compile(r"[a-z][a-z0-9_]{0,30}")
RESERVED = (
    "auto break case char const continue default do double else enum extern float for goto if inline int long "
    "register restrict return short signed sizeof static struct switch typedef union unsigned void volatile while main"
)
SIGNS = {  # what an input takes -> lines of its comment
    "r": ["THE REFERENCE of {}: the value that is wanted, by itself"],
    "r - y": ["REFERENCE MINUS MEASUREMENT: ({0} wanted) - ({0} measured)", "positive: {0} is too small"],
    "y - r": ["MEASUREMENT MINUS REFERENCE: ({0} measured) - ({0} wanted)", "positive: {0} is too large"],
}
TERMS = 4  # of a statement on one line
ANTI_WINDUP_SAMPLES = 10.0  # in which modes decay during saturation, unless a time is given
MIRROR = 1.5  # modes are mirrored at exp(-MIRROR dt / time), a little inside the limit of slow modes
CHECKED = 3  # samples of the sign check in the comment


def saturation_limits(model: StateSpaceModel, saturation: Any, where: str) -> tuple[tuple[float, float], ...] | None:
    """Return ``(low, high)`` for each output, from a pair for all or a mapping by name; None without limits."""
    if saturation is None:
        return None
    names, limits = model.output_names, list[tuple[float, float]]()
    given: dict[str, Any] = saturation if isinstance(saturation, dict) else dict.fromkeys(names, saturation)
    odd = [f"no output {name!r}" for name in given if name not in names]
    odd += [f"no limits of {name!r}" for name in names if name not in given]
    if odd:
        raise InputError(f"{where}: saturation", odd[0], f"limits of {', '.join(names)}")
    for name in names:
        try:
            low, high = (float(v) for v in given[name])
        except (TypeError, ValueError):
            low = high = np.nan
        if not (np.isfinite([low, high]).all() and low < high):
            raise InputError(f"{where}: saturation of {name}", f"{given[name]!r}", "two numbers, finite low < high")
        limits.append((low, high))
    return tuple(limits)


def back_calculation(model: StateSpaceModel, limits: Sequence[tuple[float, float]], time: float) -> Array:
    r"""Return the gain L (n, p) with which every mode decays within ``time`` while all outputs saturate.

    :math:`x_{k+1} = (A - L C) x_k + (B - L D) u_k + L v_k`; nothing is proved where only some of several saturate.
    """
    from scipy.linalg import schur, solve_discrete_lyapunov

    if not time >= model.dt:
        raise InputError("anti-windup", f"a time of {time:g} s", f"at least one sample time, {model.dt:g} s")
    slowest, mirror = math.exp(-model.dt / time), math.exp(-MIRROR * model.dt / time)
    scale, gain = np.array([0.5 * (high - low) for low, high in limits]), np.zeros((model.n_states, model.n_outputs))
    if (np.abs(model.poles()) > slowest * (1 + 1e-12)).any():
        ordered: Any = schur(model.A.T, output="complex", sort=lambda pole: abs(pole) <= slowest * (1 + 1e-12))
        T, Z, n_fast = ordered
        modes = Z[:, n_fast:]
        G, inverse = modes.conj().T @ (model.C / scale[:, None]).T / mirror, mirror * np.linalg.inv(T[n_fast:, n_fast:])
        driven = inverse @ G
        X = np.linalg.pinv(solve_discrete_lyapunov(inverse, driven @ driven.conj().T), rcond=1e-13, hermitian=True)
        to = G.conj().T @ X
        feedback = np.linalg.solve(np.eye(len(scale)) + to @ G, to @ T[n_fast:, n_fast:] / mirror)
        gain = (feedback @ modes.conj().T).real.T / scale
    radius = float(np.abs(np.linalg.eigvals(model.A - gain @ model.C)).max(initial=0.0))
    if radius > slowest * (1 + 1e-6):
        found = f"a mode of modulus {radius:.6g} that does not show in the control signals"
        hint = "take it out first (rl.reduce_controller), or allow a longer time"
        raise InputError("anti-windup", found, f"modes slower than {time:g} s that do", hint)
    return gain


def c_source(
    model: StateSpaceModel,
    prefix: str = "controller",
    limits: Sequence[tuple[float, float]] | None = None,
    notes: Sequence[str] = (),
    anti_windup: float | None = None,
    feed_forward: FeedForward | None = None,
) -> str:
    if not model.is_discrete:
        hint = "discretise it with its sample time first"
        raise InputError("C export", "a continuous controller (dt = 0)", "a discrete one", hint)
    if model.operating_point is not None:
        hint = "take u and y of that point off in the program around it, and export the model without the point"
        raise InputError("C export", "a model in deviations from an operating point", "one without", hint)
    if not model.n_inputs or not model.n_outputs:
        raise InputError("C export", f"{model.n_inputs} inputs and {model.n_outputs} outputs", "at least one of each")
    if not PREFIX.fullmatch(prefix) or prefix in RESERVED.split():
        expected = "a lower-case letter, then lower-case letters, digits or underscores"
        raise InputError("C export: prefix", f"{prefix!r}", expected)
    time = ANTI_WINDUP_SAMPLES * model.dt if anti_windup is None else float(anti_windup)
    back = back_calculation(model, limits, time) if limits else np.zeros((model.n_states, model.n_outputs))
    ahead = None if feed_forward is None else _place_feed_forward(model, feed_forward)
    unused = ["s"] * (not model.n_states) + ["u"] * (not (ahead or model.B.any() or model.D.any()))
    return _template().render(
        model=model,
        prefix=prefix,
        limits=limits,
        notes=notes,
        outputs=[_terms(*rows) for rows in zip(model.C, model.D, strict=True)],
        states=[_terms(*rows) for rows in zip(model.A, model.B, back, strict=True)],
        state_feedback=[i for i in range(model.n_outputs) if back[:, i].any()],
        anti_windup=time,
        signs=[_sign(signal, model.inputs) for signal in model.inputs],
        law=law(model.inputs),
        check=_first_samples(model),
        unused=unused,
        ahead=ahead,
        TERMS=TERMS,
    )


def _place_feed_forward(model: StateSpaceModel, law: FeedForward) -> dict[str, Any]:
    names, wanted = model.output_names, law.position
    if law.input.name not in names:
        raise InputError("C export: feed-forward", f"of {law.input.name!r}", f"one of {', '.join(names)}")
    found = [i for i, s in enumerate(model.inputs) if isinstance(s, Taken) and (s.takes, s.of) == ("r", wanted.name)]
    if not found:
        hint = "a controller of a tracking problem is: it sees references and measurements apart"
        expected = f"a controller that is given the reference of {wanted.name}"
        raise InputError("C export: feed-forward", f"inputs {', '.join(model.input_names)}", expected, hint)
    output, reference = names.index(law.input.name), found[0]
    for ours, its in ((model.outputs[output], law.input), (model.inputs[reference], wanted)):
        if ours.unit != its.unit:
            raise UnitMismatch(f"C export: feed-forward of {its.name}", its.unit, ours.unit)
    return {"law": law, "output": output, "reference": reference}


def _template() -> Any:
    from jinja2 import Environment, PackageLoader, StrictUndefined

    environment = Environment(
        loader=PackageLoader("robustlab.storage", ""),
        autoescape=False,  # noqa: S701  C, not HTML; texts go through `_comment`
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        undefined=StrictUndefined,
    )
    environment.filters.update(exact=_exact, unit=_unit, comment=_comment)
    return environment.get_template("controller.c.j2")


def _terms(*rows: Array) -> list[tuple[float, str]]:
    places = zip(("s->x[{}]", "u[{}]", "cut{}"), rows, strict=False)
    return [(v, place.format(j)) for place, row in places for j, v in enumerate(row.tolist()) if v != 0]


def _sign(signal: Signal, inputs: Sequence[Signal]) -> list[str]:
    if not isinstance(signal, Taken):
        return ["SIGN NOT STATED by what this was written from: find out how the loop is closed, before it moves"]
    if signal.takes in SIGNS:
        return [line.format(signal.of) for line in SIGNS[signal.takes]]
    words = ["MEASUREMENT MINUS REFERENCE", "REFERENCE MINUS MEASUREMENT"]
    lines = [f"THE SIGNAL ITSELF: {signal.of} with its own sign, not negated"]
    if signal.takes == "-y":
        words, lines = words[::-1], [f"MINUS THE SIGNAL: -({signal.of})"]
    if not any(isinstance(s, Taken) and s.takes == "r" for s in inputs):
        lines.append("to follow a reference: {}, never {}".format(*words))
    return lines


def _first_samples(model: StateSpaceModel) -> list[list[str]]:
    """Return as text the first samples of all outputs for each input at +1 from the zero state."""
    rows = []
    for i in range(model.n_inputs):
        x, seen = np.zeros(model.n_states), []
        for _ in range(CHECKED):
            with np.errstate(over="ignore", invalid="ignore"):  # inf may appear in the comment
                seen.append(model.C @ x + model.D[:, i])
                x = model.A @ x + model.B[:, i]
        rows.append([", ".join(f"{y[j]:+.6g}" for y in seen) for j in range(model.n_outputs)])
    return rows


def _exact(value: float) -> str:
    """Return the hexadecimal constant of a number, in parentheses if negative."""
    text = float(value).hex() if value else "0.0"
    return f"({text})" if text.startswith("-") else text


def _unit(signal: Signal) -> str:
    return _comment(f"[{signal.unit}]" if signal.unit else "[unit not stated in the model]")


def _comment(text: str) -> str:
    """Return text that cannot end a comment or continue a line: printable ASCII, other characters as numbers."""
    plain = "".join(c if " " <= c <= "~" else f"<U+{ord(c):04X}>" for c in text)
    return plain.replace("*/", "* /").replace("/*", "/ *").replace("\\", "<U+005C>").replace("??", "? ?")


EXPORTS = (".c", ".mat", ".h5", ".hdf5")


@error_context("export_controller")
def export_controller(
    path: str | Path,
    controller: Any,
    *,
    prefix: str = "controller",
    saturation: Any = None,
    anti_windup: float | None = None,
    feed_forward: FeedForward | None = None,
    provenance: Provenance | None = None,
) -> Path:
    r"""Write a controller for another program, with the sign of its feedback; the extension of the file says which.

    ``.c``
        C99 without allocation: a struct of state, ``<prefix>_init`` and ``<prefix>_step``. The sample time, the names,
        units and signs of all signals, and the first samples for a check, are in the comment at the top; every number
        is exact (hexadecimal).
    ``.mat``, ``.h5``
        As `robustlab.save` writes them.

    Parameters
    ----------
    path
        File to write; replaced once the new one is complete.
    controller
        Controller, a synthesis result, or a model with n states; discrete for ``.c``.
    prefix
        Of the C names.
    saturation
        ``(low, high)`` of all control signals, or a mapping by name; the C step holds its outputs between them,
        with back-calculation against windup (`robustlab.storage.back_calculation`).
    anti_windup
        For ``.c`` with a saturation: time in s within which, during saturation, all modes of the controller decay. Ten
        samples by default; inf does not change a stable controller's states.
    feed_forward
        For ``.c``: a function of the reference and its rate, added to a control signal before its limits
        (`robustlab.dynamics.extended.feed_forward.feed_forward`). The rate is then the last input of the step.
    provenance
        Where it comes from; time and versions of now where left out.

    Returns
    -------
    Path
        The file that was written.

    Raises
    ------
    UsageError
        Another extension; a saturation, an anti-windup time or a feed-forward for a file that cannot hold it.
    InputError
        A continuous controller for ``.c``, invalid limits or prefix, an anti-windup time below a sample, a slow mode
        that back-calculation cannot move, a feed-forward of signals that the controller does not have.
    EnvironmentFault
        Disk full, no permission; the previous file is kept.
    """
    suffix = Path(path).suffix.lower()
    if suffix not in EXPORTS:
        raise UsageError(str(path), f"extension {suffix or 'missing'!r}", ", ".join(EXPORTS))
    given = getattr(controller, "controller", controller)
    if isinstance(given, (UncertainModel, Plant)):
        raise InputError(str(path), f"a {type(given).__name__}", "a controller or a model")
    held = given if isinstance(given, Controller) else Controller(as_model(given, "export_controller"))
    options = {"a saturation": saturation, "an anti-windup time": anti_windup, "a feed-forward": feed_forward}
    for what, option in options.items():
        if option is not None and suffix != ".c":
            raise UsageError(str(path), f"{what} in a {suffix} file", "a .c file: the others hold a linear model")
    if anti_windup is not None and saturation is None:
        raise UsageError(str(path), "an anti-windup time without a saturation", "a .c file with a saturation")
    limits = saturation_limits(held.K, saturation, "export_controller")
    origin = provenance or Provenance.now("export_controller")
    if suffix == ".c":
        text = c_source(held.K, prefix, limits, _notes(held, origin), anti_windup, feed_forward)
        return atomic_write(path, lambda temporary: temporary.write_text(text, encoding="ascii"))
    return save(path, held, origin)


def _notes(controller: Controller, origin: Provenance) -> list[str]:
    notes = ["Design method and verified norm are not stated by what it was written from."]
    if controller.method:
        gamma = "none" if controller.gamma is None else f"{controller.gamma:.6g}"
        notes = [f"Designed by {controller.method}, verified norm {gamma} ({controller.status})."]
    version = origin.versions.get("robustlab", "")
    notes.append(f"Written by robustlab {version} on {origin.created}, {origin.created_by} {origin.note}".rstrip())
    return [*notes, *(f"From {name}, sha256 {digest}" for name, digest in origin.inputs.items())]
