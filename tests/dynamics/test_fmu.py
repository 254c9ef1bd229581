"""A co-simulation unit made by pythonfmu against its closed form; docs/plants.md."""

import hashlib
import re
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest

import robustlab as rl
from robustlab.errors import NativeTimeout

pytest.importorskip("fmpy")
pytest.importorskip("pythonfmu")

T = np.linspace(0.0, 1.0, 101)
COMMAND = [sys.executable, "-c", "from robustlab.cli.main import main; main()"]
PAGE = (Path(__file__).parents[2] / "docs" / "plants.md").read_text(encoding="utf-8")
SLAVE = '''
from pythonfmu import Fmi2Causality, Fmi2Slave, Fmi2Variability, Real

class Motor(Fmi2Slave):
    """J domega/dt = K u - d omega, exactly from step to step."""

    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.u, self.omega, self.J, self.d, self.K = 0.0, 0.0, 0.02, 0.1, 0.05
        self.register_variable(Real("u", causality=Fmi2Causality.input))
        self.register_variable(Real("omega", causality=Fmi2Causality.output))
        self.register_variable(Real("torque", causality=Fmi2Causality.output, getter=lambda: self.K * self.u))
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


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    folder = tmp_path_factory.mktemp("fmu")
    (folder / "motor.py").write_text(SLAVE)
    build = [sys.executable, "-m", "pythonfmu", "build", "-f", str(folder / "motor.py"), "-d", str(folder)]
    subprocess.run(build, check=True, capture_output=True)
    return folder / "Motor.fmu"


@pytest.fixture(scope="module")
def motor(file):
    return rl.plant(str(file), J=(0.02, 0.2))


def speed(t, J=0.02, u=2.0):
    return 0.5 * u * (1 - np.exp(-0.1 / J * t))


def test_it_follows_its_closed_form_and_outputs_see_the_input_of_their_sample(motor):
    u = np.where(np.arange(101) < 50, 2.0, 1.0)
    record = rl.simulate(motor, T, u)
    np.testing.assert_allclose(record["omega"][:51], speed(T[:51]), atol=1e-14)
    np.testing.assert_allclose(record["torque"], 0.05 * u, rtol=1e-15)
    slower = motor.with_parameters(J=0.05)
    np.testing.assert_allclose(rl.simulate(slower, T, 2 * np.ones(101))["omega"], speed(T, 0.05), atol=1e-14)
    np.testing.assert_allclose(rl.simulate(motor, T, 2 * np.ones(101), step=2e-3)["omega"], speed(T), atol=1e-13)
    answer = rl.sample(motor, 0, vertices="all").respond(T, 2.0)
    np.testing.assert_allclose(answer.y[:, :, 0], [speed(T, 0.016), speed(T, 0.024)], atol=1e-14)


@pytest.mark.parametrize(
    ("call", "match"),
    [
        (rl.linearise, "shows no rates"),
        (rl.trim, "shows no rates"),
        (lambda motor: rl.compare(motor, rl.Record(T, {"u": T}, {"omega": T})), "nonlinear plant"),
        (lambda motor: rl.simulate(motor, T, T, hold="foh"), "'zoh'"),
        (lambda motor: rl.save("never.h5", motor), "a program"),
        (lambda motor: rl.plant(str(motor.path), mass=1.0), "mass"),
    ],
)
def test_unsupported_calls_are_rejected(motor, call, match):
    with pytest.raises(rl.InputError, match=match):
        call(motor)


@pytest.mark.slow
def test_a_unit_that_fails_hangs_or_is_none_is_one_line(motor, tmp_path):
    with pytest.raises(rl.NoTrustworthyNumber, match="fmi2DoStep failed"):
        rl.simulate(motor, T, np.full(101, 2e3))
    with pytest.raises(NativeTimeout):
        rl.simulate(rl.plant(str(motor.path), time_limit=4.0), T, np.full(101, -2e3))
    (tmp_path / "x.fmu").write_bytes(b"no archive")
    with pytest.raises(rl.InputError, match=r"x\.fmu"):
        rl.plant(str(tmp_path / "x.fmu"))
    xml = '<fmiModelDescription fmiVersion="2.0" modelName="a" guid="a"><ModelExchange modelIdentifier="a"/>'
    with zipfile.ZipFile(tmp_path / "x.fmu", "w") as archive:
        archive.writestr("modelDescription.xml", f"{xml}<ModelVariables/><ModelStructure/></fmiModelDescription>")
    with pytest.raises(rl.InputError, match="model exchange alone"):
        rl.plant(str(tmp_path / "x.fmu"))


@pytest.mark.slow
def test_the_page_and_a_recipe_run(file, tmp_path, monkeypatch):
    shutil.copy(file, tmp_path / "motor.fmu")
    monkeypatch.chdir(tmp_path)
    for block in re.findall(r"```python\n(.*?)```", PAGE, flags=re.DOTALL):
        exec(block, {})
    steps = '[step.axis]\ndo = "plant"\nplant = "motor.fmu"\nparameters = { J = 0.04 }\n'
    Path("axis.toml").write_text(f'schema = "robustlab.recipe/1"\nname = "axis"\n{steps}')
    lines = [line for line in PAGE.splitlines() if line.startswith("robustlab ")]
    for line in (*lines, "robustlab run axis.toml --out out"):
        done = subprocess.run([*COMMAND, *line.split()[1:]], capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
        assert "noise" not in done.stdout + done.stderr
    results = "".join(f.read_text() for f in Path("out").rglob("*.json"))
    assert hashlib.sha256(file.read_bytes()).hexdigest() in results
