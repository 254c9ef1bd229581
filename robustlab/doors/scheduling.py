"""Doors of gain scheduling: models that depend on measured parameters, their gain, their controllers."""

from __future__ import annotations

from typing import Annotated, Any

import robustlab as rl
from robustlab.doors.declaration import Named, door
from robustlab.doors.kinds import Choice, Number, Table, Thing, Whole
from robustlab.doors.words import Search
from robustlab.errors import InputError, UsageError

USUAL = Search()
Scheduled = Annotated[
    Any, Thing(("uncertain", "model", "any")), "Uncertain model with real parameters, or an LPV model.", Named(key="of")
]
Points = Annotated[
    dict[str, int] | None,
    Table(Whole(2, 100), words="NAME=NUMBER"),
    "Parameter -> how many points its range gets; 2 where left out.",
    Named(option="--grid", key="points"),
]
Rates = Annotated[
    dict[str, float] | None,
    Table(Number(least=0)),
    "Parameter -> bound of its rate per second; any rate where left out.",
    Named(option="--rate", key="rates"),
]
Lyapunov = Annotated[
    str | None, Choice(("constant", "varying")), "Lyapunov matrix; both, as far as rates are bounded, where left out."
]


def _scheduled(system: Any, points: dict[str, int] | None, rates: dict[str, float] | None) -> Any:
    """The LPV model, or that of an uncertain one."""
    if isinstance(system, rl.UncertainModel):
        return rl.lpv_model(system, points, rates)
    if not isinstance(system, rl.LPVModel):
        raise InputError("lpv", f"a {type(system).__name__}", "an LPV or an uncertain model")
    if points:
        raise InputError("points", "given", "none: the LPV model has its own")
    return system.with_rates(**(rates or {}))


@door("lpv build", "lpv", result="synthesis.scheduling.parameter_varying.LPVModel", gives="any")
def lpv_model(system: Scheduled, points: Points = None, rates: Rates = None) -> Any:
    """LPV model of an uncertain one: its real parameters become measured ones; what it is between the points is proved.

    Example: robustlab lpv build spring.h5 --grid k=5 --rate k=0.5 --out lpv.h5
    """
    return _scheduled(system, points, rates)


@door("lpv gain", "lpv-gain", result="synthesis.scheduling.induced_gain.LPVGain")
def lpv_gain(
    system: Scheduled,
    points: Points = None,
    rates: Rates = None,
    lyapunov: Lyapunov = None,
    search: Search = USUAL,
) -> Any:
    """Induced L2 gain over all trajectories of measured parameters, proved between the points too.

    Exit code 4: none could be proved.

    Example: robustlab lpv gain lpv.h5 --rate k=0.5
    """
    given: Any = lyapunov
    return rl.peak_gain(_scheduled(system, points, rates), lyapunov=given, **search.options)


@door("lpv hinf", "lpv-hinf", result="synthesis.scheduling.scheduled_synthesis.LPVSynthesis", gives="controller",
      made="controller")  # fmt: skip
def lpv_hinf(
    system: Scheduled,
    measurements: Annotated[int, Whole(1), "How many of the last outputs are measured."],
    controls: Annotated[int, Whole(1), "How many of the last inputs are controls."],
    points: Points = None,
    rates: Rates = None,
    lyapunov: Lyapunov = None,
    search: Search = USUAL,
    progress: Any = None,
) -> Any:
    """Scheduled H-infinity controller u = K(rho) y (positive feedback), its loop verified for all trajectories.

    Exit code 4: no controller could be vouched for.

    Example: robustlab lpv hinf plant.h5 --measurements 1 --controls 1 --out controller.h5
    """
    given: Any = lyapunov
    options: dict[str, Any] = {**search.options, "progress": progress}
    return rl.hinf(_scheduled(system, points, rates), measurements, controls, lyapunov=given, **options)


@door("lpv at", "lpv-at", result="statespace.StateSpaceModel", gives="model")
def lpv_at(
    system: Annotated[Any, Thing(("any",)), "LPV model or scheduled controller: HDF5 file.", Named(key="of")],
    values: Annotated[dict[str, float] | None, Table(Number()), "Value of each parameter.", Named(option="*")] = None,
) -> Any:
    """The model or the controller at one value of every parameter.

    Example: robustlab lpv at controller.h5 k=2.5 --out frozen.h5
    """
    from robustlab.synthesis.scheduling.scheduled_controller import LPVController

    if not values:
        raise UsageError("lpv at", "no values", "one of each parameter: NAME=VALUE")
    if not isinstance(system, (rl.LPVModel, LPVController)):
        raise InputError("lpv at", f"a {type(system).__name__}", "an LPV model or a scheduled controller")
    return system.at(values or {})
