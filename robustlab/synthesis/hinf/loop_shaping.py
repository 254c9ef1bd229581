r"""H-infinity loop shaping (Glover, McFarlane): the most robust controller of a plant shaped by weights.

:math:`\gamma_{min} = \sqrt{1 + \lambda_{max}(X Z)}` with the two Riccati solutions of the normalised coprime factors.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from robustlab.budget import one_thread
from robustlab.checks import number
from robustlab.display import Facts
from robustlab.errors import InputError, NoTrustworthyNumber, error_context
from robustlab.norms import HinfNorm, bilinear_to_discrete, hinf_norm
from robustlab.result import Status
from robustlab.signals import Taken
from robustlab.statespace import Signal, StateSpaceModel, as_model, series
from robustlab.synthesis.hinf.hinf_synthesis import synthesize
from robustlab.synthesis.problem.certify import certified, named_controller, surely_stable
from robustlab.synthesis.problem.design import HinfSynthesis, Synthesis, design_budget, limiting_channels
from robustlab.synthesis.problem.generalized_plant import GeneralizedPlant, require_performance, side_by_side
from robustlab.synthesis.specifications.weight_design import stable_weight, weight_on_channels
from robustlab.uncertainty.gap_metric import (
    CoprimeMargin,
    CoprimeRiccati,
    continuous_models,
    coprime_margin,
    coprime_riccati,
    four_block,
)

TERMS = {"W1": "S", "W2": "K S", "W3": "T"}  # that a weight bounds
SHAPED_LOSS = 1.001  # ratio of the verified gamma to the one requested above which digits count as lost


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

    The controller sees the error, ``u = K (r - y)``: K is *positive feedback* from ``e = r - G u`` into the generalised
    plant and the forward controller of the usual *negative* feedback loop with loop gain ``G K``. ``K.inputs`` record
    the sign, which every function that closes a loop uses. Skogestad, Postlethwaite 2005, section 9.3.6.

    Parameters
    ----------
    G
        Plant: StateSpaceModel, UncertainModel (its nominal model) or python-control object, n_y outputs and n_u inputs.
    W1, W2, W3
        Stable, proper weights on e (n_y channels), u (n_u channels) and G u (n_y channels). None leaves the term out; a
        number or a model with one input and one output is used on every channel; else a model or a constant matrix with
        as many inputs as channels. See `robustlab.synthesis.specifications.weight_design`.
    gamma_rel
        Largest ratio of gamma to the smallest gamma found (>= 1); within it the controller with the slowest poles is
        returned.
    time_limit, effort, progress
        As for `robustlab.hinf`.

    Returns
    -------
    HinfSynthesis
        ``K`` with inputs ``e NAME``, the errors of the plant's outputs; ``closed_loop``: the stack above, from r.

    Raises
    ------
    InputError, NoTrustworthyNumber
        No weight at all, wrong number of channels, a weight that is not stable, different sample times; as `hinf`.

    Examples
    --------
    >>> lag = StateSpaceModel([[-1.0]], [[1.0]], [[1.0]], [[0.0]])
    >>> W1 = StateSpaceModel([[-0.001]], [[1.0]], [[1.0]], [[0.5]])
    >>> design = mixsyn(lag, W1, 0.1)
    >>> design.status.value, design.closed_loop.is_stable()
    ('certified', True)
    """
    plant, weights = mixed_sensitivity_plant(G, W1, W2, W3)
    budget = design_budget("synth mixsyn", effort, time_limit)
    return synthesize(plant, "mixsyn", gamma_rel, budget, weights, progress=progress)


