"""Data of a validation over frequency: the lines of a record's mean period, or of a measured response."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from robustlab.arrays import Array, ComplexArray
from robustlab.display import Facts, listed, number
from robustlab.errors import InputError, NoTrustworthyNumber
from robustlab.identification.comparison.repeats import noise_floor
from robustlab.identification.validation.sampled_problem import noise_bounds, prepared, zero_order_hold
from robustlab.linear_analysis.frequency import frequency_response
from robustlab.record import Record
from robustlab.result import Evidence
from robustlab.statespace import Signal, StateSpaceModel, real_array
from robustlab.tables import Table, Tabular
from robustlab.uncertainty.blocks import block_slices
from robustlab.uncertainty.frequency_responses import UncertainFrequencyData, frequency_data
from robustlab.uncertainty.lft import UncertainModel

# z below this share of the largest is rounding: Delta cannot act there.
SILENT = 1e-10


@dataclass(frozen=True)
class FrequencyData(Tabular, Evidence):
    """A measured frequency response of one input.

    Attributes
    ----------
    omega
        Frequencies in rad/s, shape (n,), increasing.
    response
        Complex, shape (n, n_y), in units of output per input.
    input, outputs
        The driven input, and the measured outputs, by the names of the model.
    name
        Name in messages.

    Raises
    ------
    InputError
        Shapes that differ, numbers that are not finite, frequencies that do not increase.

    Examples
    --------
    >>> import robustlab as rl
    >>> lag = rl.StateSpaceModel([[-1.0]], [[1.0]], [[1.0]], [[0.0]], 0.0, ["u"], ["y"])
    >>> response = rl.frequency_response(lag, [0.5, 1.0, 2.0])[:, 0, 0] + 0.1
    >>> measured = FrequencyData([0.5, 1.0, 2.0], response, "u", ["y"])
    >>> found = rl.validate(rl.unstructured(lag, 0.2), measured, {"y": 0.02}, domain="frequency")
    >>> round(found.lower, 3), round(found.upper, 3), str(found.status)
    (0.4, 0.4, 'certified')
    """

    omega: Array
    response: ComplexArray
    input: str
    outputs: tuple[str, ...]
    name: str = "frequency response"

    def __init__(
        self,
        omega: ArrayLike,
        response: ArrayLike,
        input: str,
        outputs: tuple[str, ...] | list[str],
        name: str = "frequency response",
    ) -> None:
        w = real_array("omega", omega, 1, name)
        try:
            G = np.array(response, dtype=np.complex128)
        except (TypeError, ValueError):
            raise InputError(name, f"response: {response!r}", "complex numbers") from None
        for word, given in (("input", input), ("name", name)):
            if not isinstance(given, str):
                raise InputError(f"FrequencyData: {word}", repr(given), "a word")
        if isinstance(outputs, str) or not isinstance(outputs, Sequence):
            raise InputError("FrequencyData: outputs", repr(outputs), "a list of names")
        G = G[:, None] if G.ndim == 1 else G
        if w.ndim != 1 or not len(w) or not np.isfinite(w).all() or (np.diff(w) <= 0).any() or w[0] < 0:
            raise InputError(name, "omega", "finite increasing frequencies in rad/s, shape (n,)")
        if G.shape != (len(w), len(outputs)) or not np.isfinite(G).all():
            raise InputError(
                name, f"response of shape {G.shape}", f"finite numbers of shape ({len(w)}, {len(outputs)})"
            )
        vars(self).update(omega=w, response=G, input=input, outputs=tuple(outputs), name=name)
        self.__post_init__()

    def facts(self) -> Facts:
        first, last = number(float(self.omega[0])), number(float(self.omega[-1]), "rad/s")
        return [
            ("name", self.name),
            ("from", self.input),
            ("to", listed(self.outputs)),
            ("frequencies", f"{len(self.omega)}, {first} .. {last}"),
        ]

    def uncertain(self, radius: ArrayLike) -> UncertainFrequencyData:
        """Return the response with an uncertainty radius, (n,) or (n, n_y); see `robustlab.frequency_data`."""
        r = np.asarray(radius, dtype=np.float64)
        r = r[:, :, None] if r.ndim == 2 else r
        whole, ins = self.response[:, :, None], [self.input]
        return frequency_data(whole, self.omega, radius=r, name=self.name, inputs=ins, outputs=self.outputs)

    def table(self) -> Table:
        """Return the response of every output."""
        columns = {name: self.response[:, k] for k, name in enumerate(self.outputs)}
        return Table(("omega", self.omega), columns, {"omega": "rad/s"})


@dataclass(frozen=True)
class SpectralProblem:
    """The affine maps of this module, in scaled signals."""

    omega: Array  # frequencies in rad/s, shape (n,)
    # M11, M21, z0, e: (n, p, q), (n, n_y, q), (n, p), (n, n_y)
    M11: ComplexArray
    M21: ComplexArray
    z0: ComplexArray
    e: ComplexArray
    # weight of a line in the energy of a real signal (n,): 2, and 1 at zero and at the Nyquist frequency
    weight: Array
    real: NDArray[np.bool_]  # lines at which every spectrum of a real signal is real (n,)
    total: bool  # true: ``sum_k weight_k |n_kj|^2 <= radius_j^2`` for each output. False: ``|n_kj| <= 1`` at each line.
    radius: Array  # (n_y,)
    # blocks, names, scale: slices of w and z of each block, names, and the divisor of w and z of the block
    blocks: tuple[tuple[slice, slice], ...]
    names: tuple[str, ...]
    scale: Array

    @property
    def n(self) -> int:
        return len(self.omega)

    def z(self, w: ComplexArray) -> ComplexArray:
        """Compute the inputs of Delta (n, p)."""
        return self.z0 + np.einsum("kij,kj->ki", self.M11, w)

    def noise(self, w: ComplexArray) -> ComplexArray:
        """Compute the remaining noise (n, n_y), over its bound."""
        return self.e - np.einsum("kij,kj->ki", self.M21, w)

    def excess(self, noise: ComplexArray) -> float:
        """Return the noise over its bound: at most 1 if explained."""
        if not self.total:
            return float(np.abs(noise).max(initial=0.0))
        return float(np.sqrt((self.weight @ np.abs(noise) ** 2) / self.radius**2).max(initial=0.0))

    def sizes(self, w: ComplexArray) -> Array:
        """Compute ``|w| / |z|`` of each block at each line (n, blocks); inf where z is zero and w is not."""
        z, found = self.z(w), np.zeros((self.n, len(self.blocks)))
        for i, (rows, cols) in enumerate(self.blocks):
            top, under = np.linalg.norm(w[:, rows], axis=1), np.linalg.norm(z[:, cols], axis=1)
            with np.errstate(divide="ignore", invalid="ignore"):
                found[:, i] = np.where(top > 0, top / under, 0.0)
        return found

    def scaled(self) -> SpectralProblem:
        """Scale w and z of each block by its nominal z, and remove every block where its z is zero."""
        M11, M21, z0 = self.M11.copy(), self.M21.copy(), self.z0.copy()
        scales = []
        for rows, cols in self.blocks:
            size = float(np.sqrt((np.abs(z0[:, cols]) ** 2).mean())) or 1.0
            M21[:, :, rows] *= size
            M11[:, :, rows] *= size
            M11[:, cols] /= size
            z0[:, cols] /= size
            scales.append(size)
        loop = float(np.abs(M11).max(initial=0.0))
        silent = []
        for _, cols in self.blocks:
            size = np.linalg.norm(z0[:, cols], axis=1)
            silent.append(size <= SILENT * max(float(size.max(initial=0.0)), 1e-300))
            z0[np.ix_(silent[-1], range(cols.start, cols.stop))] = 0.0
        # An undriven well-posed loop is at zero: (I - M11 Delta) z = 0.
        undriven = np.all(silent, axis=0)
        for (rows, cols), quiet in zip(self.blocks, silent, strict=True):
            alone = np.abs(M11[:, cols]).max(initial=0.0) <= SILENT * max(loop, 1e-3)  # no w can make this z move
            still = quiet if alone else undriven
            M21[np.ix_(still, range(M21.shape[1]), range(rows.start, rows.stop))] = 0.0
            M11[np.ix_(still, range(M11.shape[1]), range(rows.start, rows.stop))] = 0.0
        return replace(self, M11=M11, M21=M21, z0=z0, scale=np.array(scales))


@dataclass(frozen=True)
class Spectrum:
    """A `SpectralProblem` with its data."""

    problem: SpectralProblem
    outputs: tuple[Signal, ...]  # compared outputs with units
    bound: Mapping[str, float]  # noise bound of each
    # t, y, nominal: one mean period of the record, its outputs (n_t, n_y), and the nominal steady state; for a
    # frequency response its frequencies and the magnitudes
    t: Array
    y: Array
    nominal: Array
    complex_y: ComplexArray  # the measured spectrum (n, n_y), in the units of the outputs
    unit_noise: Array  # divisor of ``e``, shape (n, n_y) or (1, n_y)
    assumptions: tuple[str, ...]


def spectrum_of_record(
    uncertain: UncertainModel, record: Record, noise: Mapping[str, float], period: float | None
) -> Spectrum:
    """Compute the lines of a record's mean period; the noise bound is the root mean square over the periods used."""
    where = f"validate {record.name}"
    _refused_blocks(uncertain, where)
    recorded = prepared(uncertain, record, noise, norm="rms", at_rest=True)
    try:
        floor = noise_floor(record, period=period, outputs=[s.name for s in recorded.outputs])
    except NoTrustworthyNumber as error:
        hint = 'domain="time" accepts any uniformly sampled record'
        raise NoTrustworthyNumber(where, f"no steady periods: {error.found}", "whole periods", hint) from None
    if floor.input_std:
        name = next(iter(floor.input_std))
        hint = 'domain="time" accepts any input'
        raise InputError(where, f"input {name!r} does not repeat exactly", "a periodic input: others leak", hint)
    n, dt = floor.samples, recorded.dt
    stacked = np.stack([floor.repeats(column) for column in recorded.y.T], axis=2)
    y = stacked.mean(axis=0)
    changing = ((stacked - y) ** 2).mean(axis=(0, 1)) / recorded.bound**2
    if (changing >= 1).any():
        j = int(changing.argmax())
        found = f"{recorded.outputs[j].name} changes from period to period by {np.sqrt(changing[j]):.3g} of its bound"
        raise NoTrustworthyNumber(where, f"not in steady state: {found}", "a steady record, or the noise it has",
                                  'domain="time", or leave the start of the record out')  # fmt: skip
    u = np.stack([floor.repeats(column).mean(axis=0) for column in recorded.u.T], axis=1)
    lines = np.arange(n // 2 + 1)
    edge = (lines == 0) | (2 * lines == n)
    M, (q, p) = recorded.uncertain.M, uncertain.delta_shape
    changed = f"what changes between them is {100 * np.sqrt(changing.max()):.3g} % of the noise bound"
    assumptions = [
        f"steady state over {floor.count} periods of {floor.period:.6g} s from sample {floor.first} on; {changed}",
        "the root mean square of the noise over these periods is within its bound",
    ]
    if M.dt == 0:
        assumptions.append(f"u and w are held between samples of {dt:.6g} s")
    poles = np.linalg.eigvals(M.A) if len(M.A) else np.zeros(0)
    rounding = 1e-9 * max(float(np.abs(poles).max(initial=0.0)), 1.0)
    integrates = bool((np.abs(poles - (1.0 if M.dt else 0.0)) <= rounding).any())
    if integrates:
        assumptions.append("the mean over a period is excluded: the model integrates")
    kept = lines[int(integrates) :]
    f = kept / (n * dt)
    A, B = zero_order_hold(M, dt)
    response = frequency_response(StateSpaceModel(A, B, M.C, M.D, dt=dt), 2 * np.pi * f)
    U, Y = np.fft.rfft(u, axis=0)[kept] / n, np.fft.rfft(y, axis=0)[kept] / n
    forced = np.einsum("kij,kj->ki", response[:, :, q:], U)
    e = (Y - forced[:, p:]) / recorded.bound
    left, weight = np.sqrt(1 - changing), np.where(edge, 1.0, 2.0)[kept]
    problem = SpectralProblem(
        2 * np.pi * f, response[:, :p, :q], response[:, p:, :q] / recorded.bound[None, :, None], forced[:, :p], e,
        weight=weight, real=edge[kept], total=True, radius=left, **_layout(uncertain),
    ).scaled()  # fmt: skip
    whole = np.zeros((n // 2 + 1, len(recorded.outputs)), dtype=complex)
    whole[kept] = forced[:, p:] * n
    nominal = np.fft.irfft(whole, n, axis=0)
    if integrates:
        nominal = nominal + y.mean(axis=0)
    bound = {s.name: float(b) for s, b in zip(recorded.outputs, recorded.bound, strict=True)}
    t, nominal = np.arange(n, dtype=np.float64) * dt, np.asarray(nominal, dtype=np.float64)
    unit = recorded.bound[None]
    return Spectrum(problem, recorded.outputs, bound, t, y, nominal, Y, unit, tuple(assumptions))


def spectrum_of_response(uncertain: UncertainModel, data: FrequencyData, noise: Mapping[str, ArrayLike]) -> Spectrum:
    """Return the lines of a measured frequency response; a noise bound is one number or one for each line (n,)."""
    where = f"validate {data.name}"
    _refused_blocks(uncertain, where)
    names = [s.name for s in uncertain.inputs]
    known = {"input": names, "output": [s.name for s in uncertain.outputs]}
    for kind, given in (("input", (data.input,)), ("output", data.outputs)):
        if unknown := [name for name in given if name not in known[kind]]:
            raise InputError(where, f"the model has no {kind} {unknown[0]!r}", f"one of {', '.join(known[kind])}")
    chosen = uncertain.select(outputs=list(data.outputs))
    n = len(data.omega)
    for name in set(noise) - set(data.outputs):
        raise InputError(f"{where}: noise of {name!r}", "no such output", f"one of {', '.join(data.outputs)}")
    bound = np.empty((n, len(data.outputs)))
    for j, name in enumerate(data.outputs):
        given = np.asarray(noise.get(name, np.nan), dtype=np.float64)
        if given.shape not in ((), (n,)):
            raise InputError(f"{where}: noise of {name!r}", f"shape {given.shape}", f"one number, or ({n},)")
        lowest = {name: float(given.min())} if name in noise else {}
        noise_bounds(lowest, (name,), "peak", where)
        if not np.isfinite(given).all():
            raise InputError(f"{where}: noise of {name!r}", "numbers that are not finite", "positive numbers")
        bound[:, j] = given
    M, (q, p) = chosen.M, uncertain.delta_shape
    if M.is_discrete and data.omega[-1] > np.pi / M.dt * (1 + 1e-9):
        raise InputError(where, f"{data.omega[-1]:g} rad/s", f"at most pi / dt = {np.pi / M.dt:g} rad/s")
    response = frequency_response(M, data.omega)
    forced = response[:, :, q + names.index(data.input)]
    e = (data.response - forced[:, p:]) / bound
    problem = SpectralProblem(
        data.omega, response[:, :p, :q], response[:, p:, :q] / bound[:, :, None], forced[:, :p], e,
        weight=np.ones(n), real=data.omega == 0, total=False, radius=np.ones(len(data.outputs)), **_layout(uncertain),
    ).scaled()  # fmt: skip
    assumptions = ("at each frequency the noise of an output is within its bound",)
    largest = {name: float(bound[:, j].max()) for j, name in enumerate(data.outputs)}
    sizes = np.abs(data.response), np.abs(forced[:, p:])
    return Spectrum(problem, chosen.outputs, largest, data.omega, *sizes, data.response, bound, assumptions)


def _layout(uncertain: UncertainModel) -> dict[str, Any]:
    """Return the block fields of an unscaled problem."""
    names = tuple(b.name for b in uncertain.blocks)
    return {"blocks": tuple(block_slices(uncertain.blocks)), "names": names, "scale": np.ones(len(names))}


def _refused_blocks(uncertain: UncertainModel, where: str) -> None:
    for block in uncertain.blocks:
        if block.is_real:
            raise InputError(
                where, f"block {block.name!r} is a real constant, one over all frequencies",
                "complex and full blocks: at each frequency alone it would count as another one", 'domain="time"',
            )  # fmt: skip
        if not block.is_ball:
            raise InputError(where, f"block {block.name!r} is one scalar repeated {block.rows} times",
                             "blocks whose w may be any vector not longer than z", 'domain="time"')  # fmt: skip
