"""Units made in the tests: a C source of our own for model exchange and co-simulation, pythonfmu for co-simulation."""

from __future__ import annotations

import shutil
import subprocess
import sys
import zipfile
from functools import cache
from pathlib import Path

import pytest

HERE = Path(__file__).parent
COMPILER = next((c for c in ("cc", "gcc", "tcc", "clang") if shutil.which(c)), None)
needs_compiler = pytest.mark.skipif(COMPILER is None, reason="no C compiler (cc, gcc, tcc or clang) to build the unit")

PARAMETERS = {
    "m": ("kg", 2.0, 'min="0.001"'),
    "c": ("N.s/m", 0.4, 'min="0"'),
    "k": ("N/m", 8.0, 'min="0.001"'),
    "k3": ("N/m3", 0.0, ""),
    "wall": ("m", 1e9, ""),
    "kick_time": ("s", 1e9, ""),
    "fault": ("1", 0.0, ""),
}
DEFINED = "".join(f'<Unit name="{u}"/>' for u in ("m", "m/s", "m/s2", "N", "kg", "N.s/m", "N/m", "N/m3", "s", "1"))
DEFINED = f"<UnitDefinitions>{DEFINED}</UnitDefinitions>"
EXACT = dict.fromkeys("qv", ' initial="exact"')
JOINT = '<Joint velocity="v" position="q" input="F"/>'


def description(version: int, *, directional: bool = True, events: bool = False, joint: bool = False) -> str:
    """modelDescription.xml of fmu_mass_on_spring.c; value references are the places in its enumeration."""
    can = "true" if directional else "false"
    if version == 2:
        real = [
            ("q", "output", "continuous", 'start="0.5" unit="m"'),
            ("v", "local", "continuous", 'start="0" unit="m/s"'),
            ("der(q)", "local", "continuous", 'derivative="1"'),
            ("der(v)", "local", "continuous", 'derivative="2"'),
            ("F", "input", "continuous", 'start="0" unit="N"'),
            ("a", "output", "continuous", 'unit="m/s2"'),
        ]
        real += [(n, "parameter", "fixed", f'start="{v}" unit="{u}" {more}') for n, (u, v, more) in PARAMETERS.items()]
        variables = "".join(
            f'<ScalarVariable name="{n}" valueReference="{k}" causality="{c}" variability="{v}"{EXACT.get(n, "")}>'
            f"<Real {r}/></ScalarVariable>"
            for k, (n, c, v, r) in enumerate(real)
        )
        variables += (
            '<ScalarVariable name="on" valueReference="0" causality="input" variability="discrete">'
            '<Boolean start="true"/></ScalarVariable>'
        )
        note = f'<VendorAnnotations><Tool name="robustlab">{JOINT}</Tool></VendorAnnotations>' if joint else ""
        return (
            f'<fmiModelDescription fmiVersion="2.0" modelName="mass-on-spring" guid="mass-on-spring" '
            f'numberOfEventIndicators="{int(events)}">'
            f'<ModelExchange modelIdentifier="unit" providesDirectionalDerivative="{can}"/>'
            f'<CoSimulation modelIdentifier="unit" providesDirectionalDerivative="{can}" '
            'canHandleVariableCommunicationStepSize="true"/>'
            f"{DEFINED}{note}<ModelVariables>{variables}</ModelVariables><ModelStructure>"
            '<Outputs><Unknown index="1"/><Unknown index="6"/></Outputs>'
            '<Derivatives><Unknown index="3"/><Unknown index="4"/></Derivatives>'
            "</ModelStructure></fmiModelDescription>"
        )
    real = [
        ("q", 'causality="output" initial="exact" start="0.5" unit="m"'),
        ("v", 'initial="exact" start="0" unit="m/s"'),
        ("der(q)", 'derivative="0"'),
        ("der(v)", 'derivative="1"'),
        ("F", 'causality="input" start="0" unit="N"'),
        ("a", 'causality="output" unit="m/s2"'),
    ]
    real += [(n, f'causality="parameter" variability="tunable" start="{v}" unit="{u}" {more}')
             for n, (u, v, more) in PARAMETERS.items()]  # fmt: skip
    variables = "".join(f'<Float64 name="{n}" valueReference="{k}" {r}/>' for k, (n, r) in enumerate(real))
    variables += '<Float64 name="z" valueReference="99"/>'
    variables += '<Float64 name="time" valueReference="98" causality="independent" variability="continuous"/>'
    note = f'<Annotations><Annotation type="org.robustlab">{JOINT}</Annotation></Annotations>' if joint else ""
    return (
        '<fmiModelDescription fmiVersion="3.0" modelName="mass-on-spring" instantiationToken="mass-on-spring">'
        f'<ModelExchange modelIdentifier="unit" providesDirectionalDerivatives="{can}" '
        'needsCompletedIntegratorStep="true"/>'
        f'<CoSimulation modelIdentifier="unit" providesDirectionalDerivatives="{can}"/>'
        f"{DEFINED}<ModelVariables>{variables}</ModelVariables><ModelStructure>"
        '<Output valueReference="0"/><Output valueReference="5"/>'
        '<ContinuousStateDerivative valueReference="2"/><ContinuousStateDerivative valueReference="3"/>'
        f"{'<EventIndicator valueReference=' + chr(34) + '99' + chr(34) + '/>' if events else ''}"
        f"</ModelStructure>{note}</fmiModelDescription>"
    )


