"""Functional mock-up units for co-simulation (FMI 2.0 and 3.0) as plants, run by FMPy in a child process."""

from __future__ import annotations

import json
import math
import signal
import subprocess
import sys
import tempfile
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from robustlab.arrays import Array
from robustlab.budget import NOT_REPEATABLE, child_environment
from robustlab.checks import number
from robustlab.dynamics.parameters import Parameter, overridden
from robustlab.dynamics.plant_base import SteppedPlant
from robustlab.errors import DependencyMissing, InputError, NativeTimeout, NoTrustworthyNumber
from robustlab.provenance import BY_UNIT, Provenance, file_sha256
from robustlab.statespace import Signal

MOST_BYTES = 1 << 31  # of the unpacked archive
EVEN = 1e-6  # allowed relative difference of steps for a unit that requires equal ones
NO_STATE = "a co-simulation unit steps itself: it shows no rates, and no state of it can be set"


def fmu(path: str | Path, *, time_limit: float = 60.0, **parameters: Any) -> FmuPlant:
    """Return the unit in a file as a plant; see `FmuPlant`."""
    name = str(path)
    number(f"{name}: time_limit", time_limit, "a time in s", above=0)
    if not Path(path).is_file():
        raise InputError(name, "no such file", "a functional mock-up unit (.fmu)")
    if find_spec("fmpy") is None:
        raise DependencyMissing("fmpy", "not installed", "the package FMPy", "pip install 'robustlab[fmi]'")
    about, _ = _request(path, {"op": "describe"}, time_limit)
    defaults = []
    for p in about["parameters"]:
        sign: Any = "positive" if p["low"] > 0 else "nonnegative" if p["low"] == 0 else "any"
        source = "the unit's description"
        defaults.append(Parameter(p["name"], p["start"], p["unit"], 0.0, source, p["meaning"], sign))
    sides = {side: tuple(Signal(v["name"], v["unit"]) for v in about[side]) for side in ("inputs", "outputs")}
    made = FmuPlant(
        about["name"], overridden(defaults, parameters, about["name"]), **sides, states=(),
        path=Path(path).absolute(), sha256=file_sha256(path), time_limit=time_limit, about=about,
    )  # fmt: skip
    made.traced(Provenance.now(BY_UNIT, {name: made.sha256}))
    return made


@dataclass(frozen=True, eq=False, repr=False)
class FmuPlant(SteppedPlant):
    """A functional mock-up unit for co-simulation as a plant without accessible states."""

    path: Path
    sha256: str
    time_limit: float
    about: Mapping[str, Any]

    def stepped(self, t: Array, u: Array, x0: Array, step: float | None = None) -> tuple[Array, Array]:
        steps = np.diff(t)
        if not self.about["variable_step"] and len(steps) and np.ptp(steps) > EVEN * steps.mean():
            raise InputError(f"simulate {self.name}", "steps that differ", "equal steps, as the unit requires")
        if file_sha256(self.path) != self.sha256:
            raise InputError(str(self.path), "changed since the plant was made", None, "make the plant again")
        request = {"op": "step", "longest": step, "values": self.values}
        _, y = _request(self.path, request, self.time_limit, np.column_stack([t, u]))
        assert y is not None
        if not np.isfinite(y).all():
            k, j = np.argwhere(~np.isfinite(y))[0]
            raise NoTrustworthyNumber(self.name, f"{self.outputs[j].name} is {y[k, j]:g} at t = {t[k]:.9g} s")
        return np.zeros((len(t), 0)), y

    def _refused(self, *_: Any, **__: Any) -> NoReturn:
        raise InputError(self.name, NO_STATE, "a plant with equations", "identify a model from rl.simulate")

    linear_model = derivative = output = jacobians = equilibrium = _refused


def _request(
    path: str | Path, request: Mapping[str, Any], time_limit: float, array: Array | None = None
) -> tuple[dict[str, Any], Array | None]:
    """Return the child's answer to a request: a table, and the array of outputs of a simulation."""
    unit, running = str(path), request["op"] == "step"
    fault = NoTrustworthyNumber if running else InputError
    with tempfile.TemporaryDirectory(prefix="robustlab-fmu-") as name:
        folder = Path(name)
        whole = {**request, "path": str(Path(path).absolute()), "seconds": time_limit}
        (folder / "request.json").write_text(json.dumps(whole), encoding="utf-8")
        if array is not None:
            np.save(folder / "given.npy", array)
        # -P: the child must not import modules from the working directory.
        command = [sys.executable, "-P", "-m", __name__, name]
        try:
            done = subprocess.run(  # noqa: S603  our own interpreter with our own module
                command, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
                env=child_environment(), timeout=time_limit, check=False,
            )  # fmt: skip
        except subprocess.TimeoutExpired:
            found = f"the unit gave no answer in its {time_limit:g} s; its process was ended"
            raise NativeTimeout(unit, found, None, f"{NOT_REPEATABLE}; time_limit= gives it longer") from None
        if done.returncode < 0:
            raise fault(unit, f"the unit crashed (signal {-done.returncode})")
        if not (folder / "answer.json").is_file():
            raise fault(unit, f"the unit's process ended with {done.returncode} and without an answer")
        answer = json.loads((folder / "answer.json").read_text(encoding="utf-8"))
        if "error" in answer:
            raise fault(unit, answer["error"], "a functional mock-up unit (FMI 2.0 or 3.0) for co-simulation")
        return answer, np.load(folder / "found.npy", allow_pickle=False) if running else None


