r"""What matters in a metric of random members: first-order (Sobol') shares of its variance from given data.

Plischke, Borgonovo, Smith, Eur. J. Oper. Res. 226 (2013); directions by rank regression: Saltelli, Marivoet (1990).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robustlab.arrays import Array
from robustlab.shown import Facts, Shown, listed, number
from robustlab.tables import Table, Tabular
from robustlab.worst_case_analysis.metrics import MetricBatch

MOST_BINS = 32  # along each parameter, for the share of the variance that it explains


@dataclass(frozen=True)
class Influence(Tabular, Shown):
    """Influence of each real parameter on a metric, from samples.

    Attributes
    ----------
    names
        The parameters (blocks).
    first_order
        Share of the variance that each explains by itself, (d,); not negative, rounded up to 0 from noise.
    noise
        What ``first_order`` may show by chance for a parameter without any influence (95 % of the time it is less).
    rank_coefficients
        Standardised rank regression coefficients, (d,): positive where a larger delta means a larger value. NaN for
        fewer samples than parameters.
    rank_fit
        R^2 of that regression: how much of the ranks it explains. Coefficients of a poor fit say little.
    of_ranks
        True where members without a bounded value made ranks stand for values.
    worst_value
        The metric at the worst sample.
    restored
        The metric with that sample's delta k put back to nominal and all others kept, (d,): what a perfectly known
        parameter k would save.
    alone
        The metric with delta k of that sample and all others nominal, (d,).
    nominal_value
        The metric at Delta = 0.
    unit
        Unit of the values.
    n
        Number of samples.
    """

    names: tuple[str, ...]
    first_order: Array
    noise: float
    rank_coefficients: Array
    rank_fit: float
    of_ranks: bool
    worst_value: float
    restored: Array
    alone: Array
    nominal_value: float
    unit: str
    n: int

    @property
    def savings(self) -> Array:
        """How far the worst value moves where one parameter alone is put back to nominal, (d,); 0 where unbounded."""
        with np.errstate(invalid="ignore"):
            return np.nan_to_num(np.abs(self.worst_value - self.restored), nan=0.0, posinf=0.0)

    @property
    def order(self) -> tuple[int, ...]:
        """From the most to the least influential: by ``first_order`` where it is no chance, then by ``savings``."""
        shares = np.where(self.first_order > self.noise, self.first_order, 0.0)
        return tuple(int(k) for k in np.lexsort((-self.savings, -shares)))

    @property
    def matters(self) -> NDArray[np.bool_]:
        """Which parameters show in either way, (d,)."""
        return (self.first_order > self.noise) | (self.savings > 1e-3 * self.savings.max(initial=0.0))

    @property
    def directions(self) -> NDArray[np.int_]:
        """1 where the metric grows with a parameter, -1 where it falls, 0 where neither can be told from chance."""
        clear = np.abs(self.rank_coefficients) > 3.0 / np.sqrt(self.n)
        return np.where(clear, np.sign(self.rank_coefficients), 0).astype(int)

    def rows(self, most: int = 12) -> list[tuple[str, ...]]:
        """The parameters that matter: name, share of the spread, direction, the worst sample with it nominal."""
        ways = {1: "grows with it", -1: "falls with it", 0: "-"}
        return [
            (
                self.names[k],
                f"{100 * self.first_order[k]:.1f} %" if self.first_order[k] > self.noise else "-",
                ways[int(self.directions[k])],
                f"{self.restored[k]:.6g}",
            )
            for k in self.order[:most]
            if self.matters[k]
        ]

    def facts(self) -> Facts:
        """What a person wants to read, as (label, text)."""
        shares = [f"{self.names[k]} {100 * self.first_order[k]:.0f} %" for k in self.order]
        return [
            ("share of the spread", listed(shares)),
            ("may be chance up to", f"{100 * self.noise:.2g} %"),
            ("worst sample", number(self.worst_value, self.unit)),
            ("nominal", number(self.nominal_value, self.unit)),
            ("samples", str(self.n)),
        ]

    def table(self) -> Table:
        """A row for each parameter: its share of the spread, the metric without its change, and with it alone."""
        columns = {"first_order": self.first_order, "restored": self.restored, "alone": self.alone}
        return Table(("parameter", self.names), columns, {"restored": self.unit, "alone": self.unit})

    def to_json(self) -> dict[str, object]:
        """All fields, and the order."""
        return {**vars(self), "order": [self.names[k] for k in self.order]}


def influence_of(batch: MetricBatch, values: Array, worst: int) -> Influence:
    """Influence of the parameters of a set of real scalars on a metric at its first samples.

    ``values``: what ``batch`` gave for its first n samples, (n,).
    ``worst``: index of the worst of them.
    """
    theta = batch.theta(len(values))
    finite = bool(np.isfinite(values).all())
    numbers = values if finite else _ranks(values)
    coefficients, fit = _rank_regression(theta, values)
    bins = int(np.clip(np.sqrt(len(values)), 4, MOST_BINS))
    first_order = np.array([_between_bins(theta[:, k], numbers, bins) for k in range(theta.shape[1])])
    at = theta[worst]
    d = len(at)
    others = np.where(np.eye(d, dtype=bool), 0.0, at)
    single = np.where(np.eye(d, dtype=bool), at, 0.0)
    judge = batch.judge
    found = judge.of(judge.set.members(np.vstack([others, single, np.zeros((1, d))])))
    return Influence(
        tuple(b.name for b in batch.uncertain.blocks),
        first_order,
        _noise(len(values), bins),
        coefficients,
        fit,
        not finite,
        float(values[worst]),
        found[:d],
        found[d : 2 * d],
        float(found[-1]),
        judge.unit,
        len(values),
    )


def _between_bins(x: Array, y: Array, bins: int) -> float:
    """Omega squared of y in bins of x of equal count: an estimate of Var(E[y|x]) / Var(y) that is 0 for noise."""
    ordered = y[np.argsort(x, kind="stable")] - y.mean()
    parts = np.array_split(ordered, bins)
    total = float((ordered**2).sum())
    between = sum(len(part) * float(part.mean()) ** 2 for part in parts)
    within = (total - between) / (len(y) - bins)
    # Rounding of equal values is no variance.
    if total <= len(y) * (1e-12 * float(np.abs(y).max())) ** 2:
        return 0.0
    return float(np.clip((between - (bins - 1) * within) / (total + within), 0.0, 1.0))


def _noise(n: int, bins: int) -> float:
    """95 % quantile of omega squared for a parameter without influence: from that of Fisher's F."""
    from scipy.stats import f

    ratio = float(f.ppf(0.95, bins - 1, n - bins))
    return max(0.0, (bins - 1) * (ratio - 1) / ((bins - 1) * ratio + n - bins + 1))


def _ranks(y: Array) -> Array:
    from scipy.stats import rankdata

    return np.asarray(rankdata(y, axis=0), dtype=float)


def _rank_regression(theta: Array, values: Array) -> tuple[Array, float]:
    n, d = theta.shape
    x, y = _ranks(theta), _ranks(values)
    x, y = x - x.mean(axis=0), y - y.mean()
    if n <= d + 1:
        return np.full(d, np.nan), np.nan
    size, spread = x.std(axis=0), y.std()
    if spread == 0:
        return np.zeros(d), 1.0
    found = np.linalg.lstsq(x / size, y / spread, rcond=None)[0]
    residual = y / spread - (x / size) @ found
    return found, float(1.0 - (residual**2).mean())