def mixed_sensitivity_plant(
    G: Any, W1: Any = None, W2: Any = None, W3: Any = None
) -> tuple[GeneralizedPlant, dict[str, StateSpaceModel]]:
    """Return the plant from [r; u] to [W1 e; W2 u; W3 G u; e], ``e = r - G u``, and the weights on all channels."""
    g = as_model(G, "mixsyn: G")
    if not g.n_inputs or not g.n_outputs:
        raise InputError("mixsyn: G", f"{g.n_outputs} outputs and {g.n_inputs} inputs", "at least one of each")
    channels = {"W1": g.output_names, "W2": g.input_names, "W3": g.output_names}
    given = {name: w for name, w in (("W1", W1), ("W2", W2), ("W3", W3)) if w is not None}
    if not given:
        raise InputError("mixsyn", "no weight", "at least one of W1, W2, W3")
    hint = "several weights side by side are one model: robustlab.statespace.append(W, W)"
    weights = {k: stable_weight(w, len(channels[k]), g.dt, f"mixsyn: {k}", hint) for k, w in given.items()}
    n, n_y, n_u = g.n_states, g.n_outputs, g.n_inputs
    rows = {
        "W1": (-g.C, np.hstack([np.eye(n_y), -g.D])),
        "W2": (np.zeros((n_u, n)), np.hstack([np.zeros((n_u, n_y)), np.eye(n_u)])),
        "W3": (g.C, np.hstack([np.zeros((n_y, n_y)), g.D])),
    }
    C, D = (np.vstack(parts) for parts in zip(*(rows[name] for name in [*weights, "W1"]), strict=True))
    signals = StateSpaceModel(g.A, np.hstack([np.zeros((n, n_y)), g.B]), C, D, g.dt, states=g.states)
    joined = series(signals, side_by_side(*weights.values(), StateSpaceModel([], [], [], np.eye(n_y), g.dt)))
    errors = [Taken(f"e {s.name}", s.unit, "r - y", s.name) for s in g.outputs]
    controls = [Signal(s.name, s.unit) for s in g.inputs]
    references = [Signal(f"r {s.name}", s.unit) for s in g.outputs]
    outputs = list[Signal]()
    for name, w in weights.items():
        own = channels[name] if w.n_outputs == len(channels[name]) else [str(i + 1) for i in range(w.n_outputs)]
        outputs += [Signal(f"{name} {TERMS[name]}: {channel}") for channel in own]
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


@dataclass(frozen=True, eq=False, kw_only=True)
class NcfSynthesis(Synthesis):
    r"""A loop-shaping design: ``K = W1 K_shaped W2`` for the plant as given, ``u = K y`` with positive feedback.

    ``closed_loop`` is the loop of that plant with noise on y and a disturbance on u, not minimised. ``gamma`` bounds

    .. math:: \left\| \begin{bmatrix} G_s \\ I \end{bmatrix} (I - K_s G_s)^{-1}
        \begin{bmatrix} K_s & I \end{bmatrix} \right\|_\infty
    """

    quantities = dict.fromkeys(("gamma_min", "factor"), float)
    saved = ("gamma_min", "factor", "margin", "K_shaped", "shaped_plant")

    gamma_min: float  # the smallest gamma of any controller, exact
    factor: float  # the requested ratio: `gamma <= factor gamma_min`
    margin: CoprimeMargin  # of the shaped loop, `1/gamma`, verified; above about 0.25 the shape of the loop is kept
    K_shaped: StateSpaceModel  # controller of the shaped plant
    shaped_plant: StateSpaceModel  # W2 G W1

    def _gamma_text(self) -> str:
        return f"{self.gamma:.6g} (verified upper bound; margin {self.margin.lower:.4g})"

    def facts(self) -> Facts:
        rows = super().facts()
        verdict = "the loop's shape is kept" if self.margin.lower >= 0.25 else "shape the loop differently"
        best = f"{self.gamma_min:.6g} (margin {1 / self.gamma_min:.4g}): {verdict}"
        return [*rows[:2], ("smallest gamma possible", best), *rows[2:]]


