r"""A data sheet as steady-state data: does a plant with an electrical part agree with its printed operating points?

At constant speed v, current i, voltage u and load torque T the rates of speed and current vanish, and a linear plant
:math:`E \dot x = F x + G u` leaves two balances, for the thesis' motor

.. math:: K_m i - K_f \omega - T = 0, \qquad u - R i - K_b \omega = 0.

Whatever a point states is put in. A balance without unknowns is checked; two balances that share their only unknown are
checked together, with the unknown eliminated. A balance is contradicted where no parameters and no quantities within
their tolerances fulfil it. It is then asked which effect of the catalogue could mend it: a parameter's role scaled by
the factor that closes it, without breaking another balance, or a structural effect of the size that is missing.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np

from robustlab import checks
from robustlab.arrays import Array
from robustlab.dynamics.effects.catalogue import catalogue
from robustlab.dynamics.effects.contract import Effect
from robustlab.dynamics.linear_plant import LinearPlant
from robustlab.errors import InputError
from robustlab.result import Evidence, Status
from robustlab.shown import Facts, number

QUANTITIES = ("voltage", "speed", "current", "torque")
SPEED_UNITS = {"rad/s": "N m", "m/s": "N"}  # unit of a speed -> unit of the torque or force against it
MOST_UNCERTAIN = 14  # parameters and quantities with tolerances in one balance; all corners of their box are looked at
DISTINCT_SPEEDS = 1.2  # ratio of two speeds from which on they tell dry from viscous friction
SLIPS = {"speed": (2 * math.pi / 60, "rpm"), "current": (1e-3, "mA"), "torque": (1e-3, "mN m")}
ROUNDING = 1e-9


@dataclass(frozen=True)
class SheetPoint:
    """One operating point of a data sheet; what is None is not stated there.

    Attributes
    ----------
    name
        For example ``"no-load"``.
    voltage, speed, current, torque
        In V, rad/s (m/s for a linear axis), A, N m (N): the torque of the load, positive against a positive speed.
    tolerance
        Relative: what the printed numbers may be off.
    source
        Where they are printed.

    Raises
    ------
    InputError
        Fewer than two quantities, NaN or infinite ones, a tolerance outside 0..1.
    """

    name: str
    voltage: float | None = None
    speed: float | None = None
    current: float | None = None
    torque: float | None = None
    tolerance: float = 0.01
    source: str = ""

    def __post_init__(self) -> None:
        where = f"point {self.name!r}"
        for name, value in (*self.stated.items(), ("tolerance", self.tolerance)):
            checks.number(f"{where}: {name}", value, "a finite number")
        if not 0 <= self.tolerance < 1:
            raise InputError(f"{where}: tolerance", f"{self.tolerance:g}", "a share from 0 to below 1: 0.01 for 1 %")
        if len(self.stated) < 2:
            have = ", ".join(self.stated) or "nothing"
            raise InputError(where, f"states {have}", f"at least two of {', '.join(QUANTITIES)}")

    @property
    def stated(self) -> dict[str, float]:
        """The quantities that the point states."""
        return {name: value for name in QUANTITIES if (value := getattr(self, name)) is not None}


@dataclass(frozen=True)
class Explanation(Evidence):
    """An effect that would close a contradicted balance on its own."""

    effect: str  # its name in the catalogue, for example ``"viscous-friction"``
    # what its parameters are to be multiplied with; NaN for a structural effect, which has no nominal value
    factor: float
    parameters: Mapping[str, float]  # parameter (or size of the structural effect) -> value that closes the balance
    unit: str  # unit of those values where they share one, else empty
    # balances (``"point: balance"``) that agreed before and no longer do; such an effect is no explanation
    breaks: tuple[str, ...] = ()


@dataclass(frozen=True)
class BalanceCheck(Evidence):
    """One balance of one point."""

    # point, balance: names; the balance is ``"torque"``, ``"voltage"``, or ``"both"`` with ``eliminated`` as their
    # common unknown
    point: str
    balance: str
    eliminated: str  # that unknown, or empty
    unit: str
    # residual, misfit: what is left over at the nominal parameters, in ``unit``, and its share of the sum of all terms,
    # 0..1
    residual: float
    misfit: float
    # low, high: range of the residual over all tolerances; contradicted where it does not hold zero
    low: float
    high: float
    contradicted: bool  # whether it is
    # effect, factor: the parameters' role that explains it best, and how many times too large (or small) its nominal
    # value is: >= 1; empty and NaN where it is not contradicted or nothing explains it alone
    effect: str = ""
    factor: float = math.nan
    explanations: tuple[Explanation, ...] = ()  # all that would close it, those that break nothing first

    quantities: ClassVar[Mapping[str, Any]] = {"factor": "1", "rivals": [str], "explained_by": str}

    @property
    def rivals(self) -> tuple[str, ...]:
        """Other effects that explain it and break nothing."""
        return tuple(e.effect for e in self.explanations if not e.breaks and e.effect != self.effect)

    @property
    def in_words(self) -> str:
        """Whether it is contradicted, and what explains that."""
        if not self.contradicted:
            return "agrees within the tolerances"
        named = [f"{self.effect} ({number(self.factor, digits=3)} times off)"] if self.effect else []
        return f"contradicted; explained by {' or '.join([*named, *self.rivals]) or 'no effect alone'}"

    def to_json(self) -> dict[str, object]:
        """All fields, the rivals, and ``explained_by``: all effects that explain it, in one text."""
        names = [name for name in (self.effect, *self.rivals) if name]
        return {**vars(self), "rivals": self.rivals, "explained_by": ", ".join(names)}


@dataclass(frozen=True)
class FrictionLevel(Evidence):
    """What the points say about friction: drive minus load at every speed other than zero."""

    # points, speed, loss: names, |speed| (n,), and the torque that is lost there (n,), positive
    points: tuple[str, ...]
    speed: Array
    loss: Array
    separable: bool  # whether two speeds differ by 20 % or more, so that dry and viscous friction can be told apart
    # viscous, coulomb: where separable, both from one line through the points; else each if it were the only one
    viscous: float
    coulomb: float


@dataclass(frozen=True)
class SteadyStateComparison(Evidence):
    """Result of `compare_steady_state`."""

    status: Status  # CONVERGED; INCONCLUSIVE where the points leave no balance to check
    plant: str  # name of the plant
    checks: tuple[BalanceCheck, ...]  # all balances that the points fix
    unchecked: tuple[str, ...]  # points that state too little to check any
    friction: FrictionLevel | None  # what the points say about friction; None where none does
    # point -> remark, where one number read in another unit would mend a balance and break none
    suspected_units: Mapping[str, str]
    # parameters, unit: nominal parameters and the unit of torques, for the summary
    parameters: Mapping[str, float]
    unit: str

    quantities: ClassVar[Mapping[str, Any]] = {
        "plant": str,
        "points": {"*": dict.fromkeys(("torque", "voltage", "both"), BalanceCheck)},
        "contradictions": "1",
        "unchecked": [str],
        "friction": FrictionLevel,
        "suspected_units": {"*": str},
        "parameters": {"*": float},
        "unit": str,
    }

    @property
    def contradictions(self) -> tuple[BalanceCheck, ...]:
        """The contradicted balances."""
        return tuple(c for c in self.checks if c.contradicted)

    def headline(self) -> str:
        """How many balances were checked, and how many are contradicted."""
        places = len({c.point for c in self.checks}) + len(self.unchecked)
        return f"{len(self.checks)} balances checked at {places} points; {len(self.contradictions)} contradicted"

    def facts(self) -> Facts:
        """What each balance says, and what would explain a contradicted one."""
        return [(f"{c.point}: {c.balance} balance", c.in_words) for c in self.checks]

    def numbers(self) -> dict[str, Any]:
        """All fields; the checks as point -> balance -> check."""
        return self.to_json()

    def summary(self) -> str:
        """The result as text, a line for each finding."""
        lines = [_told(c, self) for c in self.checks]
        lines += [f"{name}: states too little to check a balance" for name in self.unchecked]
        lines += [f"{name}: {remark}" for name, remark in self.suspected_units.items()]
        return "\n".join([*lines, *_friction_told(self.friction, self.unit)])

    def to_json(self) -> dict[str, object]:
        """All fields; the checks as point -> balance -> check."""
        points: dict[str, dict[str, object]] = {}
        for c in self.checks:
            points.setdefault(c.point, {})[c.balance] = c
        data: dict[str, object] = {**vars(self), "points": points, "contradictions": len(self.contradictions)}
        del data["checks"]
        return data


def compare_steady_state(plant: LinearPlant, points: Sequence[SheetPoint]) -> SteadyStateComparison:
    """Check printed operating points against the equilibrium of a plant.

    Parameters
    ----------
    plant
        One input in V, one state in rad/s or m/s, at most one in A, no spring; its parameters' roles name what may be
        wrong, their tolerances how far they may be off.
    points
        Operating points with any two or more of voltage, speed, current and torque.

    Raises
    ------
    InputError
        A plant without such an equilibrium, no points, names used twice, a current where the plant has none.

    References
    ----------
    Březina 2010, section 7.2 and 10.1.1, where the no-load speed is covered by 35 % of the viscous friction.

    Examples
    --------
    >>> from robustlab.dynamics import plant
    >>> no_load = SheetPoint("no-load", voltage=42.0, speed=788.54, current=0.0927, torque=0.0)
    >>> found = compare_steady_state(plant("dc-motor", Km=(0.052, 0.05), Kb=(0.052, 0.05)), [no_load])
    >>> [(c.balance, c.effect, round(c.factor, 1), c.rivals) for c in found.contradictions]
    [('torque', 'viscous-friction', 7.9, ('coulomb-friction',))]
    """
    balances = _Balances(plant)
    _check_points(points, balances)
    ones: dict[str, float] = {}
    found = [check for p in points for check in balances.check(p, ones)]
    named = tuple(_explained(check, balances, points, found) if check.contradicted else check for check in found)
    checked = {c.point for c in found}
    return SteadyStateComparison(
        status=Status.CONVERGED if found else Status.INCONCLUSIVE,
        plant=plant.name,
        checks=named,
        unchecked=tuple(p.name for p in points if p.name not in checked),
        friction=_friction(balances, points),
        suspected_units=_suspected_units(balances, points, found),
        parameters=plant.values,
        unit=balances.torque_unit,
    )


def _check_points(points: Sequence[SheetPoint], balances: _Balances) -> None:
    where = f"steady state of {balances.plant.name}"
    if not points:
        raise InputError(where, "no points", "at least one operating point")
    names = [p.name for p in points]
    for name in names:
        if names.count(name) > 1:
            raise InputError(where, f"two points named {name!r}", "names used once")
    if "i" not in balances.columns:
        for p in points:
            if p.current is not None:
                raise InputError(
                    f"{where}: point {p.name!r}", "a current, which this plant does not have", "no current"
                )


# --- the balances ----------------------------------------------------------------------------------------------------


class _Balances:
    """The equilibrium of a plant as rows over (voltage, speed, current, torque)."""

    def __init__(self, plant: LinearPlant) -> None:
        if not isinstance(plant, LinearPlant):
            raise InputError("steady state", type(plant).__name__, "a linear plant, for example rl.plant('dc-motor')")
        self.plant = plant
        where = f"steady state of {plant.name}"
        volts = [k for k, s in enumerate(plant.inputs) if s.unit == "V"]
        speeds = [k for k, s in enumerate(plant.states) if s.unit in SPEED_UNITS]
        currents = [k for k, s in enumerate(plant.states) if s.unit == "A"]
        for what, have, most in (
            ("inputs in V", volts, 1),
            ("speeds (rad/s or m/s)", speeds, 1),
            ("currents (A)", currents, 1),
        ):
            if len(have) > most or (not have and have is not currents):
                raise InputError(where, f"{len(have)} {what}", "a motor: one voltage, one speed, at most one current")
        self.torque_unit = SPEED_UNITS[plant.states[speeds[0]].unit]
        self.columns = {"v": speeds[0], **({"i": currents[0]} if currents else {})}
        self._volt = volts[0]
        form = self.plant.equations(self.plant.values)
        e, f = np.asarray(form.E, float), np.asarray(form.F, float)
        self._rows = {"torque": int(np.abs(e[:, speeds[0]]).argmax())}
        if currents:
            self._rows["voltage"] = int(np.abs(e[:, currents[0]]).argmax())
        others = [k for k in range(len(plant.states)) if k not in self.columns.values()]
        pulled = [plant.states[k].name for k in others if np.abs(f[list(self._rows.values()), k]).any()]
        if pulled:
            raise InputError(where, f"a force that depends on {', '.join(pulled)}", "a plant that can turn steadily")
        self.roles: dict[str, tuple[str, ...]] = {}
        for name, p in plant.parameters.items():
            if p.role and p.value:
                self.roles[p.role] = (*self.roles.get(p.role, ()), name)

    def rows(self, values: Mapping[str, float]) -> dict[str, Array]:
        """Balance -> coefficients (4,) of voltage, speed, current, torque at these parameter values."""
        form = self.plant.equations(values)
        f, g = np.asarray(form.F, float), np.asarray(form.G, float)
        result: dict[str, Array] = {}
        for name, k in self._rows.items():
            current = f[k, self.columns["i"]] if "i" in self.columns else 0.0
            result[name] = np.array([g[k, self._volt], f[k, self.columns["v"]], current, -float(name == "torque")])
        return result

    def scaled(self, scale: Mapping[str, float]) -> dict[str, float]:
        """Nominal parameter values with those of some roles scaled."""
        factor = {name: scale[role] for role, names in self.roles.items() if role in scale for name in names}
        return {name: value * factor.get(name, 1.0) for name, value in self.plant.values.items()}

    def fixed(self, point: SheetPoint) -> list[tuple[str, str]]:
        """(balance, eliminated quantity) of everything that a point fixes."""
        nominal = self.rows(self.plant.values)
        missing = [k for k, name in enumerate(QUANTITIES) if getattr(point, name) is None]
        unknown = {name: [k for k in missing if row[k]] for name, row in nominal.items()}
        found = [(name, "") for name, ks in unknown.items() if not ks]
        if not found and len(unknown) == 2 and all(len(ks) == 1 for ks in unknown.values()):
            (first,), (second,) = unknown.values()
            if first == second:
                found.append(("both", QUANTITIES[first]))
        return found

    def residual(self, which: tuple[str, str], values: Mapping[str, float], q: Array) -> tuple[float, float]:
        """Residual of a balance at quantities q (4,), with zero for the eliminated one, and the sum of its terms."""
        rows, (name, eliminated) = self.rows(values), which
        if name != "both":
            terms = rows[name] * q
            return float(terms.sum()), float(np.abs(terms).sum())
        k = QUANTITIES.index(eliminated)
        torque, voltage = rows["torque"], rows["voltage"]
        terms = torque[k] * voltage * q, voltage[k] * torque * q
        return float((terms[0] - terms[1]).sum()), float(np.abs(terms).sum())

    def check(self, point: SheetPoint, scale: Mapping[str, float]) -> list[BalanceCheck]:
        """All balances that a point fixes, with the parameters of some roles scaled."""
        units = {"torque": self.torque_unit, "voltage": "V", "both": ""}
        checks = []
        values, q = self.scaled(scale), _vector(point)
        for which in self.fixed(point):
            value, size = self.residual(which, values, q)
            corners = self._corners(which, values, q, point.tolerance)
            slack = ROUNDING * size
            outside = min(corners) > slack or max(corners) < -slack
            misfit = abs(value) / size if size else 0.0
            checks.append(
                BalanceCheck(
                    point.name, *which, units[which[0]], value, misfit, min(corners), max(corners), bool(outside)
                )
            )
        return checks

    def _corners(self, which: tuple[str, str], values: Mapping[str, float], q: Array, tolerance: float) -> list[float]:
        """Residual at all corners of the box of tolerances, where a balance that is affine in each has its extremes."""
        here = self.residual(which, values, q)[0]
        moving = []
        for name, p in self.plant.parameters.items():
            width = (values[name] or 1.0) * p.tolerance
            moved = {**values, name: values[name] + width}
            if p.tolerance and self.residual(which, moved, q)[0] != here:
                moving.append((name, width))
        stated = [k for k in range(4) if q[k] and tolerance]
        if len(moving) + len(stated) > MOST_UNCERTAIN:
            raise InputError(
                f"steady state of {self.plant.name}",
                f"{len(moving)} uncertain parameters in one balance",
                f"at most {MOST_UNCERTAIN - len(stated)}",
            )
        found = []
        for signs in itertools.product((-1.0, 1.0), repeat=len(moving)):
            moved = {**values, **{name: values[name] + s * r for (name, r), s in zip(moving, signs, strict=True)}}
            for flips in itertools.product((-1.0, 1.0), repeat=len(stated)):
                shifted = q.copy()
                shifted[stated] *= 1 + tolerance * np.array(flips)
                found.append(self.residual(which, moved, shifted)[0])
        return found


def _vector(point: SheetPoint) -> Array:
    return np.array([getattr(point, name) or 0.0 for name in QUANTITIES])


# --- what would explain it -------------------------------------------------------------------------------------------


def _explained(
    check: BalanceCheck, balances: _Balances, points: Sequence[SheetPoint], before: Sequence[BalanceCheck]
) -> BalanceCheck:
    """The same check with its explanations, the best role first."""
    point = next(p for p in points if p.name == check.point)
    sound = {(c.point, c.balance) for c in before if not c.contradicted}
    roles: list[tuple[int, float, Explanation]] = []
    for role, names in balances.roles.items():
        factor = _closing_factor(check, balances, point, role)
        if factor is None:
            continue
        after = [c for p in points for c in balances.check(p, {role: factor})]
        breaks = tuple(f"{c.point}: {c.balance}" for c in after if c.contradicted and (c.point, c.balance) in sound)
        values = {name: factor * balances.plant.values[name] for name in names}
        units = {balances.plant.parameters[name].unit for name in names}
        explanation = Explanation(role, factor, values, units.pop() if len(units) == 1 else "", breaks)
        roles.append((len(breaks), sum(c.misfit for c in after), explanation))
    roles.sort(key=lambda entry: entry[:2])
    ordered = [entry[2] for entry in roles]
    structural = _structural(check, balances, point)
    ordered = [e for e in ordered if not e.breaks] + structural + [e for e in ordered if e.breaks]
    best = next((e for e in ordered if not e.breaks and not math.isnan(e.factor)), None)
    effect, factor = ("", math.nan) if best is None else (best.effect, max(best.factor, 1 / best.factor))
    return replace(check, effect=effect, factor=factor, explanations=tuple(ordered))


def _closing_factor(check: BalanceCheck, balances: _Balances, point: SheetPoint, role: str) -> float | None:
    """The positive factor on a role's parameters, nearest to one, that makes the residual zero; None if there is none.

    Every balance is affine in each parameter, two balances together are quadratic in a common factor: three values fix
    the polynomial.
    """
    which, q = (check.balance, check.eliminated), _vector(point)
    at = [balances.residual(which, balances.scaled({role: s}), q) for s in (0.5, 1.0, 2.0)]
    values, size = [v for v, _ in at], max(s for _, s in at)
    if max(values) - min(values) <= ROUNDING * size:
        return None
    coefficients = np.polyfit([0.5, 1.0, 2.0], values, 2)
    coefficients[np.abs(coefficients) <= ROUNDING * size] = 0.0
    roots = np.roots(coefficients)
    real = roots[np.abs(roots.imag) <= ROUNDING * np.abs(roots)].real
    positive = real[real > ROUNDING]
    return float(min(positive, key=lambda s: abs(math.log(s)))) if len(positive) else None


def _structural(check: BalanceCheck, balances: _Balances, point: SheetPoint) -> list[Explanation]:
    """Effects that the plant does not have and that would take the missing torque or voltage.

    Dry friction may stand in for the viscous one, wholly or in part: one point shows their sum only.
    """
    if check.balance == "torque":
        loss = _loss(balances, point)
        if loss is None or loss <= 0:
            return []
        extra = loss if check.residual * _direction(point) < 0 else abs(check.residual)
        return [Explanation(e.id, math.nan, {"Fc": extra}, check.unit) for e in _losses("torque")]
    if check.balance == "voltage" and point.voltage and check.residual * point.voltage > 0:
        drop = {"drop": abs(check.residual)}
        return [Explanation(e.id, math.nan, drop, "V") for e in _losses("voltage")]
    return []


def _losses(balance: str) -> list[Effect]:
    """Effects of the catalogue that take a constant amount from a balance."""
    return [e for e in catalogue().values() if e.constant_loss == balance]


def _direction(point: SheetPoint) -> float:
    return math.copysign(1.0, point.speed or 0.0)


def _loss(balances: _Balances, point: SheetPoint) -> float | None:
    """Drive minus load in the direction of motion; None where the point does not show it."""
    if not point.speed or ("torque", "") not in balances.fixed(point):
        return None
    row, q = balances.rows(balances.plant.values)["torque"], _vector(point)
    q[QUANTITIES.index("speed")] = 0.0
    return float(row @ q) * _direction(point)


def _friction(balances: _Balances, points: Sequence[SheetPoint]) -> FrictionLevel | None:
    found = [(p.name, abs(p.speed), loss) for p in points if p.speed and (loss := _loss(balances, p)) is not None]
    found = [entry for entry in found if entry[2] > 0]
    if not found:
        return None
    names, speed, loss = zip(*found, strict=True)
    v, torque = np.array(speed, float), np.array(loss, float)
    if v.max() >= DISTINCT_SPEEDS * v.min():
        viscous, coulomb = np.polyfit(v, torque, 1)
        return FrictionLevel(names, v, torque, True, float(viscous), float(coulomb))
    return FrictionLevel(names, v, torque, False, float(np.mean(torque / v)), float(np.mean(torque)))


def _suspected_units(
    balances: _Balances, points: Sequence[SheetPoint], found: Sequence[BalanceCheck]
) -> dict[str, str]:
    """Points where one number, read in another unit, mends a balance and breaks none."""
    remarks: dict[str, str] = {}
    for p in points:
        before = {c.balance: c.contradicted for c in found if c.point == p.name}
        for name, (factor, unit) in SLIPS.items():
            value = getattr(p, name)
            if not value:
                continue
            after = {c.balance: c.contradicted for c in balances.check(replace(p, **{name: value * factor}), {})}
            mended = [balance for balance, off in before.items() if off and not after[balance]]
            if mended and not any(off and not before[balance] for balance, off in after.items()):
                what = f"the {' and the '.join(mended)} balance"
                remarks[p.name] = f"{name} {value:g} looks like {unit}: as {value * factor:.4g} {what} would agree"
    return remarks


# --- in words --------------------------------------------------------------------------------------------------------


def _told(check: BalanceCheck, found: SteadyStateComparison) -> str:
    kind = f"both balances without the {check.eliminated}" if check.eliminated else f"{check.balance} balance"
    name = f"{check.point}, {kind}"
    if not check.contradicted:
        return f"{name}: agrees within the tolerances ({100 * check.misfit:.2g} % of its terms is left)"
    lines = [f"{name}: contradicted, {100 * check.misfit:.3g} % of its terms is left"]
    for e in check.explanations:
        size = ", ".join(f"{key} = {value:.3g} {e.unit}".rstrip() for key, value in e.parameters.items())
        if e.breaks:
            lines.append(f"  {e.effect} does not explain it: {size} would contradict {', '.join(e.breaks)}")
        elif math.isnan(e.factor):
            lines.append(f"  {e.effect} explains it as well: {size}")
        else:
            nominal = ", ".join(f"{found.parameters[key]:.3g}" for key in e.parameters)
            word = "large" if e.factor < 1 else "small"
            times = max(e.factor, 1 / e.factor)
            lines.append(f"  {e.effect} explains it: {size} instead of {nominal}, {times:.2g} times too {word}")
    if not any(not e.breaks for e in check.explanations):
        lines.append("  no single parameter explains it")
    return "\n".join(lines)


def _friction_told(friction: FrictionLevel | None, unit: str) -> list[str]:
    if friction is None:
        return []
    per = {"N m": "N m s/rad", "N": "N s/m"}[unit]
    viscous, coulomb = f"{friction.viscous:.3g} {per}", f"{friction.coulomb:.3g} {unit}"
    if friction.separable:
        return [f"friction at {len(friction.points)} speeds: viscous {viscous}, dry {coulomb}"]
    split = f"viscous alone {viscous}, dry alone {coulomb}; one point cannot tell them apart"
    return [
        f"friction at one speed ({friction.speed[0]:.4g}), {friction.loss[0]:.3g} {unit} in all: {split}",
        "  measure the no-load current at half the voltage too: viscous friction halves it, dry friction leaves it",
    ]
