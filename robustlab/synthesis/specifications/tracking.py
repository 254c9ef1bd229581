r"""Tracking: the closed loop of a model and a controller with references, and weighted tracking problems.

A tracking problem is plant, requirements and disturbances as one weighted generalised plant:

.. math:: e = \frac{r - y_c}{\bar r}, \quad y = G\,(u + d), \quad
    z = \begin{bmatrix} W_1 e \\ W_2 u \\ W_3 y_c / \bar r \end{bmatrix}, \quad
    v = \begin{bmatrix} r \\ y_m + n \end{bmatrix}, \quad u = K v

with :math:`r = \bar r F \tilde r`, :math:`F = 1 / (s / \omega_r + 1)`. A gain to z of at most one meets every
requirement. Skogestad, Postlethwaite 2005, section 9.3; Březina 2010, eq. 10.15.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from robustlab import checks
from robustlab.arrays import Array
from robustlab.display import Displayable, Facts, listed, number
from robustlab.errors import InputError, did_you_mean
from robustlab.feedback import SIGNS, Sign, closing
from robustlab.linear_analysis.frequency import frequency_response
from robustlab.signals import Signal, Taken
from robustlab.statespace import StateSpaceModel, as_model, lower_lft, series
from robustlab.synthesis.problem.generalized_plant import GeneralizedPlant, side_by_side, signal_positions
from robustlab.synthesis.specifications.weight_design import stable_weight, weight_on_channels
from robustlab.uncertainty.lft import UncertainModel

Sizes = float | Mapping[str, float]
TAKES = {-1: "r - y", 1: "y"}  # input of a controller without a stored sign, by the sign of the feedback
FUNCTIONS = {"S": "W1", "KS": "W2", "T": "W3"}
REFERRED = {-1: "u = K (r - y)", 1: "u = K (y - r)"}  # the same with references


@dataclass(frozen=True, eq=False)
class ClosedLoop(Displayable):
    """The tracking loop of a model and a controller."""

    model: UncertainModel  # without blocks for a certain model
    loop: str  # the control law and its source

    quantities: ClassVar[Mapping[str, Any]] = {
        **UncertainModel.quantities, "spectral_abscissa": float, "nominally_stable": bool,
    }  # fmt: skip

    @property
    def spectral_abscissa(self) -> float:
        """Spectral abscissa of the nominal loop; negative where it is stable."""
        return self.model.nominal.spectral_abscissa()

    def numbers(self) -> dict[str, Any]:
        abscissa = self.spectral_abscissa
        return {**self.model.numbers(), "spectral_abscissa": abscissa, "nominally_stable": abscissa < 0}

    def headline(self) -> str:
        return f"nominally {'stable' if self.spectral_abscissa < 0 else 'unstable'}"

    def facts(self) -> Facts:
        return [
            ("loop", self.loop),
            ("inputs", listed(s.name for s in self.model.inputs)),
            ("outputs", listed(s.name for s in self.model.outputs)),
            ("rightmost pole of the nominal loop", number(self.spectral_abscissa, "1/s")),
        ]

    def to_json(self) -> dict[str, Any]:
        return {**self.model.to_json(), "loop": self.loop, "spectral_abscissa": self.spectral_abscissa}


def with_law(system: Any, controller: Any, sign: Sign | None = None) -> tuple[Any, str]:
    """Return the controller with the measured signal of each input, and the control law in words."""
    base = system if isinstance(system, UncertainModel) else as_model(system)
    K = as_model(controller, "controller")
    names = [s.name for s in base.outputs]
    fed = [s for s in K.inputs if not (isinstance(s, Taken) and not s.sign)]
    by_name = all((s.of if isinstance(s, Taken) else s.name) in names for s in fed)
    if K.n_outputs != len(base.inputs) or not (by_name or len(fed) == len(names)):
        found = f"{K.n_inputs} inputs and {K.n_outputs} outputs"
        sizes = f"{len(names)} and {len(base.inputs)}: an input per output of the model, and vice versa"
        raise InputError("controller", found, sizes)
    loop = closing(base, K, sign, "controller", None)
    own = {s.sign for s in fed if isinstance(s, Taken)}
    if by_name and own:
        return K, loop.said
    known = fed if by_name else loop.plant.outputs
    of = {s.name: y.name for s, y in zip(fed, known, strict=True)}
    word = {} if len(own) > 1 or loop.sign in own else dict.fromkeys(of, TAKES[loop.sign])
    takes = [
        Taken(s.name, s.unit, word.get(s.name, getattr(s, "takes", "")), of[s.name]) if s.name in of else s
        for s in K.inputs
    ]
    return K.renamed(inputs=takes), loop.said if own else loop.said.replace(SIGNS[loop.sign], REFERRED[loop.sign], 1)


def tracking_loop(system: Any, controller: Any) -> Any:
    """Return the closed loop of a model or an uncertain model and a controller with references, as an uncertain one."""
    base = system if isinstance(system, UncertainModel) else UncertainModel(as_model(system), [])
    K, _ = with_law(base, controller)
    takes: list[Any] = list(K.inputs)
    names = [s.name for s in base.outputs]
    m, (q, p) = base.M, base.delta_shape
    n_u, n_y = m.n_inputs - q, m.n_outputs - p
    # K acts on v = F r + S y; with its own inputs for references, S y is y.
    F, S = np.zeros((len(takes), n_y)), np.zeros((len(takes), n_y))
    referred = {s.of for s in takes if not s.sign}
    order = iter(range(n_y))
    for row, s in enumerate(takes):
        j = names.index(s.of) if s.of in names else next(order)
        S[row, j], F[row, j] = s.sign, 1.0 if not s.sign else 0.0 if s.of in referred else -s.sign
    w, r, u = np.split(np.eye(q + n_y + n_u), [q, q + n_y])
    into = np.vstack([w, u])
    through = m.D @ into
    C = np.vstack([m.C, np.zeros((n_u, m.n_states)), S @ m.C[p:]])
    D = np.vstack([through, u, F @ r + S @ through[p:]])
    inputs = [*m.inputs[:q], *(Signal(f"{s.name}_ref", s.unit) for s in base.outputs), *base.inputs]
    outputs = [*m.outputs, *base.inputs, *(Taken(f"{s.name} taken", s.unit, s.takes, s.of) for s in takes)]
    plant = StateSpaceModel(m.A, m.B @ into, C, D, m.dt, inputs, outputs, m.states, where="tracking loop")
    return UncertainModel(plant, base.blocks).close(K)


# --- tracking problems ------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class TrackingProblem(Displayable):
    """A weighted tracking problem."""

    uncertain: UncertainModel  # from [w of Delta; r; d; n; u] to [z of Delta; z; v], v: inputs of the controller
    base: UncertainModel  # the plant that was given
    controlled: tuple[Signal, ...]  # outputs with references
    measured: tuple[Signal, ...]  # outputs measured by the controller, in addition to the references
    weights: Mapping[str, StateSpaceModel]  # given weights of one channel by name `"W1"`, `"W2"`, `"W3"`
    shape: StateSpaceModel  # F, the spectrum of the references; 1 where they have no bandwidth
    # Sizes of these signals by name of their output or input; empty for none. Loads are inputs that are not controls.
    reference: Mapping[str, float]
    disturbance: Mapping[str, float]
    noise: Mapping[str, float]
    loads: Mapping[str, float]

    quantities: ClassVar[Mapping[str, Any]] = {
        "states": "1", "blocks": [str], "channels": "1", "measurements": "1", "controls": "1",
    }  # fmt: skip

    def numbers(self) -> dict[str, Any]:
        return {
            "states": self.uncertain.M.n_states, "blocks": [b.name for b in self.uncertain.blocks],
            "channels": self.uncertain.delta_shape[0], "measurements": self.n_meas, "controls": self.n_con,
        }  # fmt: skip

    def facts(self) -> Facts:
        plant, blocks = self.plant, self.uncertain.blocks
        return [
            ("the controller sees", ", ".join(s.name for s in plant.measurements)),
            ("it drives", ", ".join(f"{s.name} [{s.unit}]" for s in plant.controls)),
            ("size of the references", _in_words(self.reference, self.controlled)),
            ("of the disturbances", _in_words(self.disturbance, plant.controls)),
            ("of the loads", ", ".join(f"{name} {size:g}" for name, size in self.loads.items())),
            ("of the noise", _in_words(self.noise, plant.measurements)),
            ("uncertain", f"{len(blocks)} blocks, {self.uncertain.delta_shape[0]} channels"),
            ("states, weights included", str(self.uncertain.M.n_states)),
        ]

    @property
    def n_meas(self) -> int:
        return len(self.controlled) + len(self.measured)

    @property
    def n_con(self) -> int:
        return len(self.base.inputs) - len(self.loads)

    @property
    def plant(self) -> GeneralizedPlant:
        """The generalised plant with its perturbation channels and blocks."""
        return GeneralizedPlant(self.uncertain.M, self.n_meas, self.n_con, self.uncertain.blocks)

    @property
    def nominal(self) -> GeneralizedPlant:
        """The generalised plant at Delta = 0."""
        return GeneralizedPlant(self.uncertain.nominal, self.n_meas, self.n_con)

    def to_uncertain(self) -> UncertainModel:
        return self.uncertain

    def on(self, G: Any, **changes: Any) -> TrackingProblem:
        """Return the same problem for another plant or set with the same signals, without loads that it lacks."""
        bandwidth = -float(self.shape.A[0, 0]) if self.shape.n_states else None
        inputs = [s.name for s in (G if isinstance(G, UncertainModel) else as_model(G, "tracking problem: G")).inputs]
        loads = {name: size for name, size in self.loads.items() if name in inputs}
        given: dict[str, Any] = {name: getattr(self, name) for name in ("reference", "disturbance", "noise")}
        given |= {**self.weights, "reference_bandwidth": bandwidth, "loads": loads, **changes}
        return tracking_problem(G, [s.name for s in self.controlled], [s.name for s in self.measured], **given)

    def close(self, K: Any) -> UncertainModel:
        """Return the weighted loop under ``u = K v`` as an uncertain model from (r, d, n) to z."""
        return UncertainModel(lower_lft(self.uncertain.M, self.plant.fitted(K, "controller")), self.uncertain.blocks)

    def gains(self, K: Any, omega: ArrayLike) -> dict[str, Array]:
        """Return the largest singular values of S, K S, T of the nominal loop at ``omega`` in rad/s, (n_omega,)."""
        n_r = len(self.controlled)
        plain = self.on(self.base, W1=1.0, W2=1.0, W3=1.0, reference_bandwidth=None)
        response = frequency_response(plain.close(K).nominal, omega)[:, :, :n_r]
        parts = np.split(response, [n_r, n_r + self.n_con], axis=1)
        return {name: np.linalg.norm(part, 2, axis=(1, 2)) for name, part in zip(FUNCTIONS, parts, strict=True)}

    def bounds(self, omega: ArrayLike) -> dict[str, Array]:
        """Return the bounds ``1 / |W F|`` of the functions of `gains` that have a weight."""
        shaped = {name: series(self.shape, self.weights[w]) for name, w in FUNCTIONS.items() if w in self.weights}
        return {name: 1 / np.abs(frequency_response(weight, omega)[:, 0, 0]) for name, weight in shaped.items()}


@dataclass(frozen=True, eq=False)
class TrackingLoop(Displayable):
    """The nominal loop of a tracking problem under a design, for a figure with the bounds by its weights."""

    problem: TrackingProblem
    design: Any  # a `Synthesis`
    gamma: float | None  # verified gamma of the nominal loop if the design proves it

    def facts(self) -> Facts:
        return [("design", type(self.design).__name__), ("gamma of the nominal loop", number(self.gamma))]


def tracking_problem(
    G: Any,
    controlled: Sequence[str],
    measured: Sequence[str],
    *,
    W1: Any = None,
    W2: Any = None,
    W3: Any = None,
    reference: Sizes = 1.0,
    reference_bandwidth: float | None = None,
    disturbance: Sizes | None = None,
    noise: Sizes | None = None,
    loads: Mapping[str, float] | None = None,
) -> TrackingProblem:
    """Return the weighted tracking problem of a plant; see this module for the signals.

    ``G``: plant, whose inputs other than the loads are controls: StateSpaceModel, UncertainModel (its blocks stay) or
    python-control object.
    ``controlled``, ``measured``: names of outputs of G.
    ``W1``, ``W2``, ``W3``: stable weights of one channel, or numbers, on every channel of the relative error, of the
    control in its own unit, of the relative output. At least one.
    ``reference``: size of the references: a number, or one for each controlled output.
    ``reference_bandwidth``: omega_r in rad/s above which the references fall with 1 / omega (default: none).
    ``disturbance``: size of disturbances added to the controls, in their unit: a number, or one for some controls.
    ``noise``: size of the noise on the controller's inputs: a number for all, or sizes by name (a reference is called
    ``<name>_ref``).
    ``loads``: inputs of G that are not controls with their sizes: forces on the plant.
    Raises InputError: unknown names, sizes that are not positive, no weight, an unstable one, one of several channels.
    """
    base = G if isinstance(G, UncertainModel) else UncertainModel(as_model(G, "tracking problem: G"), [])
    c, m = _positions(controlled, base.outputs, "controlled"), _positions(measured, base.outputs, "measured")
    follow, seen = tuple(base.outputs[i] for i in c), tuple(base.outputs[i] for i in m)
    given = {"W1": W1, "W2": W2, "W3": W3}
    weights = {name: _weight(w, f"tracking problem: {name}", base.dt) for name, w in given.items() if w is not None}
    if not weights:
        raise InputError("tracking problem", "no weight", "at least one of W1, W2, W3")
    forces = _sizes("loads", loads, base.inputs)
    controls = [s for s in base.inputs if s.name not in forces]
    if not controls:
        raise InputError("tracking problem: loads", "every input of the plant", "one that is left for control")
    sizes = (
        _sizes("reference", reference, follow, whole=True),
        _sizes("disturbance", disturbance, controls),
        _sizes("noise", noise, [*(Signal(f"{s.name}_ref", s.unit) for s in follow), *seen]),
    )
    shape = _shape(reference_bandwidth, base.dt)
    problem = UncertainModel(_built(base, (c, m), sizes, forces, weights, shape), base.blocks)
    return TrackingProblem(problem, base, follow, seen, weights, shape, *sizes, forces)


def _built(
    base: UncertainModel, places: tuple[list[int], list[int]], sizes: Sequence[Mapping[str, float]],
    loads: Mapping[str, float], weights: Mapping[str, StateSpaceModel], shape: StateSpaceModel,
) -> StateSpaceModel:  # fmt: skip
    """Return the weighted model from [w; r; d; n; u] to [z of Delta; z; v]."""
    M, (q, p) = base.M, base.delta_shape
    follow, seen = ([base.outputs[i] for i in part] for part in places)
    controls = [Signal(s.name, s.unit) for s in base.inputs if s.name not in loads]
    reference, entering, noise = sizes[0], {**sizes[1], **loads}, sizes[2]
    n_r, n_u = len(follow), len(controls)
    size_r, size_d, size_n = (np.array(list(s.values())) for s in (reference, entering, noise))
    counts = (q, n_r, len(entering), len(noise), n_u)
    w, r, d, n, u = np.split(np.eye(sum(counts)), np.cumsum(counts)[:-1])
    # Inputs of M: its own w, the controls u + d, and the loads.
    names_u = [s.name for s in base.inputs]
    acting = _placed([s.name for s in controls], names_u) @ u + _placed(entering, names_u) @ (size_d[:, None] * d)
    noisy = _placed(noise, [*(f"{s.name}_ref" for s in follow), *(s.name for s in seen)]) @ (size_n[:, None] * n)
    into = np.vstack([w, acting])
    y_c, y_m = ([p + i for i in part] for part in places)
    C, T, none = M.C, M.D @ into, np.zeros((n_r, M.n_states))
    share = 1 / size_r[:, None]
    words = [f"{s.name}_ref" for s in follow] + [f"{name}_disturbance" for name in sizes[1]]
    words += [f"{name}, over its size" for name in loads] + [f"{name}_noise" for name in noise]
    inputs = [*M.inputs[:q], *(Signal(word, "1") for word in words), *controls]
    weighted = {
        "W1": ("error", follow, -share * C[y_c], r - share * T[y_c]),
        "W2": ("control", controls, np.zeros((n_u, M.n_states)), u),
        "W3": ("output", follow, share * C[y_c], share * T[y_c]),
    }
    one, rows = _shape(None, M.dt), [(C[:p], T[:p])]
    filters, outputs, states = [one] * p, [Signal(s.name, s.unit) for s in M.outputs[:p]], [*M.states]
    for name, weight in weights.items():
        word, part, *row = weighted[name]
        rows.append((row[0], row[1]))
        filters += [weight] * len(part)
        outputs += [Signal(f"{name} {word}: {s.name}") for s in part]
        states += [Signal(f"{name} {s.name} x{i + 1}") for s in part for i in range(weight.n_states)]
    rows += [(none, size_r[:, None] * r + noisy[:n_r]), (C[y_m], T[y_m] + noisy[n_r:])]
    out, direct = (np.vstack(part) for part in zip(*rows, strict=True))
    before = side_by_side(*[one] * q, *[shape] * n_r, *[one] * (sum(counts) - q - n_r))
    bare = StateSpaceModel(M.A, M.B @ into, out, direct, M.dt)
    joined = series(series(before, bare), side_by_side(*filters, *[one] * (n_r + len(seen))))
    states = [*(Signal(f"{s.name}_ref x{i + 1}") for s in follow for i in range(shape.n_states)), *states]
    outputs += [*(Taken(f"{s.name}_ref", s.unit, "r", s.name) for s in follow), *(Taken(*s) for s in seen)]
    matrices, where = (joined.A, joined.B, joined.C, joined.D), "tracking problem"
    return StateSpaceModel(*matrices, joined.dt, inputs, outputs, states, where=where)


def _placed(some: Iterable[str], names: Sequence[str]) -> Array:
    """Return the selection matrix of some signals among these names, shape (n_names, n_some)."""
    some = list(some)
    return np.array([[float(name == one) for one in some] for name in names]).reshape(len(names), len(some))


def _shape(bandwidth: float | None, dt: float) -> StateSpaceModel:
    """Return F as a model of one channel."""
    if bandwidth is None:
        return StateSpaceModel([], [], [], [[1.0]], dt)
    where = "tracking problem: reference_bandwidth"
    checks.number(where, bandwidth, "a positive number in rad/s", above=0)
    if dt:
        raise InputError(where, f"{bandwidth:g} rad/s for a discrete plant", "none: shape the reference by W1 instead")
    root = bandwidth**0.5
    return StateSpaceModel([[-bandwidth]], [[root]], [[root]], [[0.0]])


def _positions(names: Sequence[str], known: Sequence[Signal], what: str) -> list[int]:
    """Return the positions of the named outputs, each once."""
    names, where = [names] if isinstance(names, str) else list(names), f"tracking problem: {what}"
    if not names:
        raise InputError(where, "no output", f"some of {', '.join(s.name for s in known)}")
    for name in names:
        if names.count(name) > 1:
            raise InputError(f"{where} {name!r}", "named twice", "each output once")
    return signal_positions(names, [s.name for s in known], where)


def _sizes(what: str, given: Sizes | None, known: Sequence[Signal], whole: bool = False) -> dict[str, float]:
    """Return name -> positive size; ``whole``: one is required for every signal."""
    where, names = f"tracking problem: {what}", [s.name for s in known]
    if given is None:
        return {}
    table = dict(given) if isinstance(given, Mapping) else dict.fromkeys(names, given)
    for name, size in table.items():
        if name not in names:
            hint = did_you_mean(str(name), names)
            raise InputError(f"{where} {name!r}", "no such signal", f"one of {', '.join(names)}", hint)
        checks.number(f"{where} {name!r}", size, "a positive number", above=0)
    missing = [name for name in names if name not in table]
    if whole and missing:
        raise InputError(where, f"none for {', '.join(missing)}", "one for every controlled output")
    return {name: float(table[name]) for name in names if name in table}


def _weight(given: Any, where: str, dt: float) -> StateSpaceModel:
    """Return a stable weight of one channel in the plant's time."""
    w = weight_on_channels(given, 1, dt, where)
    if (w.n_inputs, w.n_outputs) != (1, 1):
        raise InputError(where, f"{w.n_inputs} inputs and {w.n_outputs} outputs", "one of each")
    return stable_weight(w, 1, dt, where)


def _in_words(sizes: Mapping[str, float], signals: Sequence[Signal]) -> str:
    """Return the sizes of signals with their units as text."""
    units = {s.name: s.unit for s in signals}
    return ", ".join(f"{name} {number(float(size), units.get(name, ''), 5)}" for name, size in sizes.items()) or "none"