def _answer(folder: Path) -> None:
    request = json.loads((folder / "request.json").read_text(encoding="utf-8"))
    if hasattr(signal, "alarm"):
        signal.alarm(math.ceil(request["seconds"]) + 5)  # in case the parent has died
    answer: dict[str, Any] = {}
    try:
        import fmpy

        description = fmpy.read_model_description(request["path"], validate=False)
        if request["op"] == "describe":
            answer = _described(description)
        else:
            np.save(folder / "found.npy", _stepped(request, description, folder))
    except Exception as error:  # noqa: BLE001  any error of the unit or its reader is a result
        answer = {"error": " ".join(f"{error}".split())[:300] or type(error).__name__}
    (folder / "answer.json").write_text(json.dumps(answer), encoding="utf-8")


def _described(description: Any) -> dict[str, Any]:
    """Return name, real signals, parameters and step capability; raise ValueError where the unit cannot be run."""
    if description.coSimulation is None:
        raise ValueError("a unit for model exchange alone: export it for co-simulation with its own solver")
    real = [v for v in description.modelVariables if v.type in ("Real", "Float64")]
    of = {cause: [v for v in real if v.causality == cause] for cause in ("input", "output", "parameter")}
    for v in (*of["input"], *of["output"]):
        if v.dimensions:
            raise ValueError(f"{v.name} is an array: export the unit with scalars")
    if not of["output"]:
        raise ValueError("no output that is a real number")

    def stated(v: Any, key: str) -> Any:
        return getattr(v, key) or getattr(v.declaredType, key, None)

    signals = {
        side: [{"name": v.name, "unit": stated(v, "unit") or ""} for v in of[cause]]
        for side, cause in (("inputs", "input"), ("outputs", "output"))
    }
    parameters = [
        {
            "name": v.name, "unit": stated(v, "unit") or "", "start": float(v.start), "meaning": v.description or "",
            "low": float(stated(v, "min") or -math.inf),
        }
        for v in of["parameter"]
        if v.variability in ("fixed", "tunable") and v.start is not None and not v.dimensions
    ]  # fmt: skip
    variable = bool(description.coSimulation.canHandleVariableCommunicationStepSize)
    name = description.modelName or "unit"
    return {"name": name, **signals, "parameters": parameters, "variable_step": variable}


def _stepped(request: Mapping[str, Any], description: Any, folder: Path) -> Array:
    """Return outputs (n, n_y) at the times of the given table (t, u), with the inputs held between them."""
    import fmpy
    from fmpy.simulation import instantiate_fmu

    with zipfile.ZipFile(request["path"]) as archive:
        if sum(info.file_size for info in archive.infolist()) > MOST_BYTES:
            raise ValueError(f"an archive of more than {MOST_BYTES} bytes unpacked")
    unit: Any = instantiate_fmu(fmpy.extract(request["path"], folder / "unit"), description, "CoSimulation")
    two = description.fmiVersion.startswith("2")
    put, get = (unit.setReal, unit.getReal) if two else (unit.setFloat64, unit.getFloat64)
    known = {v.name: v.valueReference for v in description.modelVariables}
    about, given = _described(description), np.load(folder / "given.npy", allow_pickle=False)
    ins, outs = ([known[v["name"]] for v in about[side]] for side in ("inputs", "outputs"))
    t, u, longest = given[:, 0].tolist(), given[:, 1:].tolist(), request["longest"] or math.inf
    if two:
        unit.setupExperiment(startTime=t[0])
    put([known[name] for name in request["values"]], list(request["values"].values()))
    if two:
        unit.enterInitializationMode()
    else:
        unit.enterInitializationMode(startTime=t[0])
    put(ins, u[0])
    unit.exitInitializationMode()
    found = np.empty((len(t), len(outs)))
    for k, time in enumerate(t):
        put(ins, u[k])
        found[k] = get(outs)
        if k + 1 < len(t):
            length = t[k + 1] - time
            pieces = max(math.ceil(length / longest - 1e-9), 1)
            for piece in range(pieces):
                unit.doStep(time + piece * length / pieces, length / pieces)
    return found


if __name__ == "__main__":
    _answer(Path(sys.argv[1]))