@error_context("synth ncf")
@one_thread()
def ncf(G: Any, W1: Any = None, W2: Any = None, *, factor: float = 1.1) -> NcfSynthesis:
    """Design the loop-shaping controller of largest, or nearly largest, coprime stability margin.

    Sign of K: ``u = K y`` with *positive* feedback, as everywhere in this package and in the literature on this method.
    For negative feedback, ``u = K_n (r - y)``, take ``K_n = -K``. McFarlane, Glover 1992; Skogestad, Postlethwaite
    2005, section 9.4.1, eqs 9.74 to 9.78 (general D there too).

    Parameters
    ----------
    G
        Plant: StateSpaceModel, UncertainModel (its nominal model) or python-control object; stable or not, continuous
        or discrete, any numbers of inputs and outputs.
    W1, W2
        Weights before and behind the plant, which give the singular values of ``W2 G W1`` the desired shape:
        large at low, small at high frequencies. None is no weight; a number or a model with one input and one output is
        used on every channel; else a model with as many outputs (W1: inputs of G) or inputs (W2: outputs of G) as fit.
        Integrators and other unstable weights are allowed: they become part of K.
    factor
        Back-off (> 1): at ``factor * gamma_min`` the controller is well conditioned, at gamma_min itself it is not.

    Returns
    -------
    NcfSynthesis
        The loops of the shaped plant and of the plant as given were rebuilt and verified. A discrete plant is solved
        through the bilinear map, which keeps the margin exactly, and verified in discrete time.

    Raises
    ------
    InputError, NoTrustworthyNumber
        ``factor`` not above 1, weights whose sizes or sample times do not fit. A mode of the shaped plant that cannot
        be stabilised (a weight may have cancelled it), a loop that was not verified.

    Examples
    --------
    >>> lag = StateSpaceModel([[0.0]], [[1.0]], [[1.0]], [[0.0]])
    >>> design = ncf(lag, factor=1.05)
    >>> round(design.gamma_min, 6), design.gamma <= 1.05 * design.gamma_min, design.status.value
    (1.414214, True, 'certified')
    """
    where = "synth ncf"
    number(f"{where}: factor", factor, "a number above 1, such as 1.1, of at most 1e6", above=1, at_most=1e6)
    g = as_model(G, f"{where}: G")
    if not g.n_inputs or not g.n_outputs:
        raise InputError(f"{where}: G", f"{g.n_outputs} outputs and {g.n_inputs} inputs", "at least one of each")
    before, behind = _weight(W1, g, "W1"), _weight(W2, g, "W2")
    if not before.n_inputs or not behind.n_outputs:
        raise InputError(where, "a weight without channels", "at least one input of W1 and one output of W2")
    shaped = series(series(before, _bare(g)), behind)
    try:
        equations = coprime_riccati(*continuous_models(shaped))
    except NoTrustworthyNumber as error:
        hint = "a zero of the plant or of a weight may cancel an unstable or integrating pole of the other"
        raise NoTrustworthyNumber(where, f"W2 G W1: {error.found}", error.expected, hint) from None
    gamma_min = 1 / equations.best_margin
    inner = _central(equations, factor * gamma_min)
    if shaped.dt:
        inner = bilinear_to_discrete(inner, shaped.dt)
    inner = named_controller(inner, shaped.outputs, shaped.inputs, shaped.dt)
    margin = coprime_margin(shaped, inner, sign=1)
    if margin.frequency is None:
        raise NoTrustworthyNumber(where, f"the rebuilt loop was not verified: {margin.reason}")
    full = series(series(behind, _bare(inner)), before)
    K = named_controller(full, g.outputs, g.inputs, g.dt)
    plant = four_block_plant(g)
    loop = plant.close(K)
    if not surely_stable(loop):
        raise NoTrustworthyNumber(where, "the loop of the plant as given with W1 K W2 is not surely stable")
    shaped_plant = GeneralizedPlant(four_block(shaped), shaped.n_outputs, shaped.n_inputs)
    norm = HinfNorm(1 / margin.upper, 1 / margin.lower, margin.frequency, margin.status)
    gamma, doubt = certified(shaped_plant, inner, norm)
    doubt = doubt or certified(plant, K, hinf_norm(loop)).doubt
    if not doubt and gamma > factor * gamma_min * SHAPED_LOSS:
        doubt = f"gamma misses {factor:g} gamma_min = {factor * gamma_min:.6g}: digits lost"
    proved = "loops of the shaped plant and of the plant as given are stable, with norms proved in ball arithmetic"
    status = Status.INACCURATE if doubt else Status.CERTIFIED
    limit = limiting_channels(_named_channels(shaped_plant.close(inner), shaped), margin.frequency)
    return NcfSynthesis(
        K=K, gamma=gamma, closed_loop=loop, status=status, reason=doubt or proved, limit=limit, plant=plant,
        method="ncf", gamma_min=gamma_min, factor=factor, margin=margin, K_shaped=inner, shaped_plant=shaped,
    )  # fmt: skip


