"""Nonlinear plants for tests: written in numpy, with derivatives by complex steps; nothing of the house is in them."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from robustlab.dynamics import LocalModels, NonlinearPlant, Parameter, PortPlace, Trim, overridden
from robustlab.statespace import Signal

STEP = 1e-30


@dataclass(frozen=True, eq=False, repr=False)
class ComplexStepPlant(NonlinearPlant):
    """``rates(x, u, forces, p)``, ``look(x, u, p)``, ``rest(p, **where) -> (x, u)``."""

    rates: Callable[..., Any]
    look: Callable[..., Any]
    rest: Callable[..., Any]
    places: tuple[PortPlace, ...] = ()

    @property
    def port_places(self):
        return self.places

    def derivative(self, x, u):
        return np.array(self.rates(*self.point(x, u), np.zeros(len(self.places)), self.values))

    def output(self, x, u):
        return np.array(self.look(*self.point(x, u), self.values))

    def local_models(self, x, u, values=None):
        return LocalModels(*(np.array([part]) for part in self._local(x[0], u[0], values or self.values)))

    def _local(self, x, u, p):
        n, m = len(x), len(u)
        z = np.concatenate([x, u, np.zeros(len(self.places))])

        def both(z):
            parts = z[:n], z[n : n + m], z[n + m :]
            return np.concatenate([np.array(self.rates(*parts, p)), np.array(self.look(*parts[:2], p))])

        slopes = np.array([(both(z + 1j * STEP * e)).imag / STEP for e in np.eye(len(z))]).T
        value = both(z)
        f, h = slopes[:n], slopes[n:]
        return value[:n], value[n:], f[:, :n], f[:, n : n + m], h[:, :n], h[:, n : n + m], f[:, n + m :]

    def jacobians(self, x, u):
        local = self._local(*self.point(x, u), self.values)
        return local[2], local[3], local[4], local[5]

    def equilibrium(self, **where):
        x, u = self.rest(self.values, **where)
        return Trim(self.name, x, u, self.output(x, u), float(np.abs(self.derivative(x, u)).max()))

    def with_parameters(self, **given):
        return replace(self, parameters=overridden(self.parameters.values(), given, self.name))


def made(name, parameters, inputs, outputs, states, rates, look, rest, places=()):
    """``parameters``: name -> (value, tolerance)."""
    signals = (tuple(Signal(s) for s in names.split()) for names in (inputs, outputs, states))
    found = {n: Parameter(n, v, "", t) for n, (v, t) in parameters.items()}
    return ComplexStepPlant(name, found, *signals, rates, look, rest, places)


G = 9.81


def cart_pole():
    """M(q) q'' with masses, a length and its square."""

    def rates(x, u, f, p):
        ml = p["m"] * p["l"]
        mass = np.array([[p["M"] + p["m"], ml * np.cos(x[2])], [ml * np.cos(x[2]), p["J"] + ml * p["l"]]])
        force = np.array(
            [
                u[0] + f[0] - p["b"] * x[1] + ml * x[3] ** 2 * np.sin(x[2]),
                ml * G * np.sin(x[2]) + f[1] - p["d"] * x[3],
            ]
        )
        a = np.linalg.solve(mass, force)
        return [x[1], a[0], x[3], a[1]]

    places = (PortPlace("v", "joint", "N", "x"), PortPlace("w", "joint", "N m", "a"))
    values = {"M": (1.0, 0.1), "m": (0.2, 0.1), "l": (0.5, 0.05), "J": (0.01, 0.1), "b": (0.1, 0.3), "d": (0.01, 0.3)}
    return made(
        "cart-pole", values, "F", "x a", "x v a w", rates, lambda x, u, p: [x[0], x[2]],
        lambda p: (np.zeros(4), np.zeros(1)), places,
    )  # fmt: skip


def arm():
    """Two links that gravity pulls: the torques that hold them follow the masses; a motor's current with its constant.

    The second joint has a motor with a current: L i' = u - R i - k w, torque k i.
    """

    def mass(q, p):
        c = np.cos(q[1])
        m22 = p["m2"] * p["a"] ** 2 + p["J"]
        m12 = m22 + p["m2"] * p["l"] * p["a"] * c
        return np.array([[p["m1"] * 0.04 + m22 + p["m2"] * (p["l"] ** 2 + 2 * p["l"] * p["a"] * c), m12], [m12, m22]])

    def weight(q, p):
        far = p["m2"] * p["a"] * np.cos(q[0] + q[1])
        return G * np.array([(0.2 * p["m1"] + p["m2"] * p["l"]) * np.cos(q[0]) + far, far])

    def rates(x, u, f, p):
        q, w, i = x[:2], x[2:4], x[4]
        h = p["m2"] * p["l"] * p["a"] * np.sin(q[1])
        coriolis = np.array([-h * w[1] * (2 * w[0] + w[1]), h * w[0] ** 2])
        torque = np.array([u[0], p["k"] * i])
        a = np.linalg.solve(mass(q, p), torque + f[:2] - weight(q, p) - coriolis - 0.3 * w)
        return [w[0], w[1], a[0], a[1], (u[1] + f[2] - p["R"] * i - p["k"] * w[1]) / p["L"]]

    def rest(p, q=(0.4, 0.7)):
        t = weight(np.array(q), p)
        return np.array([*q, 0.0, 0.0, t[1] / p["k"]]), np.array([t[0], p["R"] * t[1] / p["k"]])

    places = (
        PortPlace("w1", "joint", "N m", "q1"), PortPlace("w2", "joint", "N m", "q2"), PortPlace("i", "current", "V"),
    )  # fmt: skip
    values = {
        "m1": (2.0, 0.1), "m2": (1.0, 0.1), "l": (0.4, 0.02), "a": (0.2, 0.05), "J": (0.02, 0.1),
        "k": (0.5, 0.1), "R": (1.5, 0.1), "L": (1e-2, 0.2),
    }  # fmt: skip
    return made("arm", values, "t1 u2", "q1 q2", "q1 q2 w1 w2 i", rates, lambda x, u, p: [x[0], x[1]], rest, places)


def tank():
    """Two tanks in a row, no joints: the levels follow the inflow."""

    def rates(x, u, f, p):
        out = [p["c"] * np.sqrt(2 * G * x[0]), p["e"] * np.sqrt(2 * G * x[1])]
        return [(u[0] - out[0]) / p["A"], (out[0] - out[1]) / p["B"]]

    def rest(p, h=0.5):
        return np.array([h, h * (p["c"] / p["e"]) ** 2]), np.array([p["c"] * np.sqrt(2 * G * h)])

    values = {"A": (0.1, 0.05), "B": (0.2, 0.05), "c": (1e-3, 0.1), "e": (1.2e-3, 0.1)}
    return made("tank", values, "q", "h2", "h1 h2", rates, lambda x, u, p: [x[1]], rest)


def rotor():
    """A mass held by the square of a rotor's speed: its slope at rest is a square root of the parameters."""

    def rates(x, u, f, p):
        return [x[1], (4 * p["k"] * x[2] ** 2 - 0.1 * x[1] + f[0]) / p["m"] - G, (u[0] - x[2]) / p["T"]]

    def rest(p):
        speed = np.sqrt(p["m"] * G / (4 * p["k"]))
        return np.array([0.0, 0.0, speed]), np.array([speed])

    places = (PortPlace("v", "joint", "N", "z"),)
    values = {"m": (0.5, 0.2), "k": (3e-6, 0.2), "T": (0.05, 0.2)}
    return made("rotor", values, "u", "z", "z v s", rates, lambda x, u, p: [x[0]], rest, places)
