r"""How far apart two hypotheses are for given records.

.. math:: d^2 = \min_{z, \xi} V_B\bigl(z, \xi;\, \hat y_A\bigr) - \|z_A\|^2

with :math:`\hat y_A` what hypothesis A predicts for the records without noise: B is refitted to it under its priors.
d is in noise sigmas; below 3 no test on these records can tell B from A, beyond 10 the choice is safe.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from robustlab.identification.hypotheses.effect_fit import Fit, Problem, simulated_outputs

__all__ = ["predicted", "refit_distance"]


def predicted(problem: Problem, fit: Fit) -> Problem:
    """The same problem with the measured outputs replaced by what the fit predicts in the chosen windows."""
    records = []
    for record, chosen, outputs in zip(problem.records, problem.chosen, simulated_outputs(problem, fit), strict=True):
        y = record.y.copy()
        for start, window in zip(record.windows.starts[chosen], outputs, strict=True):
            y[start : start + record.windows.length] = np.where(
                np.isfinite(y[start : start + record.windows.length]), window, np.nan
            )
        records.append(replace(record, y=y))
    return problem.on(records, problem.chosen)


def refit_distance(problem: Problem, true: Fit, rival: Fit) -> float:
    """D of the rival's hypothesis, refitted from where it stands, to the prediction of the true one."""
    there = predicted(problem, true)
    prior = float(true.z @ true.z) + sum(float((x**2).sum()) for x in true.starts)
    fitted = there.fit(rival.hypothesis, true.noise, rival.z, rival.starts, iterations=10)
    return float(np.sqrt(max(0.0, fitted.cost - prior)))
