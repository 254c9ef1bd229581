"""A connected model against the linear equations of its signals, solved at each frequency."""

from __future__ import annotations

import numpy as np
from hypothesis import assume, given, settings
from hypothesis import strategies as st

import robustlab as rl
from robustlab.errors import NoTrustworthyNumber

OMEGA = np.array([0.0, 0.7, 20.0])
DELTA = {"a": 0.8, "b": -0.5}


def wiring(rng):
    """Parts with random inputs out of all signals, sums over some, and what comes from outside."""
    outside = ["r1", "r2", "r3"]
    counts = [(int(rng.integers(1, 3)), int(rng.integers(1, 4))) for _ in range(int(rng.integers(1, 5)))]
    made = [[f"y{k}.{j}" for j in range(n_y)] for k, (n_y, _) in enumerate(counts)]
    summed = [f"s{k}" for k in range(int(rng.integers(0, 4)))]
    known = [*outside, *(name for names in made for name in names), *summed]
    sums = []
    for name in summed:
        terms = rng.choice(known, int(rng.integers(1, 4)), replace=False)
        signs = rng.choice(["+", "-"], len(terms))
        sums.append((name, list(zip(signs, map(str, terms), strict=True))))
    parts = []
    for (_, n_u), outputs in zip(counts, made, strict=True):
        inputs = [str(name) for name in rng.choice(known, n_u, replace=False)]
        parts.append(random_part(rng, inputs, outputs))
    fed = {s.name for part in parts for s in part.inputs} | {t for _, terms in sums for _, t in terms}
    inputs = [name for name in outside if name in fed]
    outputs = [name for name in known if name in fed or name not in outside]
    rng.shuffle(outputs)
    return parts, sums, inputs, outputs


def random_part(rng, inputs, outputs):
    n, blocks = int(rng.integers(0, 3)), [[], [rl.RealScalar("a")], [rl.RealScalar("b"), rl.RealScalar("a")]]
    own = blocks[int(rng.integers(0, 3))]
    q = len(own)
    d = 0.4 * rng.standard_normal((q + len(outputs), q + len(inputs))) * (rng.random() < 0.7)
    names = ([f"w{k}" for k in range(q)] + inputs, [f"z{k}" for k in range(q)] + outputs)
    m = rl.StateSpaceModel(
        rng.standard_normal((n, n)) - 3 * np.eye(n), rng.standard_normal((n, q + len(inputs))),
        rng.standard_normal((q + len(outputs), n)), d, 0.0, *names,
    )  # fmt: skip
    return rl.UncertainModel(m, own) if q else m


def response_of(part):
    if isinstance(part, rl.UncertainModel):
        return part.response(OMEGA, {b.name: DELTA[b.name] for b in part.blocks})
    return rl.frequency_response(part, OMEGA)


@settings(max_examples=60)
@given(st.integers(0, 1_000_000))
def test_a_connected_model_solves_the_equations_of_its_signals(seed):
    parts, sums, inputs, outputs = wiring(np.random.default_rng(seed))
    texts = [f"{name} = " + " ".join(f"{sign} {term}" for sign, term in terms) for name, terms in sums]
    signals = sorted({*inputs, *outputs})
    place = {name: k for k, name in enumerate(signals)}
    # (I - T) signals = S inputs, at each frequency; no word of the implementation's wiring
    equations = np.tile(np.eye(len(signals), dtype=complex), (len(OMEGA), 1, 1))
    for part in parts:
        rows, columns = ([place[s.name] for s in side] for side in (part.outputs, part.inputs))
        equations[np.ix_(range(len(OMEGA)), rows, columns)] -= response_of(part)
    for name, terms in sums:
        for sign, term in terms:
            equations[:, place[name], place[term]] -= 1.0 if sign == "+" else -1.0
    assume(np.linalg.cond(equations).max() < 1e6)
    right = np.zeros((len(signals), len(inputs)))
    right[[place[name] for name in inputs], range(len(inputs))] = 1.0
    truth = np.linalg.solve(equations, right)[:, [place[name] for name in outputs]]
    try:
        found = rl.connect(*parts, inputs=inputs, outputs=outputs, sums=texts)
    except NoTrustworthyNumber:  # well posed at these members and frequencies, not at infinity or Delta = 0
        assume(False)
    if isinstance(found, rl.UncertainModel):
        got = found.response(OMEGA, {b.name: DELTA[b.name] for b in found.blocks})
    else:
        got = rl.frequency_response(found, OMEGA)
    assert np.abs(got - truth).max(initial=0.0) <= 1e-7 * (1 + np.abs(truth).max(initial=0.0))
