"""Streamed statistics against the responses themselves; one member's numbers do not depend on its company."""

from __future__ import annotations

import numpy as np
import pytest

from robustlab.errors import InputError, NoTrustworthyNumber
from robustlab.result import Status, plain
from robustlab.statespace import StateSpaceModel
from robustlab.uncertainty.blocks import ComplexScalar, ParameterRange, RealScalar
from robustlab.uncertainty.elementwise import elementwise
from robustlab.uncertainty.lft import UncertainModel
from robustlab.worst_case_analysis import sample
from robustlab.worst_case_analysis.draws import RealSet
from robustlab.worst_case_analysis.ensemble import excitation, in_lanes, responses, time_responses
from robustlab.worst_case_analysis.response_kernels import accumulate
from robustlab.worst_case_analysis.streaming import Bins, Sums

T = np.linspace(0.0, 4.0, 81)


def chain(n=6, change=0.2):
    """n / 2 masses in a row: n states, two inputs, three outputs, one with a direct term."""
    rng = np.random.default_rng(0)
    h = n // 2
    k = 2 * np.eye(h) - np.eye(h, k=1) - np.eye(h, k=-1)

    def model(stiff, direct):
        a = np.block([[np.zeros((h, h)), np.eye(h)], [-stiff * k, -0.2 * np.eye(h)]])
        b, c = rng.standard_normal((n, 2)), rng.standard_normal((3, n))
        return StateSpaceModel(a, b, c, [[0, 0], [direct, 0], [0, 0]])

    rng = np.random.default_rng(0)
    first = model(1.0, 0.5)
    rng = np.random.default_rng(0)
    return elementwise(first, model(1.0 + change, 0.6))


U = np.column_stack([np.sin(3 * T), np.where(T < 1, 1.0, 0.0)])


@pytest.mark.parametrize("hold", ["zoh", "foh"])
def test_statistics_are_those_of_the_responses(hold):
    samples = sample(chain(), 1100, seed=3, vertices=5)
    x0 = 0.1 * np.arange(6)
    found, kept = samples.stream(T, U, x0, hold), samples.respond(T, U, x0, hold)
    for name in ("nominal", "lower", "upper"):
        np.testing.assert_allclose(getattr(found, name), getattr(kept, name), rtol=1e-11, atol=1e-12)
    np.testing.assert_allclose(found.mean, kept.y.mean(axis=0), rtol=1e-11, atol=1e-12)
    np.testing.assert_allclose(found.deviation, kept.y.std(axis=0), rtol=1e-6, atol=1e-11)
    assert found.worst == kept.worst
    assert found.worst_deltas == tuple(samples.deltas[i] for i in kept.worst)
    np.testing.assert_allclose(found.peak_deviation, kept.peak_deviation, rtol=1e-11)
    for share, value in found.quantiles.items():
        exact = np.quantile(kept.y, share, axis=0, method="inverted_cdf")
        assert (np.abs(value - exact) <= 0.5001 * found.resolution + 1e-12).all()
    assert (found.n, found.vertices, found.unstable) == (1100, 5, len(kept.unstable))
    assert found.status is Status.CONVERGED
    assert "sampled" in plain(found)["label"]


@pytest.mark.parametrize("losses", [False, True])
def test_sums_are_taken_in_the_order_of_the_members(losses):
    """Lane by lane in groups of 32, group by group: the same bits however the kernel goes through times and outputs."""
    count, nominal = 75, np.zeros((200, 3))
    members = RealSet(chain(12)).members(sample(chain(12), count).deltas.numbers(slice(0, count)))
    drive = excitation(chain(12).inputs, 0.0, np.linspace(0, 4, 200), np.ones((200, 2)), "test")
    lanes = in_lanes(members, drive, np.arange(12.0), "zoh")
    y = responses(members, drive, np.arange(12.0), "zoh")
    nominal[100:] = np.inf if losses else 0.0  # from here on no deviation is finite
    sums, counts, peak = Sums.empty((200, 3)), np.zeros((200, 3, 9), dtype=np.int32), np.empty((count, 3))
    accumulate(lanes, Bins(nominal, np.full((200, 3), -2.0), np.ones((200, 3))), sums, counts, peak)
    with np.errstate(invalid="ignore"):
        gap = y - nominal
    lost = ~np.isfinite(gap)
    total, squares = np.zeros((200, 3)), np.zeros((200, 3))
    for first in range(0, count, 32):
        added, added_squares = np.zeros((200, 3)), np.zeros((200, 3))
        for one in np.where(lost, 0.0, gap)[first : first + 32]:
            added += one
            added_squares += one * one
        total += added
        squares += added_squares
    np.testing.assert_array_equal(sums.lost, lost.sum(axis=0))
    np.testing.assert_array_equal(sums.total, total)
    np.testing.assert_array_equal(sums.squares, squares)
    np.testing.assert_array_equal(sums.lower, np.where(lost, np.inf, y).min(axis=0))
    np.testing.assert_array_equal(sums.upper, np.where(lost, -np.inf, y).max(axis=0))
    np.testing.assert_array_equal(peak, np.where(lost, np.inf, np.abs(gap)).max(axis=1))
    places = np.clip(y + 2.0, 0.0, 8.0).astype(int)
    for k in range(9):
        np.testing.assert_array_equal(counts[:, :, k], ((places == k) & ~lost).sum(axis=0))