def _central(equations: CoprimeRiccati, gamma: float) -> StateSpaceModel:
    """Return the central controller at gamma in the model's own time unit."""
    m, X, Z, F = equations.model, equations.control.X, equations.filtering.X, equations.control.gain
    g2, root = gamma**2, np.sqrt(equations.rate)
    L = (1 - g2) * np.eye(m.n_states) + X @ Z
    Q = g2 * np.linalg.solve(L.T, Z @ m.C.T)
    A = m.A + m.B @ F + Q @ (m.C + m.D @ F)
    return StateSpaceModel(equations.rate * A, root * Q, root * m.B.T @ X, -m.D.T)


def four_block_plant(g: StateSpaceModel) -> GeneralizedPlant:
    """Return the generalised plant from (n, d, u) to (y, u + d, y + n): noise n on y, a disturbance d on u."""
    m = four_block(g)
    inputs = [Signal(f"noise {s.name}", s.unit) for s in g.outputs]
    inputs += [Signal(f"disturbance {s.name}", s.unit) for s in g.inputs]
    outputs = [*g.outputs, *(Signal(f"{s.name} total", s.unit) for s in g.inputs)]
    outputs += [Taken(f"{s.name} measured", s.unit, "y", s.name) for s in g.outputs]
    model = StateSpaceModel(m.A, m.B, m.C, m.D, m.dt, [*inputs, *g.inputs], outputs, g.states, where="synth ncf")
    return GeneralizedPlant(model, g.n_outputs, g.n_inputs)


def with_default_performance(plant: GeneralizedPlant, where: str) -> GeneralizedPlant:
    """Return the plant; one without w and z gets noise on y and a disturbance on u as w, y and the total u as z."""
    if not plant.n_w and not plant.n_z:
        return four_block_plant(plant.model)
    require_performance(plant, where, "or a bare plant, to judge its loop by the four-block gain")
    return plant


def _bare(model: StateSpaceModel) -> StateSpaceModel:
    """Return the model without units, which weights change."""
    return model.renamed(list(model.input_names), list(model.output_names))


def _weight(given: Any, g: StateSpaceModel, name: str) -> StateSpaceModel:
    """Return the weight on all channels, in the plant's time and with the plant's names on the plant's side."""
    where, first = f"synth ncf: {name}", name == "W1"
    names = list(g.input_names if first else g.output_names)
    n = len(names)
    w = weight_on_channels(np.eye(n) if given is None else given, n, g.dt, where)
    meets = w.n_outputs if first else w.n_inputs
    if meets != n:
        side = "outputs" if first else "inputs"
        raise InputError(where, f"{meets} {side}", f"{n}, or one input and one output")
    far = w.n_inputs if first else w.n_outputs
    free = names if far == n else [f"{name} {i + 1}" for i in range(far)]
    return w.renamed(free if first else names, names if first else free)


def _named_channels(loop: StateSpaceModel, shaped: StateSpaceModel) -> StateSpaceModel:
    ys, us = [s.name for s in shaped.outputs], [s.name for s in shaped.inputs]
    return loop.renamed(
        [*(f"noise on shaped {y}" for y in ys), *(f"disturbance on shaped {u}" for u in us)],
        [*(f"shaped {y}" for y in ys), *(f"shaped {u}" for u in us)],
    )
