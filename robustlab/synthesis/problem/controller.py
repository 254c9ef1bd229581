"""A controller as designs return it and files store it: what its inputs take, and the proved gain of its loop."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import InitVar, dataclass, field
from typing import Any

from robustlab.display import Displayable, Facts, number
from robustlab.errors import InputError
from robustlab.provenance import Traced
from robustlab.result import Status
from robustlab.signals import Taken, law
from robustlab.statespace import StateSpaceModel, as_model


@dataclass(frozen=True, eq=False)
class Controller(Displayable, Traced):
    """A controller whose inputs record the sign with which it closes a loop (`law`).

    Attributes
    ----------
    K, gamma, status, method
        The controller, from measurements to controls; verified closed-loop H-infinity norm for the generalised plant it
        was designed on, None where none was; how much it can be trusted; the design method, for example ``"mixsyn"``.
    takes
        Not stored: what the inputs take of the plant's signals, one word for all or one for each: ``"y"`` (u = K y),
        ``"r - y"`` (u = K (r - y)), ``"-y"``, ``"y - r"`` or ``"r"``. Left out: as K's inputs record it; designs do.
    design
        The design it comes from, whose claims go into its file, for `robustlab.verify`; None of other controllers, and
        of one that was read from a file.

    Raises
    ------
    InputError
        No such word, or another number of words than inputs.

    Examples
    --------
    >>> pi = StateSpaceModel([[0.0]], [[1.0]], [[2.0]], [[3.0]], inputs=["omega"], outputs=["u"])
    >>> Controller(pi, takes="r - y").law
    'u = K (r - y)'
    """

    K: StateSpaceModel
    gamma: float | None = None
    status: Status = Status.INCONCLUSIVE
    method: str = ""
    takes: InitVar[str | Sequence[str] | None] = None
    design: Any = field(default=None, repr=False)

    def __post_init__(self, takes: str | Sequence[str] | None) -> None:
        object.__setattr__(self, "K", as_model(self.K, "Controller: K"))
        if takes is None:
            return
        if not isinstance(takes, str | Sequence) or not all(isinstance(word, str) for word in takes):
            raise InputError("Controller: takes", repr(takes), "a word as in 'r - y', or a list of one for each input")
        words = [takes] * self.K.n_inputs if isinstance(takes, str) else list(takes)
        if len(words) != self.K.n_inputs:
            raise InputError("Controller: takes", f"{len(words)} words", f"one, or {self.K.n_inputs}")
        of = [s.of if isinstance(s, Taken) else s.name for s in self.K.inputs]
        inputs = [Taken(s.name, s.unit, word, name) for s, word, name in zip(self.K.inputs, words, of, strict=True)]
        object.__setattr__(self, "K", self.K.renamed(inputs))

    @property
    def law(self) -> str:
        """The feedback law, ``u = K (r - y)`` for example; empty where unknown."""
        return law(self.K.inputs)

    def to_model(self) -> StateSpaceModel:
        return self.K

    def facts(self) -> Facts:
        said = self.law or "not known: state it when closing a loop"
        return [("gamma", number(self.gamma, digits=6)), ("method", self.method), ("loop", said), *self.K.facts()]

    def to_json(self) -> dict[str, object]:
        return {"K": self.K, "gamma": self.gamma, "status": self.status, "method": self.method, "law": self.law}