def test_workers_do_not_change_a_bit():
    one, two, seven = (sample(chain(), 1700, seed=1).stream(T, U, workers=w) for w in (1, 2, 7))
    for name, value in vars(one).items():
        for other in (two, seven):
            np.testing.assert_equal(vars(other)[name], value)


def test_a_response_does_not_depend_on_the_others():
    many, few = sample(chain(12), 600, seed=1).respond(T, U), sample(chain(12), 7, seed=1).respond(T, U)
    np.testing.assert_array_equal(many.y[:7], few.y)


@pytest.mark.parametrize("k", [1, 31, 32, 33])
@pytest.mark.parametrize("hold", ["zoh", "foh"])
def test_compiled_and_array_responses_agree(k, hold):
    members = RealSet(chain(12)).members(sample(chain(12), k).deltas.numbers(slice(0, k)))
    drive = excitation(chain(12).inputs, 0.0, np.linspace(0, 4, 200), np.ones((200, 2)), "test")
    x0 = np.arange(12.0)
    compiled = responses(members, drive, x0, hold)
    np.testing.assert_allclose(compiled, time_responses(members, drive.h, drive.u, x0, hold), rtol=1e-9, atol=1e-9)
    assert in_lanes(members, drive, x0, hold).phi.shape[0] == -(-k // 32)


def test_discrete_and_static_members():
    def pair(*matrices, dt=0.0):
        return elementwise(*(StateSpaceModel(*m, dt) for m in matrices))

    lags = pair(([[0.5]], [[1.0]], [[1.0]], [[0.0]]), ([[0.9]], [[1.0]], [[1.0]], [[0.0]]), dt=0.1)
    found = sample(lags, 100).stream(0.1 * np.arange(50))
    kept = sample(lags, 100).respond(0.1 * np.arange(50))
    np.testing.assert_allclose(found.upper, kept.upper)
    none = (np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)))
    still = sample(pair((*none, [[1.0]]), (*none, [[2.0]])), 50).stream([0.0, 1.0])
    assert 0 <= still.lower[0, 0] < still.upper[0, 0] <= 2


def test_no_spread_and_no_uncertainty():
    lag = StateSpaceModel([[-1.0]], [[1.0]], [[1.0]], [[0.0]])
    found = sample(elementwise(lag, lag), 10).stream(T)
    np.testing.assert_allclose(found.lower, found.upper, rtol=1e-14)
    np.testing.assert_allclose(found.quantiles[0.5], found.nominal, rtol=1e-9, atol=1e-12)


def test_what_outgrows_double_precision_is_not_hidden():
    lag = elementwise(*(StateSpaceModel([[p]], [[1.0]], [[1.0]], [[0.0]]) for p in (-1.0, 1.0)))
    found = sample(lag, 0, vertices="all").stream(np.linspace(0, 2000, 101))
    assert found.status is Status.INACCURATE
    assert found.upper[-1, 0] == np.inf
    assert found.unstable == 1
    assert np.isnan(found.mean[-1, 0])


def test_asymmetric_numbers_do_not_need_a_symmetric_scale():
    """The number in Delta that belongs to -1 decides for the negative half; for plain ranges it is -1."""
    m = StateSpaceModel([[-1.0]], [[1.0, 1.0]], [[1.0], [1.0]], np.zeros((2, 2)))
    members = RealSet(UncertainModel(m, [RealScalar("k")]))
    assert members.channels(np.array([[-0.5], [0.25]])).tolist() == [[-0.5], [0.25]]
    members = RealSet(UncertainModel(m, [RealScalar("k", parameter=ParameterRange(1.0, 0.5, below=0.25))]))
    assert members.channels(np.array([[-0.5], [0.25]])).tolist() == [[-0.25], [0.25]]


def test_refusals():
    samples = sample(chain(), 4)
    for options, text in (
        ({"quantiles": (0.0,)}, "quantile"),
        ({"workers": 0}, "workers"),
        ({"workers": 1.5}, "workers"),
        ({"hold": "linear"}, "hold"),
    ):
        with pytest.raises(InputError, match=text):
            samples.stream(T, U, **options)
    m = StateSpaceModel([[-1.0]], [[0.5, 1.0]], [[1.0], [1.0]], np.zeros((2, 2)))
    with pytest.raises(InputError, match="complex"):
        sample(UncertainModel(m, [ComplexScalar("d")]), 3).stream(T)
    ill = StateSpaceModel(np.zeros((0, 0)), np.zeros((0, 2)), np.zeros((2, 0)), [[1.0, 1.0], [1.0, 0.0]])
    with pytest.raises(NoTrustworthyNumber, match="sample 1 makes"):
        sample(UncertainModel(ill, [RealScalar("k")]), 0, vertices="all").stream([0.0, 1.0])
    with pytest.raises(InputError, match="fewer times"):
        samples.stream(np.linspace(0, 1, 100_000), np.ones((100_000, 2)))
    with pytest.raises(IndexError, match="sample 9 of 4"):
        samples.deltas[9]
    assert samples.deltas[-1] == samples.deltas[3]
