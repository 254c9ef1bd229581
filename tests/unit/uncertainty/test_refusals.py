"""Refusals of blocks, sets, weights and distances of models."""

import numpy as np
import pytest

import robustlab as rl
from robustlab import ComplexScalar, FullBlock, ParameterRange, RealScalar, coprime_margin, nu_gap, unstructured
from robustlab.uncertainty import as_blocks, delta_matrix, realise_delta

LAG = rl.StateSpaceModel([[-1.0]], [[1.0]], [[1.0]], [[0.0]])
TWO = rl.StateSpaceModel(-np.eye(2), [[1.0], [2.0]], np.eye(2), np.zeros((2, 1)))
UNSTABLE = rl.StateSpaceModel([[1.2]], [[1.0]], [[1.0]], [[0.0]])
SAMPLED = rl.StateSpaceModel([[0.5]], [[1.0]], [[1.0]], [[0.0]], 0.1)
LAST = rl.StateSpaceModel([[-1.0]], [[1.0]], [[1.0]], [[0.0]], 0.1)
HIDDEN = rl.StateSpaceModel(np.diag([-1.0, 2.0]), [[1.0], [0.0]], [[1.0, 1.0]], [[0.0]])
SILENT = rl.StateSpaceModel(np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((0, 0)), np.zeros((0, 1)))


def delta_of(**values):
    return delta_matrix([RealScalar("r", 2), FullBlock("f", 1, 2)], values)


def bound(omega=(1.0, 2.0), above=(1.0, 1.0), **options):
    return rl.overbound(list(omega), list(above), **options)


def realised(delta, omega=1.0, dt=0.0):
    return realise_delta([ComplexScalar("d"), RealScalar("r"), FullBlock("f", 1, 2)], delta, omega, dt)


ROWS = ([[0, 0]], [[-2, 3]], [[1.5, 0]], [["a", 0]], [[1, 2, 3]], [3], "text", 7, [[-2, -2]])
WIDTHS = ((0.5, 0.0), (0.5, -0.1), (0.0, 0.5), (np.inf, 0.5), (0.5, np.nan), (0.5, True))
ENDS = ((1.0, 2.0, 1.0), (1.0, 2.0, 3.0), (2.0, 1.0, None), (np.nan, 1.0, 0.5), (0, np.inf, 1))
REQUESTS = [
    # blocks
    *((lambda rows=rows: as_blocks(rows), "blocks") for rows in ROWS),
    *((lambda name=name: ComplexScalar(name), "1 to 200") for name in ("", "x" * 201, 3)),
    *((lambda w=w: ParameterRange(1.0, w[0], below=w[1]), "width") for w in WIDTHS),
    *((lambda ends=ends: ParameterRange.between(*ends), "low < nominal < high") for ends in ENDS),
    (lambda: delta_of(q=1.0), "no such block"),
    (lambda: delta_of(r=1j), "real number"),
    (lambda: delta_of(r=[1.0, 2.0]), "one number"),
    (lambda: delta_of(r=np.nan), "NaN"),
    (lambda: delta_of(f=1.0), r"\(1, 2\)"),
    (lambda: delta_of(f=[[1.0], [2.0]]), r"\(1, 2\)"),
    # a Delta as a system
    (lambda: realised({"d": 0.4j}, -1.0), "omega = -1"),
    (lambda: realised({"d": 0.4j}, np.nan), "omega = nan"),
    (lambda: realised({"d": 0.4j}, 40.0, 0.1), "between 0 and 31.4"),
    (lambda: realised({"d": 0.4j}, dt=-0.1), "dt: -0.1"),
    (lambda: realised({"d": np.nan}), "NaN"),
    (lambda: realised({"e": 0.4j}), "no such block"),
    (lambda: realised({"r": 0.4j}), "a real number"),
    (lambda: realised({"f": np.ones((2, 2))}), r"shape \(2, 2\)"),
    # unstructured sets
    (lambda: unstructured(LAG, 1.0, "multiplicative"), "did you mean|input-multiplicative"),
    (lambda: unstructured(LAG, UNSTABLE), r"unstable weight \(pole 1.2"),
    (lambda: unstructured(LAG, SAMPLED), "sample times"),
    (lambda: unstructured(LAG, np.ones((2, 2))), "1 inputs"),
    (lambda: unstructured(LAG, 1.0, W1=np.ones((2, 2))), "1 outputs"),
    (lambda: unstructured(LAG, [1.0, 2.0]), "2 channels"),
    (lambda: unstructured(LAG, [np.ones((2, 2))]), "one input and one output"),
    (lambda: unstructured(LAG, np.nan), "NaN"),
    (lambda: unstructured("lag", 1.0), "unstructured: G"),
    (lambda: unstructured(LAG.renamed(["d.w1"]), name="d"), "another name"),
    # weights
    (lambda: bound([1.0]), "two vectors"),
    (lambda: bound([2.0, 1.0]), "do not increase"),
    (lambda: bound([0.0, 1.0]), "positive, increasing"),
    (lambda: bound(above=[1.0, 0.0]), "finite positive"),
    (lambda: bound(above=[1.0, np.nan]), "finite positive"),
    (lambda: bound(order=-1), "0 to 12"),
    (lambda: bound(order=2.5), "0 to 12"),
    (lambda: bound(tolerance=0.0), "positive"),
    (lambda: bound(dt=4.0), "Nyquist"),
    (lambda: bound(exact=lambda w: -w), "positive bound"),
    # distances
    (lambda: nu_gap(LAG, TWO), "equal sizes"),
    (lambda: nu_gap(LAG, SAMPLED), "common sample time"),
    (lambda: rl.gap(LAG, SAMPLED), "sample time"),
    (lambda: nu_gap(SILENT, SILENT), "inputs and outputs"),
    (lambda: coprime_margin(TWO, LAG), "K is 1 x 1"),
    (lambda: coprime_margin(LAG, LAG, sign=0), "sign"),
]
NO_ANSWER = [
    (lambda: nu_gap(LAG, HIDDEN), "unstable mode 2 rad/s in x2: no input moves it"),
    (lambda: nu_gap(LAST, SAMPLED), "z = -1"),
]


@pytest.mark.parametrize(
    ("call", "error", "text"),
    [*((c, rl.InputError, t) for c, t in REQUESTS), *((c, rl.NoTrustworthyNumber, t) for c, t in NO_ANSWER)],
)
def test_what_is_refused(call, error, text):
    with pytest.raises(error, match=text):
        call()
