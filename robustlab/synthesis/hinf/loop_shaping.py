r"""H-infinity loop shaping (Glover, McFarlane): the most robust controller of a plant shaped by weights.

:math:`\gamma_{min} = \sqrt{1 + \lambda_{max}(X Z)}` with the two Riccati solutions of the normalised coprime factors.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from robustlab.budget import one_thread
from robustlab.display import Facts
from robustlab.errors import InputError, NoTrustworthyNumber, error_context
from robustlab.norms import HinfNorm, bilinear_to_discrete, hinf_norm
from robustlab.result import Status
from robustlab.signals import Taken
from robustlab.statespace import Signal, StateSpaceModel, as_model, series
from robustlab.synthesis.hinf.mixed_sensitivity import weight_on_channels
from robustlab.synthesis.problem.certify import certified
from robustlab.synthesis.problem.design import Synthesis, limiting_channels
from robustlab.synthesis.problem.partition import GeneralizedPlant, require_performance
from robustlab.synthesis.problem.rebuilt_loop import named_controller, surely_stable
from robustlab.uncertainty.distances import (
    CoprimeMargin,
    CoprimeRiccati,
    continuous_models,
    coprime_margin,
    coprime_riccati,
    four_block,
)

# Ratio of the verified gamma to the one requested above which digits count as lost.
SHAPED_LOSS = 1.001


@dataclass(frozen=True, eq=False, kw_only=True)
class NcfSynthesis(Synthesis):
    r"""A loop-shaping design.

    ``K = W1 K_shaped W2`` is for the plant as given, ``u = K y`` with positive feedback; ``closed_loop`` is the loop of
    that plant with noise on y and a disturbance on u, whose norm is not minimised. ``gamma`` bounds

    .. math:: \left\| \begin{bmatrix} G_s \\ I \end{bmatrix} (I - K_s G_s)^{-1}
        \begin{bmatrix} K_s & I \end{bmatrix} \right\|_\infty

    Attributes
    ----------
    gamma_min
        The smallest gamma of any controller, exact.
    factor
        The requested ratio: ``gamma <= factor gamma_min``.
    margin
        Verified coprime stability margin of the shaped loop, ``1/gamma``; above about 0.25 the shape of the loop is
        kept.
    K_shaped, shaped_plant
        Controller of the shaped plant and that plant, ``W2 G W1``.
    """

    quantities: ClassVar[Mapping[str, Any]] = {
        **Synthesis.quantities, **dict.fromkeys(("gamma_min", "factor"), float),
    }  # fmt: skip
    saved = (*Synthesis.saved, "gamma_min", "factor", "margin", "K_shaped", "shaped_plant")

    gamma_min: float
    factor: float
    margin: CoprimeMargin
    K_shaped: StateSpaceModel
    shaped_plant: StateSpaceModel

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
    r"""Design the loop-shaping controller of largest, or nearly largest, coprime stability margin.

    Sign of K: ``u = K y`` with *positive* feedback, as everywhere in this package and in the literature on this method.
    For negative feedback, ``u = K_n (r - y)``, take ``K_n = -K``.

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
        Both the loop of the shaped plant and that of the plant as given were rebuilt and verified. A discrete plant is
        solved through the bilinear map, which keeps the margin exactly, and verified in discrete time.

    Raises
    ------
    InputError
        ``factor`` not above 1, weights whose sizes or sample times do not fit.
    NoTrustworthyNumber
        A mode of the shaped plant that cannot be stabilised (a weight may have cancelled it), a loop that was not
        verified.

    References
    ----------
    McFarlane, Glover 1992; Skogestad, Postlethwaite 2005, section 9.4.1, eqs 9.74 to 9.78 (general D there too).

    Examples
    --------
    >>> lag = StateSpaceModel([[0.0]], [[1.0]], [[1.0]], [[0.0]])
    >>> design = ncf(lag, factor=1.05)
    >>> round(design.gamma_min, 6), design.gamma <= 1.05 * design.gamma_min, design.status.value
    (1.414214, True, 'certified')
    """
    where = "synth ncf"
    if not 1 < factor <= 1e6:
        raise InputError(where, f"factor is {factor}", "a number above 1, such as 1.1, of at most 1e6")
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
    return NcfSynthesis(
        K=K,
        gamma=gamma,
        closed_loop=loop,
        status=Status.INACCURATE if doubt else Status.CERTIFIED,
        reason=doubt or proved,
        limit=limiting_channels(_named_channels(shaped_plant.close(inner), shaped), margin.frequency),
        plant=plant,
        method="ncf",
        gamma_min=gamma_min,
        factor=factor,
        margin=margin,
        K_shaped=inner,
        shaped_plant=shaped,
    )


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


def _named_channels(loop: StateSpaceModel, shaped: StateSpaceModel) -> StateSpaceModel:
    ys, us = [s.name for s in shaped.outputs], [s.name for s in shaped.inputs]
    return loop.renamed(
        [*(f"noise on shaped {y}" for y in ys), *(f"disturbance on shaped {u}" for u in us)],
        [*(f"shaped {y}" for y in ys), *(f"shaped {u}" for u in us)],
    )


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
