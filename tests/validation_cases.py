"""Records whose smallest gamma is known, for `rl.validate`."""

import numpy as np

import robustlab as rl

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


def _solve(h, y):
    """x with h * x = y."""
    from scipy.signal import lfilter

    return lfilter([1.0], h, y)


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


def record_of(inputs, outputs):
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
    return _additive(gs), record_of(inputs, {"y": y}), {"y": bound}, {"at_rest": True}


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


def plausible(seed, n=100):
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
