"""Watching a machine: false alarms where nothing changes, the delay of an alarm against a change's size, its name.

The truth is simulated here, exactly between its switches (`Axis`, `Motor`), and not by robustlab: an axis driven by a
force of steps, its position measured; and a voltage-driven motor, its current and speed measured. Each has viscous and
dry friction, and parameters of its own within the tolerances of the model that is watched.

    python benchmarks/watch.py                 # all, about 40 minutes on one core
    python benchmarks/watch.py quiet 200 [Axis] # false alarms in 200 logs of each machine, or of one
    python benchmarks/watch.py changes 3       # 3 logs of each change
"""

from __future__ import annotations

import math
import sys
import time
from collections import Counter
from typing import ClassVar

import numpy as np
from scipy.stats import beta

import robustlab as rl

FALSE_ALARM = 0.01
PIECE, PIECES, BEGINS = 2.0, 10, 4  # s, number of pieces, the first piece with the change


class Axis:
    """J w' = u - b w - Fc sgn w + d, q' = w: solved between the switches of the sign."""

    dt = 5e-3
    noise: ClassVar = {"q": 5e-3}
    nominal: ClassVar = {"J": 2e-3, "b": 4e-3, "Fc": 0.02, "gain": 1.0, "load": 0.0}

    @staticmethod
    def model():
        """What is watched."""
        n = Axis.nominal
        bare = rl.StateSpaceModel(
            [[0, 1], [0, -n["b"] / n["J"]]], [[0], [1 / n["J"]]], [[1, 0]], [[0]], inputs=[("u", "N m")],
            outputs=[("q", "rad")], states=[("q", "rad"), ("w", "rad/s")],
        )  # fmt: skip
        return rl.with_effects(bare, {"coulomb-friction": {"Fc": n["Fc"]}})

    @staticmethod
    def inputs(t, rng):
        """Steps of 0.1 to 0.4 s."""
        return held_steps(t, rng, 0.1, (0.1, 0.4))

    @staticmethod
    def run(t, u, of, disturbance):
        """Position at the samples; ``of(t)``: the parameters then."""
        q, w, found, fine = 0.0, 0.0, np.empty(len(t)), 10 if disturbance else 1
        for k, at in enumerate(t):
            found[k], p = q, of(at)
            for part in range(fine):
                push = p["gain"] * u[k] - p["load"]
                if disturbance:
                    push += disturbance(at + (part + 0.5) * Axis.dt / fine)
                q, w = Axis.advance(q, w, push, p, Axis.dt / fine)
        return {"q": found}

    @staticmethod
    def advance(q, w, push, p, left):
        """State after ``left`` seconds under a constant push."""
        J, b, f = p["J"], p["b"], p["Fc"]
        while left > 0.0:
            if w == 0.0 and abs(push) <= f:
                return q, 0.0
            way = math.copysign(1.0, w or push)
            end, stops = (push - f * way) / b, math.inf
            if w != 0.0 and end * way < 0.0:
                stops = J / b * math.log(1.0 - w / end)
            span = min(left, stops)
            fade = math.exp(-b * span / J)
            q += end * span + (w - end) * J / b * (1.0 - fade)
            w = 0.0 if stops <= left else end + (w - end) * fade
            left -= span
        return q, w


