"""Closed-loop functions S, T, K S, S G with their bounds, and frequencies for figures of them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from robustlab.arrays import AnyArray, Array
from robustlab.display import Displayable, Facts, listed, number, with_units
from robustlab.errors import InputError, error_context
from robustlab.feedback import closing
from robustlab.linear_analysis.frequency import frequency_response
from robustlab.linear_analysis.structural import drop_unconnected, with_hidden
from robustlab.signals import Taken
from robustlab.statespace import StateSpaceModel, as_model, lower_lft
from robustlab.synthesis.problem.design import Synthesis

POINTS, SPAN = 400, 1e3  # of a figure: number of frequencies, and largest ratio of a pole in it to the median pole
# The weight of a mixed-sensitivity problem that bounds each function.
FUNCTIONS = {"S": "W1", "KS": "W2", "T": "W3", "SG": ""}


@dataclass(frozen=True, eq=False)
class LoopFunctions(Displayable):
    r"""The closed-loop functions of one loop, each with all states of the loop.

    .. math:: S: r \to r - y, \quad T: r \to y, \quad K S: r \to u, \quad S G: d \to y, \qquad S + T = I

    for a reference r on the measured output and a disturbance d on the plant's input.
    """

    S: StateSpaceModel  # sensitivity
    T: StateSpaceModel  # complementary sensitivity
    KS: StateSpaceModel  # control effort
    SG: StateSpaceModel  # disturbance response
    # W1, W2, W3 of a mixed-sensitivity design, on S, KS and T (else empty), and its verified gamma, the bound of
    # sigma_max(W1 S) and so on; NaN without weights.
    weights: Mapping[str, StateSpaceModel] = field(default_factory=dict)
    gamma: float = float("nan")

    def model(self, name: str) -> StateSpaceModel:
        """Return one function by its name, ``"S"``, ``"T"``, ``"KS"`` or ``"SG"``."""
        if name not in FUNCTIONS:
            raise InputError("loop functions", f"{name!r}", f"one of {', '.join(FUNCTIONS)}")
        return getattr(self, name)

    def gain(self, name: str, omega: ArrayLike) -> AnyArray:
        """Return the largest singular value of one function at ``omega`` in rad/s, shape (n_omega,)."""
        return np.linalg.norm(frequency_response(self.model(name), omega), 2, axis=(1, 2))

    def bound(self, name: str, omega: ArrayLike) -> AnyArray | None:
        """Return the bound of the largest singular value by weight and gamma, (n_omega,); None without a weight."""
        self.model(name)
        weight = self.weights.get(FUNCTIONS[name])
        if weight is None:
            return None
        sigma = np.linalg.svd(frequency_response(weight, omega), compute_uv=False)[:, -1]
        with np.errstate(divide="ignore"):  # fewer outputs than inputs bound some directions only
            return self.gamma / (sigma if weight.n_outputs >= weight.n_inputs else 0.0 * sigma)

    def is_stable(self) -> bool:
        """Return whether the loop is internally stable."""
        return self.S.is_stable()

    def facts(self) -> Facts:
        return [
            ("loop", with_hidden(f"{'stable' if self.is_stable() else 'unstable'}, {self.S.n_states} states", self.S)),
            ("outputs", with_units(self.T.outputs)),
            ("controls", with_units(self.KS.outputs)),
            ("gamma", number(self.gamma, digits=6)),
            ("weights", listed(self.weights)),
        ]


@error_context("loop_functions")
def loop_functions(G: Any, K: Any = None, *, sign: Literal[-1, 1] | None = None) -> LoopFunctions:
    r"""Return S, T, K S and S G of plant G and controller K, or of a design.

    .. math:: S = (I - s\, G K)^{-1}, \qquad T = I - S, \qquad r \to u: -s K S, \qquad d \to y: S G

    Parameters
    ----------
    G, K
        Plant and controller; or a design (`Synthesis`) alone, whose plant is the transfer from the controls to the
        measured signals of its generalised plant.
    sign
        s: -1 for ``u = K (r - y)``, 1 for ``u = K (y - r)``; left out: the sign stored with the controller, else -1.

    Returns
    -------
    LoopFunctions
        Each function with all states of the loop; with weights and gamma for a mixed-sensitivity design.

    Raises
    ------
    InputError
        Sizes or sample times that do not fit, an algebraic loop, a plant without or a design with a controller.

    Examples
    --------
    >>> integrator = StateSpaceModel([[0.0]], [[1.0]], [[1.0]], [[0.0]])
    >>> loop = loop_functions(integrator, StateSpaceModel([], [], [], [[2.0]]))
    >>> loop.is_stable(), loop.T.dc_gain().tolist(), loop.gain("S", [2.0]).round(6).tolist()
    (True, [[1.0]], [0.707107])
    """
    if isinstance(G, Synthesis):
        if K is not None or sign is not None:
            found = "a design with a controller or a sign"
            raise InputError("loop functions", found, "a design alone, or a plant and a controller")
        return _of_design(G)
    if K is None:
        raise InputError("loop functions: K", "none", "a controller of the plant, or a design alone")
    found = closing(as_model(G, "loop functions: G"), as_model(K, "loop functions: K"), sign, "loop functions")
    g, k, sign = found.plant, found.K, found.sign
    n_y, n_u = g.n_outputs, g.n_inputs
    # From (r, d, u) to (r - y, y, u, r - y) with y = G (u + d); K acts on e = r - y: u = K (y - r) is u = -K e.
    r, d, u = np.split(np.eye(n_y + 2 * n_u), [n_y, n_y + n_u])
    y = g.D @ (d + u)
    C = np.vstack([-g.C, g.C, np.zeros((n_u, g.n_states)), -g.C])
    plant = StateSpaceModel(g.A, g.B @ (d + u), C, np.vstack([r - y, y, u, r - y]), g.dt)
    loop = lower_lft(plant, StateSpaceModel(k.A, k.B, -sign * k.C, -sign * k.D, k.dt))
    references, errors = ([(f"{word} {s.name}", s.unit) for s in g.outputs] for word in "re")
    disturbances = [(f"d {s.name}", s.unit) for s in g.inputs]
    of_y, of_u = slice(n_y, 2 * n_y), slice(2 * n_y, None)

    def part(rows: slice, outputs: Any, columns: slice = slice(0, n_y), inputs: Any = references) -> StateSpaceModel:
        matrices = loop.A, loop.B[:, columns], loop.C[rows], loop.D[rows, columns]
        return StateSpaceModel(*matrices, loop.dt, inputs, outputs)

    return LoopFunctions(
        part(slice(0, n_y), errors), part(of_y, g.outputs), part(of_u, g.inputs),
        part(of_y, g.outputs, slice(n_y, None), disturbances),
    )  # fmt: skip


def _of_design(design: Synthesis) -> LoopFunctions:
    plant, weights = design.plant, dict(getattr(design, "weights", {}))
    measured = [s for s in plant.measurements if isinstance(s, Taken) and s.sign]  # without references
    inner = drop_unconnected(plant.model.select([s.name for s in plant.controls], [s.name for s in measured]))
    signs = np.diag([float(s.sign) for s in measured])  # r - y or y is measured
    found = loop_functions((signs @ inner).renamed(inner.inputs, [(s.of, s.unit) for s in measured]), design.K)
    return LoopFunctions(found.S, found.T, found.KS, found.SG, weights, design.gamma)


def frequencies(model: StateSpaceModel, points: int = POINTS, around: float | None = None) -> Array:
    """Return frequencies in rad/s for a figure, (points,): to a decade beyond the loop's poles and ``around``."""
    poles = model.poles()
    if model.is_discrete:
        poles = np.log(poles[np.abs(poles) > 1e-12].astype(complex)) / model.dt
    size = np.abs(poles)
    size = size[size > 1e-12 * size.max(initial=0.0)]
    middle = float(np.median(size)) if len(size) else 1.0
    near = size[(size <= SPAN * middle) & (size >= middle / SPAN)] if len(size) else np.array([1.0])
    low, high = float(near.min()) / 10, float(near.max()) * 10
    if around is not None and np.isfinite(around) and around > 0:
        low, high = min(low, around / 10), max(high, around * 10)
    if model.is_discrete:
        high = np.pi / model.dt
        low = min(low, high / 1e3)
    return np.geomspace(low, high, points)
