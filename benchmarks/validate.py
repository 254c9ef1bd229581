"""`rl.validate` against cases whose smallest gamma is known, true models, and wrong ones.

    python benchmarks/validate.py [known | true | wrong | speed]...

Known gamma, by construction of an optimal pair:

- time-varying: with multipliers lambda the inputs are chosen so that w = gamma z up to signs is parallel to what lambda
  weighs, and the noise is the bound times sign(lambda): weak duality allows no smaller gamma.
- constants: an output moves monotonically with delta, and at one sample the noise is at the bound that hides least.
- feedback (inverse forms): the noise bound is 1e-7, so that w and z follow from the record alone.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

import numpy as np

import robustlab as rl

RESULTS = Path(__file__).parent / "results" / "validate.txt"
DT = 0.01


def _first_order(rng, proper=True):
    """A random stable, minimum-phase gain with direct term, as (a, b, c, d)."""
    a, zero = rng.uniform(0.2, 0.9), rng.uniform(-0.5, 0.5)
    gain = rng.uniform(0.5, 2.0) * rng.choice([-1, 1])
    return a, 1.0, gain * (a - zero), gain


def _pulse(g, n):
    a, b, c, d = g
    return np.concatenate([[d], c * b * a ** np.arange(n - 1)])


def _conv(h, x):
    return np.convolve(h, x)[: len(x)]


def _additive(gs):
    """y = sum_i G_i w_i with z_i = u_i: channels first."""
    k = len(gs)
    A = np.diag([g[0] for g in gs])
    B = np.hstack([np.diag([g[1] for g in gs]), np.zeros((k, k))])
    C = np.vstack([np.zeros((k, k)), [[g[2] for g in gs]]])
    D = np.block([[np.zeros((k, k)), np.eye(k)], [np.array([[g[3] for g in gs]]), np.zeros((1, k))]])
    M = rl.StateSpaceModel(A, B, C, D, DT, [f"w{i}" for i in range(k)] + [f"u{i}" for i in range(k)],
                           [f"z{i}" for i in range(k)] + ["y"])  # fmt: skip
    return rl.UncertainModel(M, [rl.FullBlock(f"d{i}", 1, 1) for i in range(k)])


def _record(inputs, outputs):
    n = len(next(iter(outputs.values())))
    return rl.Record(np.arange(n) * DT, inputs, outputs)


def varying_case(seed, n, k, gamma):
    rng = np.random.default_rng(seed)
    gs = [_first_order(rng) for _ in range(k)]
    multiplier = rng.standard_normal(n)
    bound = rng.uniform(0.05, 0.3)
    inputs, y = {}, bound * np.sign(multiplier)
    for i, g in enumerate(gs):
        h = _pulse(g, n)
        weight = np.convolve(multiplier[::-1], h)[:n][::-1]  # G' lambda
        w = weight * rng.uniform(0.5, 2.0)
        inputs[f"u{i}"] = w / gamma * rng.choice([-1, 1], n)
        y = y + _conv(h, w)
    return _additive(gs), _record(inputs, {"y": y}), {"y": bound}, {"at_rest": True}


def constant_case(seed, n, k, gamma):
    """k lags with uncertain poles, each with its own output; only the largest delta is at its limit."""
    rng = np.random.default_rng(seed)
    sizes = gamma * np.concatenate([[1.0], rng.uniform(0.2, 0.9, k - 1)])
    A, reach = np.diag(-rng.uniform(1, 4, k)), np.diag(rng.uniform(0.2, 0.6, k))
    eye = np.eye(k)
    M = rl.StateSpaceModel(A, np.hstack([reach, -A]), np.vstack([eye, eye]), np.zeros((2 * k, 2 * k)), 0.0,
                           [f"w{i}" for i in range(k)] + [f"u{i}" for i in range(k)],
                           [f"z{i}" for i in range(k)] + [f"y{i}" for i in range(k)])  # fmt: skip
    model = rl.UncertainModel(M, [rl.RealScalar(f"d{i}") for i in range(k)])
    t = np.arange(n) * DT
    # Positive inputs: every sample grows with delta.
    u = {f"u{i}": 1.0 + np.repeat(rng.uniform(0, 1, -(-n // 20)), 20)[:n] for i in range(k)}
    truth = rl.simulate(model.evaluate({f"d{i}": s for i, s in enumerate(sizes)}), t, u)
    nominal = rl.simulate(model.nominal, t, u)
    outputs, noise = {}, {}
    for i in range(k):
        shift = np.abs(truth[f"y{i}"] - nominal[f"y{i}"])
        bound = 0.15 * float(shift.max())
        noise[f"y{i}"] = bound
        added = bound * rng.uniform(-0.9, 0.9, n)
        if i == 0:
            added[int(shift.argmax())] = bound
        outputs[f"y{i}"] = truth[f"y{i}"] + added
    return model, rl.Record(t, u, outputs), noise, {"at_rest": True}


def feedback_case(seed, n, gamma):
    """Inverse output form with a time-varying gain of size gamma at each sample, or at one only."""
    rng = np.random.default_rng(seed)
    a, b, c, d = _first_order(rng)
    G = rl.StateSpaceModel([[a]], [[b]], [[c]], [[d]], DT, ["u"], ["y"])
    model = rl.unstructured(G, rng.uniform(0.2, 0.6), "inverse-output-multiplicative")
    u = rng.standard_normal(n)
    gain = gamma * rng.uniform(-1, 1, n)
    gain[0] = gamma  # at the first sample alone the ratio is this
    q, p = 1, 1
    weight = model.M.D[0, q] / d
    through = _conv(_pulse((a, b, c, d), n), u)
    y = through / (1 + weight * gain)
    record = rl.Record(np.arange(n) * DT, {"u": u}, {"y": y})
    assert p == 1
    return model, record, {"y": 1e-7 * float(np.abs(y).max())}, {"at_rest": True}


def known_cases():
    rng = np.random.default_rng(7)
    for i in range(14):
        gamma = float(np.exp(rng.uniform(-2, 1.5)))
        yield (
            f"time-varying {1 + i % 3} blocks",
            gamma,
            varying_case(100 + i, [120, 250, 500][i // 3 % 3], 1 + i % 3, gamma),
        )
    for i in range(8):
        gamma = float(rng.uniform(0.2, 1.2))
        yield f"constant {1 + i % 2}", gamma, constant_case(300 + i, 200, 1 + i % 2, gamma)
    for i in range(6):
        gamma = float(rng.uniform(0.2, 0.9))
        yield "feedback, time-varying", gamma, feedback_case(400 + i, 200, gamma)


def known(say):
    worst, count, late, wide = 0.0, 0, 0, 0
    for name, gamma, (model, record, noise, options) in known_cases():
        begun = time.process_time()
        found = rl.validate(model, record, noise, precision=0.005, **options)
        seconds = time.process_time() - begun
        error = abs(found.upper / gamma - 1)
        worst, count, late = max(worst, error), count + 1, late + (seconds > 10)
        wide += not found.lower <= gamma * (1 + 1e-6)
        wide += not name.startswith("constant") and not found.lower >= 0.99 * gamma
        say(f"  {name:28s} n {record.n:4d}  known {gamma:.5f}  found {found.lower:.5f} .. {found.upper:.5f}"
            f"  error {100 * error:.3f} %  {found.status}  {seconds:.2f} s")  # fmt: skip
    say(f"known gamma: {count} cases, worst error of the upper bound {100 * worst:.3f} %, lower bound above the truth"
        f" or more than 1 % below it: {wide}, above 10 s: {late}")  # fmt: skip


def _contraction(rng, n):
    """Pulse response of a random stable system of norm at most 1: a gain, a delay, an all-pass or a lag."""
    size = rng.uniform(0.3, 1.0) * rng.choice([-1, 1])
    kind = rng.integers(4)
    h = np.zeros(n)
    if kind == 0:
        h[0] = 1.0
    elif kind == 1:
        h[rng.integers(1, 15)] = 1.0
    elif kind == 2:
        pole = rng.uniform(-0.8, 0.8)
        h = np.concatenate([[-pole], (1 - pole**2) * pole ** np.arange(n - 1)])
    else:
        pole = rng.uniform(0, 0.9)
        h = (1 - pole) * pole ** np.arange(n)
    return size * h


def _plausible(seed, n=100):
    """A random additive set of 1-2 blocks around a lag, a record of a member, and the noise bound."""
    rng = np.random.default_rng(seed)
    k = int(rng.integers(1, 3))
    gs = [_first_order(rng) for _ in range(k)]
    model = _additive(gs)
    inputs = {f"u{i}": rng.standard_normal(n) for i in range(k)}
    y = sum(_conv(_pulse(g, n), _conv(_contraction(rng, n), inputs[f"u{i}"])) for i, g in enumerate(gs))
    bound = 0.05 * float(np.abs(y).max())
    noise = bound * (rng.uniform(-1, 1, n) if rng.random() < 0.5 else rng.choice([-1.0, 1.0], n))
    return model, inputs, y, noise, bound


def true_models(say):
    invalidated, undecided, runs = 0, 0, 0
    for seed in range(200):
        if seed % 4 == 3:
            model, record, bound, options = _parametric(seed)
        else:
            model, inputs, y, noise, size = _plausible(seed)
            record, bound, options = _record(inputs, {"y": y + noise}), {"y": size}, {"at_rest": True}
        found = rl.validate(model, record, bound, precision=0.02, **options)
        runs += 1
        invalidated += found.invalidated
        undecided += not found.invalidated and found.upper > 1
    say(f"true models: invalidated {invalidated} of {runs}, undecided {undecided}")
    judged = [rl.validate(*case[:3], **case[3]) for case in (_steady(seed, False) for seed in range(100))]
    say(f"true models, frequency domain: invalidated {sum(f.invalidated for f in judged)} of 100,"
        f" undecided {sum(not f.invalidated and f.upper > 1 for f in judged)}")  # fmt: skip


def _parametric(seed, effect="", n=200):
    """A mass-spring-damper or a servo axis with constants within 25 %; a hidden effect that peaks at 3 x the noise."""
    rng = np.random.default_rng(seed)
    t = np.arange(n) * 0.05
    force = np.repeat(rng.choice([-1.0, 1.0], -(-n // 16)) * rng.uniform(0.5, 1.5, -(-n // 16)), 16)[:n]
    if "axis" in effect:
        plant, drive, output = rl.plant("servo-axis", M=(95.0, 0.25), Fv=(200.0, 0.25)), "u", "v"
    else:
        plant, drive, output = rl.plant("mass-spring-damper", m=2.0, c=(1.5, 0.25), k=(8.0, 0.25)), "f", "q"
    model = plant.uncertain(outputs=[output])
    member = model.evaluate({b.name: rng.uniform(-1, 1) for b in model.blocks})

    def response(x):
        return rl.simulate(member, t, {drive: x})[output]

    y = response(force)
    bound = 0.02 * float(np.abs(y).max())
    if effect:  # one sweep: what the effect does along the undisturbed motion
        v = y if "axis" in effect else np.gradient(y, t)
        shape = {
            "coulomb": lambda: response(-np.sign(v)),
            "dead zone": lambda: response(-np.clip(force, -0.4, 0.4)),
            "quadratic": lambda: response(-v * np.abs(v)),
            "hardening": lambda: response(-(y**3)),
            "offset": lambda: response(np.ones(n)),
        }[effect.split(",")[0]]()
        y = y + 3 * bound * shape / np.abs(shape).max()
    noisy = y + bound * rng.uniform(-1, 1, n)
    return model, rl.Record(t, {drive: force}, {output: noisy}), {output: bound}, {"at_rest": True}


WRONG_CONSTANTS = (
    "coulomb",
    "coulomb, axis",
    "dead zone",
    "dead zone, axis",
    "quadratic, axis",
    "hardening",
    "offset, axis",
)


def _wrong_system(seed, kind):
    """An additive set of small weight and a record whose hidden part no member has; peaks at 3 x the noise."""
    model, inputs, y, noise, size = _plausible(seed)
    small = rl.UncertainModel(_scaled(model.M, 0.05), model.blocks)
    u = inputs["u0"]
    effect = {"rectifier": np.abs(u), "square": u**2, "product": u * np.roll(u, 1), "saturation": np.tanh(3 * u)}[kind]
    record = _record(inputs, {"y": 0.05 * y + 3 * size * effect / effect.max() + noise})
    return small, record, {"y": size}, {"at_rest": True}


def _steady(seed, hidden, n=64, periods=4):
    """Whole periods of a lag with one block of 20 %; hidden: a cube of the output of 3 x the noise (rms)."""
    rng = np.random.default_rng(seed)
    form = ["additive", "output-multiplicative", "inverse-output-multiplicative", "inverse-additive"][seed % 4]
    G = rl.StateSpaceModel([[-1.0]], [[1.0]], [[1.0]], [[0.0]], 0.0, ["u"], ["y"])
    model = rl.unstructured(G, 0.2, form)
    lines = np.arange(1, 6)
    phases = rng.uniform(0, 2 * np.pi, len(lines))
    u = np.cos(2 * np.pi * np.outer(np.arange(n), lines) / n + phases).sum(axis=1)
    many = np.tile(u, periods + 8)
    y = rl.simulate(model.evaluate({"unmodelled": rng.uniform(-1, 1)}), np.arange(len(many)) * 0.2, {"u": many})["y"]
    y, bound = y[-n * periods :], 0.02 * float(np.abs(y).max())
    noise = rng.uniform(-1, 1, len(y))
    noise *= bound * (1 - 1e-9) / np.sqrt(np.mean(noise**2))
    wrong = 3 * bound * y**3 / np.sqrt(np.mean(y**6)) if hidden else 0.0
    record = rl.Record(np.arange(len(y)) * 0.2, {"u": np.tile(u, periods)}, {"y": y + wrong + noise})
    return model, record, {"y": bound}, {"domain": "frequency"}


def wrong_models(say):
    """Hidden effects whose share of the output peaks at 3 x the noise bound."""
    cases = [("cube | systems, frequency domain", _steady(3000 + i, True)) for i in range(12)]
    cases += [
        (f"{kind} | systems", _wrong_system(2000 + i, kind))
        for kind in ("rectifier", "square", "product", "saturation")
        for i in range(6)
    ]
    cases += [(f"{effect} | constants", _parametric(1000 + i, effect)) for effect in WRONG_CONSTANTS for i in range(5)]
    counts = {}
    for kind, (model, record, bound, options) in cases:
        found = rl.validate(model, record, bound, precision=0.02, time_limit=40, **options)
        done, hits = counts.get(kind, (0, 0))
        counts[kind] = done + 1, hits + found.invalidated
        if not found.invalidated:
            say(f"  not invalidated: {kind}, gamma {found.lower:.3g} .. {found.upper:.3g}, {found.status}")
        print(kind, counts[kind], file=sys.stderr, flush=True)
    for kind, (done, hits) in counts.items():
        say(f"  wrong model, {kind}: invalidated {hits} of {done}")
    done, hits = np.sum(list(counts.values()), axis=0)
    say(f"wrong models (hidden effect of 3 x the noise bound): invalidated {hits} of {done}")


def _scaled(M, share):
    """The same model with a smaller weight at z."""
    k = M.n_outputs - 1
    C, D = M.C.copy(), M.D.copy()
    C[:k] *= share
    D[:k] *= share
    return rl.StateSpaceModel(M.A, M.B, C, D, M.dt, M.inputs, M.outputs)


def speed(say):
    model, record, noise, options = varying_case(1, 500, 3, 0.7)
    begun = time.process_time()
    found = rl.validate(model, record, noise, **options)
    say(f"500 samples x 3 blocks: {found.lower:.5f} .. {found.upper:.5f} (known 0.7),"
        f" {time.process_time() - begun:.1f} s CPU")  # fmt: skip


def _machine():
    """Date, processor and versions of a run."""
    import datetime
    import os
    import platform
    from importlib.metadata import version

    versions = ", ".join(f"{name} {version(name)}" for name in ("numpy", "scipy", "clarabel"))
    load = ", ".join(f"{x:.1f}" for x in os.getloadavg())
    today = datetime.datetime.now(datetime.UTC).date()
    machine = f"{platform.machine()}, {os.cpu_count()} cores, load {load}"
    return f"{today}  {machine}; Python {platform.python_version()}, {versions}"


def main(wanted):
    jobs = {"known": known, "true": true_models, "wrong": wrong_models, "speed": speed}
    lines = []

    def say(text):
        print(text, flush=True)
        lines.append(text)

    for name, job in jobs.items():
        if not wanted or name in wanted:
            begun = time.process_time()
            job(say)
            say(f"({name}: {time.process_time() - begun:.0f} s CPU)")
    if not wanted:
        RESULTS.write_text("\n".join([f"benchmarks/validate.py  {_machine()}", *lines]) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main(sys.argv[1:])