@cache
def library(version: int, folder: Path) -> Path:
    """The compiled source; the functions of the interface that it has not got return an error."""
    from fmpy import fmi2, fmi3

    module = {2: fmi2, 3: fmi3}[version]
    kinds = getattr(module, f"FMU{version}Model"), getattr(module, f"FMU{version}Slave")
    source = (HERE / "fmu_mass_on_spring.c").read_text()
    names = {n for kind in kinds for n in dir(kind) if n.startswith(f"fmi{version}")}
    missing = sorted(n for n in names if f"{n}(" not in source)
    text = source + "".join(f"\nint {n}(void) {{ return 3; }}" for n in missing)
    file, built = folder / f"unit{version}.c", folder / f"unit{version}{shared_suffix()}"
    file.write_text(text)
    command = [str(COMPILER), "-shared", "-fPIC", "-w", f"-DFMI={version}", "-o", str(built), str(file), "-lm"]
    subprocess.run(command, check=True)
    return built


def shared_suffix() -> str:
    from fmpy import sharedLibraryExtension

    return sharedLibraryExtension


def packed(path: Path, xml: str, built: Path | None = None, version: int = 2) -> Path:
    """An archive of a description and a library."""
    from fmpy import platform, platform_tuple

    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("modelDescription.xml", xml)
        if built is not None:
            place = platform if version == 2 else platform_tuple
            archive.write(built, f"binaries/{place}/unit{shared_suffix()}")
    return path


SLAVE = '''
from pythonfmu import Fmi2Causality, Fmi2Slave, Fmi2Variability, Real

class Motor(Fmi2Slave):
    """J domega/dt = K u - d omega, exactly from step to step."""

    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.u, self.omega, self.J, self.d, self.K = 0.0, 0.0, 0.02, 0.1, 0.05
        self.register_variable(Real("u", causality=Fmi2Causality.input))
        self.register_variable(Real("omega", causality=Fmi2Causality.output))
        for name in ("J", "d", "K"):
            self.register_variable(Real(name, causality=Fmi2Causality.parameter, variability=Fmi2Variability.tunable))

    def do_step(self, t, h):
        import math
        print("noise")
        if self.u > 1e3:
            raise ValueError("the winding is burnt")
        while self.u < -1e3:
            pass
        decay = math.exp(-self.d / self.J * h)
        self.omega = decay * self.omega + (1 - decay) * self.K / self.d * self.u
        return True
'''


def python_motor(folder: Path) -> Path:
    """A co-simulation unit by pythonfmu."""
    script = folder / "motor.py"
    script.write_text(SLAVE)
    command = [sys.executable, "-m", "pythonfmu", "build", "-f", str(script), "-d", str(folder)]
    subprocess.run(command, check=True, capture_output=True)
    return folder / "Motor.fmu"
