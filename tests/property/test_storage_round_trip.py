"""Whatever is saved comes back."""

import tempfile
from pathlib import Path

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

import robustlab as rl
from robustlab.files import link_name, signal_name
from robustlab.result import Result, Status
from robustlab.statespace import OperatingPoint
from robustlab.storage import read

SETTINGS = settings(max_examples=25)
NUMBERS = st.floats(allow_nan=False, allow_infinity=False, width=64)
TEXTS = st.text(st.characters(exclude_categories=["Cs"], exclude_characters="\x00"), max_size=12)
NAMES = TEXTS.filter(bool)
SIZES = st.integers(0, 4)


def there_and_back(obj):
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "x.h5"
        rl.save(path, obj)
        loaded = read(path, isolate=False)
        assert loaded.verified
        return loaded.object


@st.composite
def models(draw, n_inputs=SIZES, n_outputs=SIZES):
    n, m, p = draw(SIZES), draw(n_inputs), draw(n_outputs)
    matrices = [draw(arrays(float, shape, elements=NUMBERS)) for shape in ((n, n), (n, m), (p, n), (p, m))]
    signals = [
        draw(st.lists(st.tuples(NAMES, TEXTS), min_size=k, max_size=k, unique_by=lambda s: s[0])) for k in (m, p, n)
    ]
    point = OperatingPoint(np.ones(n), np.zeros(m), np.full(p, 0.1)) if draw(st.booleans()) else None
    dt = draw(st.sampled_from([0.0, 1e-3, 2.0]))
    return rl.StateSpaceModel(*matrices, dt, *signals, operating_point=point)


def assert_same_model(a, b):
    for name in "ABCD":
        first, second = getattr(a, name), getattr(b, name)
        assert first.shape == second.shape
        assert first.tobytes() == second.tobytes()  # bit for bit, signs of zeros included
    assert (a.dt, a.inputs, a.outputs, a.states) == (b.dt, b.inputs, b.outputs, b.states)
    assert (a.operating_point is None) == (b.operating_point is None)
    if a.operating_point is not None:
        for name in "xuy":
            np.testing.assert_array_equal(getattr(a.operating_point, name), getattr(b.operating_point, name))


@SETTINGS
@given(models())
def test_models(model):
    assert_same_model(there_and_back(model), model)


@st.composite
def uncertain_models(draw):
    blocks = []
    for name in draw(st.lists(NAMES, max_size=3, unique=True)):
        kind, rows = draw(st.sampled_from(["real", "range", "complex", "full"])), draw(st.integers(1, 3))
        if kind == "full":
            blocks.append(rl.FullBlock(name, rows, draw(st.integers(1, 3))))
        elif kind == "complex":
            blocks.append(rl.ComplexScalar(name, rows))
        else:
            span = rl.ParameterRange(draw(NUMBERS), draw(NUMBERS), draw(TEXTS)) if kind == "range" else None
            if span is not None and span.radius > 0 and draw(st.booleans()):
                below = span.radius * draw(st.floats(1e-3, 1e3))
                if 0 < below < np.inf:
                    span = rl.ParameterRange(span.nominal, span.radius, span.unit, below)
            blocks.append(rl.RealScalar(name, rows, span))
    q, p = sum(b.rows for b in blocks), sum(b.cols for b in blocks)
    m = draw(models(st.just(q + draw(SIZES)), st.just(p + draw(SIZES))))
    return rl.UncertainModel(
        m, blocks, OperatingPoint(np.ones(m.n_states), np.ones(m.n_inputs - q), np.ones(m.n_outputs - p))
    )


@SETTINGS
@given(uncertain_models())
def test_uncertain_models(uncertain):
    back = there_and_back(uncertain)
    assert back.blocks == uncertain.blocks
    assert_same_model(back.M, uncertain.M)
    np.testing.assert_array_equal(back.operating_point.u, uncertain.operating_point.u)


@SETTINGS
@given(st.data(), st.lists(st.floats(1e-6, 1e6), max_size=3))
def test_delayed_models(data, lengths):
    n = len(lengths)
    model = data.draw(models(st.integers(n, n + 2), st.integers(n, n + 2)))
    if model.is_discrete:
        return
    delayed = rl.DelayedModel(model, lengths)
    back = there_and_back(delayed)
    assert back.delays.tolist() == delayed.delays.tolist()
    assert_same_model(back.H, delayed.H)


@SETTINGS
@given(models(), st.none() | st.floats(0, 1e6) | st.just(np.inf), st.sampled_from(list(Status)), TEXTS)
def test_controllers(model, gamma, status, method):
    back = there_and_back(rl.Controller(model, gamma, status, method))
    assert (back.gamma, back.status, back.method) == (gamma, status, method)
    assert_same_model(back.K, model)


LEAVES = (
    st.none() | st.booleans() | st.integers(-(2**63), 2**63 - 1) | NUMBERS | TEXTS | st.complex_numbers(allow_nan=False)
)
VALUES = st.recursive(
    LEAVES, lambda inner: st.lists(inner, max_size=3) | st.dictionaries(TEXTS, inner, max_size=3), max_leaves=8
)


def plain(value):
    """Arrays as lists, to compare: lists of numbers come back as arrays."""
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, dict):
        return {key: plain(item) for key, item in value.items()}
    return [plain(item) for item in value] if isinstance(value, list) else value


@SETTINGS
@given(st.dictionaries(TEXTS.filter(lambda key: key not in ("type", "status")), VALUES, max_size=4))
def test_results(data):
    back = there_and_back(Result("Margin", Status.CONVERGED, data))
    assert (back.type, back.status) == ("Margin", Status.CONVERGED)
    assert plain(dict(back.data)) == data


@given(TEXTS)
def test_link_names(name):
    link = link_name(name)
    assert link
    assert "/" not in link
    assert not link.startswith(".")
    assert signal_name(link) == name
