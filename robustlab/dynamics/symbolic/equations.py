"""Equations of a user-defined plant in CasADi: M(q) q'' = f(q, q', u, p) or x' = f(x, u, p), and y = h(x, u, p)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, get_args

import numpy as np

from robustlab.dynamics.parameters import Parameter, Role, Sign, overridden
from robustlab.dynamics.plant_base import PortPlace
from robustlab.dynamics.symbolic.symbolic_plant import Equations, SymbolicPlant, labels, tape_of
from robustlab.errors import DependencyMissing, InputError, did_you_mean
from robustlab.signals import MAX_NAME
from robustlab.statespace import Signal

NONE = "none"
ROLES = (*(role for role in get_args(Role) if role), NONE)
# Default sign of a parameter with a role.
SIGNS: dict[str, Sign] = {
    "inertia": "positive",
    "viscous-friction": "nonnegative",
    "torque-constant": "either",
    "resistance": "positive",
    "inductance": "positive",
    "stiffness": "nonnegative",
    "input-gain": "either",
}
# Unit of a joint's coordinate -> units of its velocity and force.
JOINT_UNITS = {"m": ("m/s", "N"), "rad": ("rad/s", "N m")}
# A mass matrix is checked at zero and twice as many states; relative tolerance of its symmetry.
PROBES = 5
SYMMETRIC = 1e-9


class PlantEquations:
    r"""Builds a plant from parameters, signals and equations.

    The expressions are CasADi's (``pip install 'robustlab[casadi]'``), in the symbols that the methods return. Values
    and exact Jacobians are compiled once; the plant does not need CasADi and can be stored.

    Parameters
    ----------
    name
        Name of the plant.

    Raises
    ------
    DependencyMissing
        CasADi is not installed.

    Examples
    --------
    A mass on a spring:

    >>> p = PlantEquations("spring")
    >>> m = p.parameter("m", 2.0, "kg", tolerance=0.1, role="inertia", meaning="mass", source="assumed")
    >>> k = p.parameter("k", 50.0, "N/m", meaning="stiffness", source="assumed")
    >>> F = p.input("F", "N")
    >>> x, v = p.joint("x", "v", "m")
    >>> p.motion(m, F - k * x)
    >>> p.output("x", x, "m")
    >>> p.plant(m=5.0).derivative([0.1, 0.0], [0.0])
    array([ 0., -1.])
    """

    def __init__(self, name: str) -> None:
        self._where = _title(name, "PlantEquations", "name of the plant")
        try:
            import casadi
        except ImportError:
            where = f"{self._where}: its equations need CasADi"
            raise DependencyMissing(where, "pip install 'robustlab[casadi]'") from None
        self._ca: Any = casadi
        self._parameters: dict[str, Parameter] = {}
        self._inputs: list[Signal] = []
        self._states: list[Signal] = []
        self._outputs: dict[str, tuple[Any, str]] = {}
        self._symbols: dict[str, Any] = {}
        self._joints: list[tuple[str, str, str]] = []
        self._currents: list[str] = []
        self._pushes: dict[str, Any] = {}
        self._rates: dict[str, Any] = {}
        self._motion: tuple[Any, Any] | None = None

    def parameter(
        self,
        name: str,
        value: float,
        unit: str = "",
        *,
        tolerance: float = 0.0,
        role: str | None = None,
        meaning: str = "",
        source: str = "",
        sign: Sign | None = None,
    ) -> Any:
        """Add a physical parameter, as of `robustlab.dynamics.Parameter`; return its symbol.

        ``role``: effect that may act on it, ``"none"`` for none; required with a tolerance.
        ``sign``: physical sign; default by the role: an inertia is ``"positive"``.
        """
        where = f"{self._where}: parameter {name!r}"
        if role is None and tolerance:
            raise InputError(where, "a tolerance, but no role", f"role= one of {_listed(ROLES)}")
        if role is not None and role not in ROLES:
            raise InputError(where, f"role {role!r}", f"one of {_listed(ROLES)}", did_you_mean(str(role), ROLES))
        if sign is not None and sign not in get_args(Sign):
            choices = get_args(Sign)
            raise InputError(where, f"sign {sign!r}", f"one of {_listed(choices)}", did_you_mean(str(sign), choices))
        kept: Any = "" if role in (None, NONE) else role
        sign = sign or SIGNS.get(kept, "any")
        symbol = self._new(name, "parameter", unit)
        self._parameters[name] = Parameter(name, value, unit, tolerance, source, meaning, sign, kept)
        return symbol

    def input(self, name: str, unit: str = "") -> Any:
        """Add an input; return its symbol."""
        symbol = self._new(name, "input", unit)
        self._inputs.append(Signal(name, unit))
        return symbol

    def joint(self, position: str, velocity: str, unit: str) -> tuple[Any, Any]:
        """Add a coordinate in ``"m"`` or ``"rad"`` and its velocity, where forces can act; return both symbols."""
        if unit not in JOINT_UNITS:
            hint = "write the coordinate in SI units: forces at it are in N or N m"
            raise InputError(f"{self._where}: joint {position!r}", f"unit {unit!r}", 'one of "m", "rad"', hint)
        q, v = self._new(position, "joint"), self._new(velocity, "joint")
        self._states += [Signal(position, unit), Signal(velocity, JOINT_UNITS[unit][0])]
        self._joints.append((position, velocity, unit))
        return q, v

    def state(self, name: str, unit: str = "", *, current: bool = False) -> Any:
        """Add a state; return its symbol. ``current``: one in A whose rate must contain a `voltage`."""
        if current and unit != "A":
            raise InputError(f"{self._where}: state {name!r}", f"a current in {unit!r}", '"A"')
        symbol = self._new(name, "state", unit)
        self._states.append(Signal(name, unit))
        if current:
            self._currents.append(name)
        return symbol

    def force(self, velocity: Any) -> Any:
        """Return the symbol of the force at a joint, given by its velocity: ``(... + p.force(v)) / m``."""
        return self._push(velocity, [v for _, v, _ in self._joints], "velocity of a joint")

    def voltage(self, current: Any) -> Any:
        """Return the symbol of the voltage at a current: ``(u - R * i + p.voltage(i)) / L``."""
        return self._push(current, self._currents, "current")

    def motion(self, mass_matrix: Any, forces: Any) -> None:
        r"""Set the equations of motion :math:`M(q) \ddot q = f(q, \dot q, u, p)` of all joints, in their order.

        ``forces``: all including Coriolis and centrifugal ones, without those of effects.
        """
        n = len(self._joints)
        if not n:
            raise InputError(f"{self._where}: motion", "no joint", "p.joint(...) before it")
        if self._motion is not None:
            raise InputError(f"{self._where}: motion", "given twice", "all joints in one p.motion(...)")
        matrix = self._matrix(mass_matrix, (n, n), "motion: mass matrix")
        self._motion = matrix, self._matrix(forces, (n, 1), "motion: forces")

    def rate(self, state: Any, expression: Any) -> None:
        """Set the rate of a state, given by its symbol or name; that of a joint's position is its velocity."""
        name = self._name_of(state)
        names = [s.name for s in self._states]
        place = f"{self._where}: rate"
        if name not in names:
            raise InputError(place, f"{name!r} is no state", f"one of {_listed(names)}", did_you_mean(name, names))
        positions = {q: v for q, v, _ in self._joints}
        if name in positions:
            raise InputError(place, f"a rate of the position {name!r}", f"none: it is {positions[name]!r}")
        if name in self._rates:
            raise InputError(place, f"{name!r} has two rates", "one")
        self._rates[name] = self._matrix(expression, (1, 1), f"rate of {name}")

    def output(self, name: str, expression: Any, unit: str = "") -> None:
        """Add an output: an expression in states, inputs and parameters."""
        _title(name, self._where, "output")
        if name in self._outputs:
            raise InputError(f"{self._where}: output {name!r}", "given twice", "one of that name")
        _check_unit(unit, f"{self._where}: output {name!r}")
        self._outputs[name] = self._matrix(expression, (1, 1), f"output {name}"), unit

    def plant(self, **given: Any) -> SymbolicPlant:
        """Build the plant, with other parameters as values or ``(value, relative tolerance)``."""
        parameters = overridden(self._parameters.values(), given, self._where)
        if not self._states:
            raise InputError(self._where, "no state", "p.joint(...) or p.state(...)")
        if not self._outputs:
            raise InputError(self._where, "no output", "p.output(name, expression, unit)")
        outputs = tuple(Signal(name, unit) for name, (_, unit) in self._outputs.items())
        equations = self._equations(parameters, outputs)
        return SymbolicPlant(self._where, parameters, tuple(self._inputs), outputs, tuple(self._states), equations)

    def _equations(self, parameters: dict[str, Parameter], signals: Sequence[Signal]) -> Equations:
        """Compile tapes of rates, outputs and local models, with the places where forces act."""
        ca, name = self._ca, self._where
        x, u, p = (
            ca.vertcat(*(self._symbols[s] for s in names)) if names else ca.SX(0, 1)
            for names in ([s.name for s in self._states], [s.name for s in self._inputs], list(parameters))
        )
        places = self._places()
        pushes = [self._pushes.setdefault(place.name, ca.SX.sym(f"push {place.name}")) for place in places]
        force = ca.vertcat(*pushes) if pushes else ca.SX(0, 1)
        outputs = ca.vertcat(*(e for e, _ in self._outputs.values()))
        self._check_symbols(pushes)
        rates, jacobian, push = self._differentiated(x, u, force, parameters)
        self._check_affine(push, places)
        zero = ca.SX.zeros(len(pushes))
        rates, jacobian, push = (ca.substitute(e, force, zero) if pushes else e for e in (rates, jacobian, push))
        c, d = ca.jacobian(outputs, x), ca.jacobian(outputs, u)
        a, b = jacobian[:, : x.numel()], jacobian[:, x.numel() :]
        blocks = (rates, outputs, a, b, c, d, push)
        rows = ca.vertcat(*(ca.vec(ca.densify(block).T) for block in blocks))
        titles = labels(self._states, self._inputs, signals, places)
        rows, everything = ca.cse(rows), ca.vertcat(x, u, p)
        motion, shown, along = (
            tape_of(everything, of, len(parameters), name, named.__getitem__)
            for of, named in ((ca.cse(rates), titles), (ca.cse(outputs), titles[len(self._states) :]), (rows, titles))
        )
        return Equations(motion, shown, along, places)

    def _places(self) -> tuple[PortPlace, ...]:
        """Return the places where forces and voltages act; check that they enter the rates."""
        for _, velocity, _ in self._joints if self._motion is None else ():
            if velocity in self._rates and velocity not in self._pushes:
                where, expected = f"{self._where}: joint velocity {velocity!r}", f'(... + p.force("{velocity}")) / mass'
                found = "no force can act there: its rate is without p.force"
                raise InputError(where, found, expected, "or make the coordinate two plain states with p.state")
        for current in self._currents:
            if current not in self._pushes:
                found = "no voltage can act there: its rate is without p.voltage"
                raise InputError(f"{self._where}: current {current!r}", found, f'(... + p.voltage("{current}")) / L')
        joints = tuple(PortPlace(v, "joint", JOINT_UNITS[unit][1], q) for q, v, unit in self._joints)
        return joints + tuple(PortPlace(i, "current", "V") for i in self._currents)

    def _differentiated(self, x: Any, u: Any, force: Any, parameters: dict[str, Parameter]) -> tuple[Any, Any, Any]:
        """Return rates (n_x), their Jacobian by x and u (n_x, n_x + n_u) and by the forces (n_x, n_ports)."""
        # The accelerations a of M a = f have the derivatives M^-1 (f' - M' a): M is factorised once.
        ca = self._ca
        rates = dict(self._rates)
        for position, velocity, _ in self._joints:
            rates[position] = self._symbols[velocity]
        joints = [v for _, v, _ in self._joints]
        moved = joints if self._motion is not None else []
        missing = [s.name for s in self._states if s.name not in rates and s.name not in moved]
        if missing:
            kind, motion = (
                ("the velocity of a joint", " or p.motion(M, f)") if missing[0] in joints else ("a state", "")
            )
            expected = f"p.rate({missing[0]!r}, expression){motion}"
            raise InputError(f"{self._where}: {missing[0]!r}", f"{kind} without a rate", expected)
        z = ca.vertcat(x, u, force)
        rows = {name: (expression, ca.jacobian(expression, z)) for name, expression in rates.items()}
        if self._motion is not None:
            matrix, forces = self._motion
            both = next((v for v in joints if v in self._rates), None)
            if both is not None:
                raise InputError(f"{self._where}: {both!r}", "p.rate and p.motion for one joint", "one of them")
            n = len(self._joints)
            if matrix.shape[0] != n:
                found = f"of {matrix.shape[0]} joints, and {n - matrix.shape[0]} came later"
                raise InputError(f"{self._where}: motion", found, "p.joint(...) of all joints before it")
            self._check_mass_matrix(matrix, parameters)
            forces = forces + force[:n]
            factor = ca.ldl(matrix)
            a = ca.ldl_solve(forces, *factor)
            held = ca.SX.sym("a", n)
            rest = ca.jacobian(forces - ca.mtimes(matrix, held), z)
            slopes = ca.sparsify(ca.ldl_solve(ca.substitute(rest, held, a), *factor))
            rows |= {v: (a[k], slopes[k, :]) for k, v in enumerate(joints)}
        found = [rows[s.name] for s in self._states]
        jacobian = ca.vertcat(*(slope for _, slope in found))
        split = x.numel() + u.numel()
        return ca.vertcat(*(rate for rate, _ in found)), jacobian[:, :split], jacobian[:, split:]

    def _check_symbols(self, pushes: list[Any]) -> None:
        """Check that all symbols belong to the plant, and that outputs and masses contain no forces."""
        ca = self._ca
        known = {s.element_hash() for s in self._symbols.values()}
        forces = {s.element_hash() for s in pushes}
        expressions = {f"rate of {name}": e for name, e in self._rates.items()}
        if self._motion is not None:
            expressions |= {"motion: mass matrix": self._motion[0], "motion: forces": self._motion[1]}
        expressions |= {f"output {name}": e for name, (e, _) in self._outputs.items()}
        for title, expression in expressions.items():
            for symbol in ca.symvar(expression):
                key = symbol.element_hash()
                if key in known or (key in forces and title.startswith("rate of ")):
                    continue
                where = f"{self._where}: {title}"
                if key in forces:
                    raise InputError(where, f"it depends on {symbol.name()!r}", "forces in rates of states only")
                found = f"the symbol {symbol.name()!r} is no part of the plant"
                loop = "an unknown that depends on itself is an algebraic loop: solve for it, or make it a state"
                hint = did_you_mean(symbol.name(), tuple(self._symbols)) or loop
                raise InputError(where, found, f"symbols of {_listed(self._symbols)}", hint)

    def _check_affine(self, push: Any, places: tuple[PortPlace, ...]) -> None:
        """Check that forces enter the rates linearly."""
        forces = {f.element_hash(): name for name, f in self._pushes.items()}
        for symbol in self._ca.symvar(push):
            if symbol.element_hash() in forces:
                where = f"{self._where}: {forces[symbol.element_hash()]!r}"
                raise InputError(where, "its force does not enter the rates linearly", "rates = ... + b * force")
        for k, place in enumerate(places):
            if push[:, k].nnz() == 0:
                found = "a force that moves nothing"
                raise InputError(f"{self._where}: {place.name!r}", found, "it in the state's rate")

    def _check_mass_matrix(self, matrix: Any, parameters: dict[str, Parameter]) -> None:
        """Check that the mass matrix is symmetric at all probes, and positive definite at one (it may hold states)."""
        names, where = list(self._symbols), f"{self._where}: motion: mass matrix"
        function = self._ca.Function("M", [self._ca.vertcat(*self._symbols.values())], [matrix])
        draw = np.random.default_rng(0).uniform(-1.0, 1.0, (PROBES, len(names)))
        smallest: list[float] = []
        for row in (0.0 * draw[0], *draw, *np.abs(draw)):
            point = [parameters[n].value if n in parameters else row[k] for k, n in enumerate(names)]
            values = np.array(function(point).full())
            if not np.isfinite(values).all():
                continue
            gap = np.abs(values - values.T)
            if gap.max() > SYMMETRIC * np.abs(values).max():
                i, j = np.unravel_index(int(np.argmax(gap)), gap.shape)
                raise InputError(where, f"entry [{i}, {j}] is not entry [{j}, {i}]", "a symmetric matrix")
            smallest.append(float(np.linalg.eigvalsh(values)[0]))
        if smallest and max(smallest) <= 0:
            raise InputError(where, f"an eigenvalue of {max(smallest):.3g}", "a positive definite matrix")

    def _new(self, name: str, kind: str, unit: str = "") -> Any:
        _title(name, self._where, kind)
        if name in self._symbols:
            raise InputError(f"{self._where}: {kind} {name!r}", "a name that is used already", "unique names")
        _check_unit(unit, f"{self._where}: {kind} {name!r}")
        self._symbols[name] = self._ca.SX.sym(name)
        return self._symbols[name]

    def _push(self, state: Any, known: Sequence[str], kind: str) -> Any:
        name = self._name_of(state)
        if name not in known:
            hint = did_you_mean(name, tuple(known))
            raise InputError(f"{self._where}: {name!r}", f"no {kind}", f"one of {_listed(known)}", hint)
        if self._motion is not None and name not in self._currents:
            raise InputError(f"{self._where}: force at {name!r}", "in a plant with p.motion", "none: it acts by itself")
        return self._pushes.setdefault(name, self._ca.SX.sym(f"push {name}"))

    def _name_of(self, symbol: Any) -> str:
        """Return the name of a state given by its symbol or name, or the argument as text."""
        if isinstance(symbol, self._ca.SX) and symbol.shape == (1, 1):
            for name, known in self._symbols.items():
                if known.element_hash() == symbol.element_hash():
                    return name
        return str(symbol)

    def _matrix(self, given: Any, shape: tuple[int, int], what: str) -> Any:
        """Return ``given`` as an expression of the shape; join rows of lists."""
        ca = self._ca
        where = f"{self._where}: {what}"
        if isinstance(given, ca.MX):
            raise InputError(where, "an MX expression", "SX: the symbols that p.parameter, p.joint ... return")
        try:
            if isinstance(given, (list, tuple)):
                rows = [ca.horzcat(*row) if isinstance(row, (list, tuple)) else row for row in given]
                found = ca.SX(ca.vertcat(*rows))
            else:
                found = ca.SX(given)
        except (NotImplementedError, TypeError, ValueError, RuntimeError):
            raise InputError(where, f"{type(given).__name__}", "numbers and expressions of CasADi (SX)") from None
        if found.shape == (1, shape[0]) and shape[1] == 1:
            found = found.T
        if found.shape != shape:
            size = "one expression" if shape == (1, 1) else f"shape {shape}"
            raise InputError(where, f"shape {found.shape}", size)
        return found


def _title(name: Any, where: str, kind: str) -> str:
    if not isinstance(name, str) or not name.strip() or len(name) > MAX_NAME:
        raise InputError(where, f"{kind} {name!r}", f"a text of 1 to {MAX_NAME} characters")
    return name


def _check_unit(unit: Any, where: str) -> None:
    if not isinstance(unit, str):
        raise InputError(where, f"unit {unit!r}", "a text; empty where there is none")


def _listed(names: Any) -> str:
    return ", ".join(repr(n) for n in names) or "none"