class Motor:
    """L i' = u - R i - K w, J w' = K i - b w - Fc sgn w - load: eigenvectors between the switches of the sign."""

    dt = 1e-3
    noise: ClassVar = {"i": 0.02, "omega": 0.5}
    nominal: ClassVar = {
        "R": 2.07,
        "L": 6.2e-4,
        "K": 0.0525,
        "J": 1.4e-5,
        "b": 4.8e-6,
        "Fc": 0.004,
        "gain": 1.0,
        "load": 0.0,
    }

    @staticmethod
    def model():
        """What is watched."""
        n = Motor.nominal
        bare = rl.plant(
            "dc-motor", R=(n["R"], 0.05), L=(n["L"], 0.1), Km=(n["K"], 0.03), Kb=(n["K"], 0.03), Kf=(n["b"], 1.0),
            J=(n["J"], 0.1),
        )  # fmt: skip
        return rl.with_effects(bare, {"coulomb-friction": {"Fc": n["Fc"]}})

    @staticmethod
    def inputs(t, rng):
        """Steps of 0.05 to 0.2 s."""
        return held_steps(t, rng, 12.0, (0.05, 0.2))

    @staticmethod
    def run(t, u, of, disturbance):
        """Current and speed at the samples."""
        x, found, fine, kept = np.zeros(2), np.empty((len(t), 2)), 5 if disturbance else 1, (None, None)
        for k, at in enumerate(t):
            found[k], p = x, of(at)
            if kept[0] != (p["R"], p["L"], p["K"], p["J"], p["b"]):
                kept = (p["R"], p["L"], p["K"], p["J"], p["b"]), Motor.modes(p)
            for part in range(fine):
                load = p["load"] - (disturbance(at + (part + 0.5) * Motor.dt / fine) if disturbance else 0.0)
                x = Motor.advance(x, p["gain"] * u[k], load, p, kept[1], Motor.dt / fine)
        return {"i": found[:, 0], "omega": found[:, 1]}

    @staticmethod
    def modes(p):
        """A with its eigenvalues and eigenvectors."""
        A = np.array([[-p["R"] / p["L"], -p["K"] / p["L"]], [p["K"] / p["J"], -p["b"] / p["J"]]])
        rates, V = np.linalg.eig(A)
        return A, rates, V, np.linalg.inv(V)

    @staticmethod
    def advance(x, u, load, p, modes, left):
        """State after ``left`` seconds."""
        A, rates, V, inverse = modes
        while left > 1e-15:
            i, w = x
            torque = p["K"] * i - load
            if w == 0.0 and abs(torque) < p["Fc"]:
                end, rate = u / p["R"], p["R"] / p["L"]
                breaks = (load + math.copysign(p["Fc"], p["K"] * end - load)) / p["K"]  # the current that moves it
                leaves = abs(p["K"] * end - load) > p["Fc"]
                span = min(left, math.log((i - end) / (breaks - end)) / rate if leaves else math.inf)
                x, left = np.array([end + (i - end) * math.exp(-rate * span), 0.0]), left - span
                if left > 0.0:
                    x = np.array([breaks, math.copysign(1e-300, p["K"] * end - load)])  # it moves from here on
                continue
            way = math.copysign(1.0, w or torque)
            rest = np.linalg.solve(A, [-u / p["L"], (load + p["Fc"] * way) / p["J"]])
            parts = inverse @ (x - rest)

            def after(span, rest=rest, parts=parts):
                return rest + (V @ (np.exp(rates * span) * parts)).real

            if after(left)[1] * way > 0.0 or abs(w) < 1e-200:
                return after(left)
            low, high = 0.0, left
            while high - low > 1e-12:
                middle = 0.5 * (low + high)
                low, high = (middle, high) if after(middle)[1] * way > 0.0 else (low, middle)
            x, left = np.array([after(high)[0], 0.0]), left - high
        return x


def held_steps(t, rng, most, spans):
    """Random levels, held for random spans."""
    u, k = np.zeros(len(t)), 0
    while k < len(t):
        span = int(rng.uniform(*spans) / (t[1] - t[0]))
        u[k : k + span] = rng.uniform(-most, most)
        k += span
    return u


def log(machine, seed, changes=None, grows=False, disturbance=None):
    """A log of a machine with parameters of its own; ``changes``: parameter -> factor that it has at the end."""
    rng = np.random.default_rng(seed)
    t = machine.dt * np.arange(round(PIECES * PIECE / machine.dt))
    own = {name: value * rng.uniform(0.99, 1.01) for name, value in machine.nominal.items()}
    begins, whole = BEGINS * PIECE, (PIECES - BEGINS) * PIECE

    def of(at):
        part = min(max(at - begins, 0.0) / whole, 1.0) if grows else float(at >= begins)
        moved = {name: own[name] * (1.0 + part * (f - 1.0)) for name, f in (changes or {}).items() if name != "load"}
        return {**own, **moved, "load": own["load"] + part * (changes or {}).get("load", 0.0)}

    u = machine.inputs(t, rng)
    late = None if disturbance is None else lambda at: disturbance(at) if at >= begins else 0.0
    run = machine.run(t, u, of, late)
    y = {name: run[name] + std * rng.standard_normal(len(t)) for name, std in machine.noise.items()}
    return rl.Record(t, {"u": u}, y, name=f"log {seed}")


