"""Mixed-sensitivity synthesis: S, K S and T shaped by weights that are realised separately."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from robustlab.errors import InputError, error_context
from robustlab.signals import Taken
from robustlab.statespace import Signal, StateSpaceModel, append, as_model, series
from robustlab.synthesis.hinf.hinf_synthesis import WORK, synthesize
from robustlab.synthesis.problem.design import HinfSynthesis, design_budget
from robustlab.synthesis.problem.partition import GeneralizedPlant


@error_context("synth mixsyn")
def mixsyn(
    G: Any,
    W1: Any = None,
    W2: Any = None,
    W3: Any = None,
    *,
    gamma_rel: float = 1.05,
    time_limit: float | None = None,
    effort: float = 1.0,
    progress: Callable[[str], None] | None = None,
) -> HinfSynthesis:
    r"""Design an H-infinity controller for weighted sensitivity, control effort and complementary sensitivity.

    .. math:: \min_K \left\| \begin{matrix} W_1 S \\ W_2 K S \\ W_3 T \end{matrix} \right\|_\infty, \qquad
        S = (I + G K)^{-1}, \quad T = G K S

    Sign of K: the controller sees the error, ``u = K (r - y)``. So K is *positive feedback* from ``e = r - G u`` into
    the generalised plant, as everywhere in this package, and at the same time the forward controller of the usual
    *negative* feedback loop: its loop gain is ``G K``. ``K.inputs`` record the sign; ``disk_margin(G, K)``,
    ``G.feedback(K)`` and every other function that closes a loop use it.

    Parameters
    ----------
    G
        Plant: StateSpaceModel, UncertainModel (its nominal model) or python-control object, n_y outputs and n_u inputs.
    W1, W2, W3
        Weights on e (n_y channels), u (n_u channels) and G u (n_y channels). None leaves the term out; a number or a
        model with one input and one output is used on every channel; else a model or a constant matrix with as many
        inputs as channels. Weights must be stable and proper. See `robustlab.synthesis.specifications.weight_design`.
    gamma_rel, time_limit, effort, progress
        As for `robustlab.hinf`.

    Returns
    -------
    HinfSynthesis
        ``K`` with inputs ``e NAME``, the errors of the plant's outputs; ``closed_loop`` is the stack above, driven
        by r.

    Raises
    ------
    InputError
        No weight at all, wrong number of channels, a weight that is not stable, different sample times.
    NoTrustworthyNumber
        See `robustlab.hinf`.

    References
    ----------
    Skogestad, Postlethwaite 2005, section 9.3.6 and example 2.17.

    Examples
    --------
    >>> lag = StateSpaceModel([[-1.0]], [[1.0]], [[1.0]], [[0.0]])
    >>> W1 = StateSpaceModel([[-0.001]], [[1.0]], [[1.0]], [[0.5]])
    >>> design = mixsyn(lag, W1, 0.1)
    >>> design.status.value, design.closed_loop.is_stable()
    ('certified', True)
    """
    plant, weights = mixed_sensitivity_plant(G, W1, W2, W3)
    budget = design_budget("synth mixsyn", WORK, effort, time_limit)
    return synthesize(plant, "mixsyn", gamma_rel, budget, weights, progress=progress)


def mixed_sensitivity_plant(
    G: Any, W1: Any = None, W2: Any = None, W3: Any = None
) -> tuple[GeneralizedPlant, dict[str, StateSpaceModel]]:
    """Return the plant from [r; u] to [W1 e; W2 u; W3 G u; e], ``e = r - G u``, and the weights on all channels."""
    g = as_model(G, "mixsyn: G")
    if not g.n_inputs or not g.n_outputs:
        raise InputError("mixsyn: G", f"{g.n_outputs} outputs and {g.n_inputs} inputs", "at least one of each")
    channels = {"W1": [s.name for s in g.outputs], "W2": [s.name for s in g.inputs], "W3": [s.name for s in g.outputs]}
    given = {name: w for name, w in (("W1", W1), ("W2", W2), ("W3", W3)) if w is not None}
    if not given:
        raise InputError("mixsyn", "no weight", "at least one of W1, W2, W3")
    weights = {name: _stable_weight(w, len(channels[name]), name, g.dt) for name, w in given.items()}
    n, n_y, n_u = g.n_states, g.n_outputs, g.n_inputs
    rows = {
        "W1": (-g.C, np.hstack([np.eye(n_y), -g.D])),
        "W2": (np.zeros((n_u, n)), np.hstack([np.zeros((n_u, n_y)), np.eye(n_u)])),
        "W3": (g.C, np.hstack([np.zeros((n_y, n_y)), g.D])),
    }
    parts = [rows[name] for name in weights] + [rows["W1"]]
    signals = StateSpaceModel(
        g.A,
        np.hstack([np.zeros((n, n_y)), g.B]),
        np.vstack([c for c, _ in parts]),
        np.vstack([d for _, d in parts]),
        g.dt,
        states=g.states,
    )
    ends = [f"e{i}" for i in range(n_y)]
    through = StateSpaceModel([], [], [], np.eye(n_y), g.dt, ends, ends)
    filters = [
        w.renamed([f"{name} into {i}" for i in range(w.n_inputs)], [f"{name} out {i}" for i in range(w.n_outputs)])
        for name, w in weights.items()
    ]
    joined = series(signals, append(*filters, through))
    errors = [Taken(f"e {s.name}", s.unit, "r - y", s.name) for s in g.outputs]
    controls = [Signal(s.name, s.unit) for s in g.inputs]
    references = [Signal(f"r {s.name}", s.unit) for s in g.outputs]
    outputs = [Signal(label) for name, w in weights.items() for label in _labels(name, channels[name], w.n_outputs)]
    states = [f"{name} x{i + 1}" for name, w in weights.items() for i in range(w.n_states)]
    model = StateSpaceModel(
        joined.A, joined.B, joined.C, joined.D, joined.dt, [*references, *controls], [*outputs, *errors],
        [*(f"G {s.name}" for s in g.states), *states], where="mixsyn",
    )  # fmt: skip
    return GeneralizedPlant(model, n_y, n_u), weights


def _labels(name: str, channels: list[str], n_outputs: int) -> list[str]:
    term = {"W1": "S", "W2": "K S", "W3": "T"}[name]
    own = channels if n_outputs == len(channels) else [str(i + 1) for i in range(n_outputs)]
    return [f"{name} {term}: {channel}" for channel in own]


def _stable_weight(given: Any, n: int, name: str, dt: float) -> StateSpaceModel:
    """Return the weight as a stable model with n inputs, in the plant's time."""
    where = f"mixsyn: {name}"
    several = "several weights side by side are one model: robustlab.statespace.append(W, W)"
    weight = weight_on_channels(given, n, dt, where, several)
    if not weight.is_stable():
        hint = "no controller can move a weight's pole; make an integrator a slow lag: s + omega_B * A instead of s"
        raise InputError(where, f"spectral abscissa is {weight.spectral_abscissa():.3g}", "a stable weight", hint)
    if weight.n_inputs != n:
        raise InputError(where, f"{weight.n_inputs} inputs", f"{n}, or one input and one output")
    return weight


def weight_on_channels(given: Any, n: int, dt: float, where: str, hint: str | None = None) -> StateSpaceModel:
    """Return a weight (a number, a matrix or a model) in the plant's time; one of one channel is used on all n."""
    if isinstance(given, (int, float, list, tuple, np.ndarray, np.number)):
        try:
            gain = np.atleast_2d(given)
            if gain.dtype.kind == "c":
                raise InputError(where, "complex numbers", "a model or real numbers", hint)
            gain = gain.astype(float)
        except (TypeError, ValueError):
            raise InputError(where, f"a {type(given).__name__} that is no matrix", "a model or numbers", hint) from None
        given = StateSpaceModel([], [], [], gain, where=where)
    weight = as_model(given, where)
    if not weight.n_states and weight.dt != dt:
        weight = StateSpaceModel(weight.A, weight.B, weight.C, weight.D, dt)
    if weight.dt != dt:
        raise InputError(where, f"dt is {weight.dt:g} s", f"{dt:g} s, as the plant")
    if n > 1 and (weight.n_inputs, weight.n_outputs) == (1, 1):
        weight = append(*(weight.renamed([f"u{i}"], [f"y{i}"]) for i in range(n)))
    return weight
