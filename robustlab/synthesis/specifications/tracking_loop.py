"""The closed loop of a model and a controller with references."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from robustlab.display import Displayable, Facts, listed, number
from robustlab.errors import InputError
from robustlab.feedback import SIGNS, Sign, closing
from robustlab.signals import Signal, Taken
from robustlab.statespace import StateSpaceModel, as_model
from robustlab.uncertainty.lft import UncertainModel

TAKES = {-1: "r - y", 1: "y"}  # input of a controller without a stored sign, by the sign of the feedback
REFERRED = {-1: "u = K (r - y)", 1: "u = K (y - r)"}  # the same with references


@dataclass(frozen=True, eq=False)
class ClosedLoop(Displayable):
    """The tracking loop of a model and a controller.

    Attributes
    ----------
    model
        The loop as an uncertain model, without blocks for a certain model.
    loop
        The control law and its source.
    """

    model: UncertainModel
    loop: str

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
    of = (
        {s.name: s.name for s in fed}
        if by_name
        else {s.name: y.name for s, y in zip(fed, loop.plant.outputs, strict=True)}
    )
    word = {} if len(own) > 1 or loop.sign in own else dict.fromkeys(of, TAKES[loop.sign])
    takes = [
        Taken(s.name, s.unit, word.get(s.name, getattr(s, "takes", "")), of[s.name]) if s.name in of else s
        for s in K.inputs
    ]
    control_law = loop.said if own else loop.said.replace(SIGNS[loop.sign], REFERRED[loop.sign], 1)
    return K.renamed(inputs=takes), control_law


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
