"""Linear plants in descriptor form, E(p) x' = F(p) x + G(p) u, and their exact parametric uncertainty."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from robustlab.arrays import Array
from robustlab.dynamics.descriptor_elimination import ROUNDING, closed_descriptor, solved, with_outputs
from robustlab.dynamics.parameters import Parameter, parameter_ranges
from robustlab.dynamics.plant_base import Plant
from robustlab.errors import InputError
from robustlab.statespace import StateSpaceModel
from robustlab.uncertainty.blocks import RealScalar
from robustlab.uncertainty.lft import UncertainModel
from robustlab.uncertainty.reduction import rank_factors


@dataclass(frozen=True)
class Descriptor:
    """Matrices of ``E x' = F x + G u``, ``y = C x + D u``; shapes (n_x, n_x), (n_x, n_u), (n_y, n_x), (n_y, n_u)."""

    E: ArrayLike
    F: ArrayLike
    G: ArrayLike
    C: ArrayLike
    D: ArrayLike | None = None


@dataclass(frozen=True, eq=False)
class AffineEquations:
    """Equations of a `LinearPlant` as numbers: ``M(p) = M_0 + sum_k p_k M_k`` for each of E, F, G, C, D."""

    names: tuple[str, ...]  # the parameters p_k
    # E, F, G, C, D -> array of shape (1 + number of parameters, rows, columns): M_0 first
    coefficients: Mapping[str, Array]
    fixed: Mapping[str, float]  # values of the parameters that may enter otherwise, at which M_0 was taken

    def __call__(self, values: Mapping[str, float]) -> Descriptor:
        """Return the matrices; raise InputError if a fixed parameter has another value."""
        for name, value in self.fixed.items():
            if values[name] != value:
                found = f"{name} = {values[name]:g}"
                raise InputError("equations from a file", found, f"{value:g}: what it does there is not known")
        weights = np.array([1.0, *(values[name] for name in self.names)])
        return Descriptor(**{key: np.tensordot(weights, given, 1) for key, given in self.coefficients.items()})