def at_most(k, n):
    """Upper 95 % bound of a probability (Clopper, Pearson)."""
    return 1.0 if k == n else float(beta.ppf(0.95, k + 1, n - k))


def quiet(machine, count):
    """A row: alarms in logs without a change."""
    largest, alarms = -math.inf, 0
    for seed in range(count):
        found = rl.watch(machine.model(), log(machine, seed), every=PIECE, noise=machine.noise, false_alarm=FALSE_ALARM)
        alarms += not found.met
        largest = max(largest, found.evidence)
    print(
        f"{machine.__name__:8} {alarms:4d} alarms in {count} logs, at most "
        f"{100 * at_most(alarms, count):.2f} % (95 %), asked {100 * FALSE_ALARM:g} %; largest log E {largest:.2f}",
        flush=True,
    )


def wobble(size):
    """A disturbance that no effect of the catalogue is: a wave whose frequency wanders."""
    return lambda at: size * math.sin(2 * math.pi * 2.3 * at + 3.0 * math.sin(5.0 * at))


CHANGES = [
    # machine, what, kind of the truth, parameter with factors, grows
    *(
        (m, f"dry friction +{p} %, growing", "dry-friction", {"Fc": 1 + p / 100}, True)
        for m in (Axis, Motor)
        for p in (3, 10, 30)
    ),
    *((m, "dry friction +30 %, at once", "dry-friction", {"Fc": 1.3}, False) for m in (Axis, Motor)),
    (Axis, "viscous friction +30 %, growing", "speed-friction", {"b": 1.3}, True),
    (Motor, "viscous friction x 10, growing", "speed-friction", {"b": 10.0}, True),
    (Motor, "resistance +10 %, growing", "factor", {"R": 1.1}, True),
    (Motor, "torque constant -5 %, at once", "factor", {"K": 0.95}, False),
    (Axis, "load of a tenth of Fc, at once", "load", {"load": 0.002}, False),
    (Axis, "load of a hundredth of Fc, at once", "load", {"load": 0.0002}, False),
    (Axis, "wandering wave, 4 mN m", "unknown", wobble(4e-3), False),
    (Motor, "wandering wave, 2 mN m", "unknown", wobble(2e-3), False),
]


def changed(machine, what, kind, change, grows, count):
    """A row: delay of the alarm, its name, and whether the interval of the size has the truth."""
    delays, told = [], Counter()
    for seed in range(count):
        given = {"disturbance": change} if callable(change) else {"changes": change, "grows": grows}
        record = log(machine, 1000 + seed, **given)
        found = rl.watch(machine.model(), record, every=PIECE, noise=machine.noise, false_alarm=FALSE_ALARM)
        told["none" if found.met else "+".join(found.found.names) if found.found else "unknown"] += 1
        if not found.met:
            delays.append(found.alarm - BEGINS * PIECE)
    delay = f"{np.median(delays):5.1f} s" if delays else "  none"
    names = ", ".join(f"{name} {n}" for name, n in told.most_common())
    print(f"{machine.__name__:8} {what:36} alarm after {delay}; truth {kind}: found {names}", flush=True)


def main(words: list[str]) -> None:
    """What is asked for."""
    began = time.process_time()
    print("# python benchmarks/watch.py " + " ".join(words))
    begins = f"a change begins at {BEGINS * PIECE:g} s"
    print(f"# {PIECES} pieces of {PIECE:g} s; {begins}; false alarms at most {FALSE_ALARM:g}")
    if not words or words[0] == "quiet":
        for machine in [m for m in (Axis, Motor) if m.__name__ in (words[2:] or ("Axis", "Motor"))]:
            quiet(machine, int(words[1]) if len(words) > 1 else 200)
    if not words or words[0] == "changes":
        for row in CHANGES:
            changed(*row, int(words[1]) if len(words) > 1 else 10)
    print(f"# {time.process_time() - began:.0f} s of CPU")


if __name__ == "__main__":
    main(sys.argv[1:])