@dataclass(frozen=True, eq=False, repr=False)
class LinearPlant(Plant):
    """A linear plant, defined by a function from its parameters to a `Descriptor`."""

    # From {parameter name: value}. Every entry must be affine in the parameters: a quotient belongs into E.
    equations: Callable[[Mapping[str, float]], Descriptor]
    # Parameters without tolerance that may enter in any way: tooth counts, a screw's lead.
    exact: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in self.exact:
            if self.parameters[name].tolerance:
                found = f"relative tolerance {self.parameters[name].tolerance:g}"
                hint = "give the tolerance to the inertias or constants that it acts through"
                raise InputError(f"{self.name}: {name}", found, "no tolerance: it is taken as exact", hint)
        self._check_affine()
        self.state_space()

    def state_space(self) -> StateSpaceModel:
        """Return ``A = E^-1 F, B = E^-1 G, C, D`` at the nominal parameters."""
        e, f, g, c, d = self.matrices(self.values)
        rates = solved(e, np.hstack([f, g]), self.name)
        n = len(self.states)
        return StateSpaceModel(
            rates[:, :n], rates[:, n:], c, d, 0.0, self.inputs, self.outputs, self.states, where=self.name
        )

    def matrices(self, values: Mapping[str, float]) -> list[Array]:
        """Return E, F, G, C, D at the values of all parameters, checked."""
        where, wanted = f"{self.name}: equations", "matrices that are affine in the parameters"
        try:
            form = self.equations(values)
        except ZeroDivisionError:
            hint = "bring the quotient to the left-hand side (into E)"
            raise InputError(where, "a division by a parameter", wanted, hint) from None
        if not isinstance(form, Descriptor):
            raise InputError(where, f"returned a {type(form).__name__}", "a Descriptor")
        n, n_u, n_y = len(self.states), len(self.inputs), len(self.outputs)
        shapes = {"E": (n, n), "F": (n, n), "G": (n, n_u), "C": (n_y, n), "D": (n_y, n_u)}
        matrices = []
        for name, shape in shapes.items():
            given = getattr(form, name)
            try:
                matrix = np.zeros(shape) if given is None else np.array(given, dtype=float)
            except (TypeError, ValueError):  # rows of several lengths, a text, a complex number
                raise InputError(where, f"{name} is no matrix of numbers", f"{shape}") from None
            if matrix.shape != shape:
                raise InputError(where, f"{name} is {matrix.shape}", f"{shape}")
            if not np.isfinite(matrix).all():
                raise InputError(where, f"{name} has NaN or infinite entries", "finite numbers")
            matrices.append(matrix)
        return matrices

    def affine_equations(self) -> AffineEquations:
        cleared = {name: value if name in self.exact else 0.0 for name, value in self.values.items()}
        names = tuple(name for name in self.parameters if name not in self.exact)
        constant, *at_units = (self.matrices(p) for p in (cleared, *({**cleared, name: 1.0} for name in names)))
        terms = [constant, *([there - here for there, here in zip(m, constant, strict=True)] for m in at_units)]
        stacked = {key: np.stack([term[i] for term in terms]) for i, key in enumerate("EFGCD")}
        return AffineEquations(names, stacked, {name: self.values[name] for name in self.exact})

    to_model = state_space

    def derivative(self, x: ArrayLike, u: ArrayLike) -> Array:
        state, force = self.point(x, u)
        model = self.state_space()
        return model.A @ state + model.B @ force

    def output(self, x: ArrayLike, u: ArrayLike) -> Array:
        state, force = self.point(x, u)
        model = self.state_space()
        return model.C @ state + model.D @ force

    def uncertain(
        self, outputs: Sequence[str] | None = None, ranges: Mapping[str, tuple[float, float]] | None = None
    ) -> UncertainModel:
        """Return the set of all models whose parameters lie within their tolerances, as an exact and minimal LFT."""
        # Březina 2010, eqs 10.1-10.4; with absolute deltas the coefficients there must be -1/L in the rows of R, L, Kb
        # and 1/J in those of Km, Kf, J, as here. R is scaled by the half widths above nominal.
        n, n_u, n_y = len(self.states), len(self.inputs), len(self.outputs)
        spans = parameter_ranges(self.parameters, ranges or {}, self.name, self.exact)
        form = self.affine_equations()
        left: list[Array] = [np.zeros((n + n_y, 0))]
        right: list[Array] = [np.zeros((0, 2 * n + n_u))]
        blocks: list[RealScalar] = []
        for k, name in enumerate(form.names, 1):
            if name not in spans:
                continue
            e, f, g, c, d = (terms[k] for terms in form.coefficients.values())
            part = np.block([[f, g, -e], [c, d, np.zeros((n_y, n))]])
            columns, rows = rank_factors(part, ROUNDING * np.abs(part).max(initial=0.0))
            if columns.shape[1]:
                size = np.abs(columns).max(axis=0)  # the largest entry of each column is one
                left.append(columns / size)
                right.append(spans[name].radius * size[:, None] * rows)
                blocks.append(RealScalar(name, columns.shape[1], spans[name]))
        count = sum(b.rows for b in blocks)
        e = self.matrices(self.values)[0]
        parts = np.hstack(left), np.vstack(right), np.zeros((count, count))
        return with_outputs(closed_descriptor(self.state_space(), e, *parts, blocks, self.name), outputs)

    def _check_affine(self) -> None:
        """Check that the equations equal their affine form at two points; two detect powers of a parameter."""
        form = self.affine_equations()
        varied = {name: self.values[name] for name in form.names}
        weights = np.array([1.0, *varied.values()])
        for scale in (1.0, 1.75):
            there = self.matrices(self.values | {name: scale * value for name, value in varied.items()})
            for name, found in zip("EFGCD", there, strict=True):
                terms = form.coefficients[name]
                affine = terms[0] + scale * np.tensordot(weights[1:], terms[1:], 1)
                bound = scale * np.tensordot(np.abs(weights), np.abs(terms), 1)
                if (np.abs(found - affine) > ROUNDING * bound).any():
                    where, wrong = f"{self.name}: equations", f"{name} is not affine in the parameters"
                    hint = "bring a quotient to the left-hand side (into E); give a product a parameter of its own"
                    raise InputError(where, wrong, "sums of constant multiples of parameters", hint)


def tied_plant(plant: LinearPlant, groups: Iterable[tuple[str, tuple[str, ...]]]) -> LinearPlant:
    """Return the plant with one further parameter s = 1 for each group, which scales all of the group."""
    parameters, scaled = dict(plant.parameters), plant.values
    tied: dict[str, tuple[str, ...]] = {}
    for label, names in groups:
        members = [plant.parameters[name] for name in names]
        widest = max((p.tolerance for p in members), default=0.0)
        if len(names) < 2 or not widest:
            continue
        parameters |= {p.name: replace(p, tolerance=0.0) for p in members}
        sources = "; ".join(dict.fromkeys(p.source for p in members))
        parameters[label] = Parameter(label, 1.0, "", widest, sources, "common factor", "positive")
        tied[label] = names
    if not tied:
        return plant
    factored = with_factors(plant.equations, plant.parameters, scaled, tied)
    return replace(plant, parameters=parameters, equations=factored)


def with_factors(
    equations: Callable[[Mapping[str, float]], Any], names: Collection[str], scaled: Mapping[str, float],
    tied: Mapping[str, Sequence[str]],
) -> Callable[[Mapping[str, float]], Any]:  # fmt: skip
    """Return the equations with further parameters, each a common factor of the parameters tied to its label."""

    def changed(p: Mapping[str, float]) -> Any:
        values = {name: p[name] for name in names}
        for label, members in tied.items():
            for name in members:
                values[name] += scaled[name] * (p[label] - 1.0)
        return equations(values)

    return changed
