"""Controllers for other programs: the compiled C gives back the simulation, MATLAB and HDF5 give back every bit."""

import ctypes
import shutil
import subprocess

import numpy as np
import pytest
from patience import PATIENCE

import robustlab as rl
from robustlab import discretise
from robustlab.errors import InputError
from robustlab.storage import back_calculation, c_source

CC = shutil.which("cc")
STRICT = ["-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic", "-Wconversion", "-O2", "-ffp-contract=off"]
needs_cc = pytest.mark.skipif(CC is None, reason="no C compiler (cc) here")


def random_controller(seed, n=5, m=3, p=2, dt=1e-3):
    rng = np.random.default_rng(seed)
    a = rng.standard_normal((n, n))
    a *= 0.95 / max(np.abs(np.linalg.eigvals(a)).max(), 0.1) if n else 1.0
    a[rng.random((n, n)) < 0.2] = 0.0
    return rl.StateSpaceModel(a, rng.standard_normal((n, m)), rng.standard_normal((p, n)),
                              rng.standard_normal((p, m)), dt)  # fmt: skip


def compiled(folder, source, name="controller"):
    (folder / f"{name}.c").write_text(source)
    library = folder / f"{name}.so"
    subprocess.run(
        [CC, *STRICT, "-shared", "-fPIC", "-o", str(library), str(folder / f"{name}.c")], check=True, timeout=PATIENCE
    )
    return ctypes.CDLL(str(library))


def run(library, model, y, prefix="controller"):
    """Control signals of the compiled code, (n, p)."""
    doubles = ctypes.POINTER(ctypes.c_double)
    state = np.full(max(model.n_states, 1), 7.0)
    out = np.zeros((len(y), model.n_outputs))
    getattr(library, f"{prefix}_init")(state.ctypes.data_as(doubles))
    step = getattr(library, f"{prefix}_step")
    for k, row in enumerate(np.ascontiguousarray(y, dtype=float)):
        step(state.ctypes.data_as(doubles), row.ctypes.data_as(doubles), out[k].ctypes.data_as(doubles))
    return out


@needs_cc
@pytest.mark.parametrize(("n", "m", "p"), [(5, 3, 2), (0, 2, 2), (1, 1, 1), (12, 1, 3)])
def test_the_compiled_controller_is_the_simulated_one(tmp_path, n, m, p):
    model = random_controller(n, n, m, p)
    path = rl.export_controller(tmp_path / "k.c", model)
    y = np.random.default_rng(0).standard_normal((10_000, m))
    t = model.dt * np.arange(len(y))
    record = rl.simulate(model, t, y)
    wanted = np.column_stack([record[s.name] for s in model.outputs])
    found = run(compiled(tmp_path, path.read_text()), model, y)
    assert np.abs(found - wanted).max() <= 1e-12 * max(1.0, np.abs(wanted).max())
    assert ctypes.c_double.in_dll(ctypes.CDLL(str(tmp_path / "controller.so")), "controller_sample_time").value == 1e-3


@needs_cc
def test_within_the_limits_the_code_is_the_model_to_the_last_bit(tmp_path):
    model = random_controller(4, 3, 1, 2)
    y = np.random.default_rng(1).standard_normal((300, 1))
    free = run(compiled(tmp_path, c_source(model), "free"), model, y)
    wide = [(-1.0 - np.abs(free).max(), 1.0 + np.abs(free).max())] * 2
    source = c_source(model, limits=wide)
    assert "cut0" in source
    assert "cut1" in source
    np.testing.assert_array_equal(run(compiled(tmp_path, source, "wide"), model, y), free)


def simulated(model, gain, limits, y):
    """Back-calculation, written here: held outputs (n, p) and the states (n + 1, n_x)."""
    low, high = np.transpose(limits)
    x, out, states = np.zeros(model.n_states), [], [np.zeros(model.n_states)]
    for row in y:
        demand = model.C @ x + model.D @ row
        held = np.minimum(np.maximum(demand, low), high)
        x = model.A @ x + model.B @ row + gain @ (held - demand)
        out.append(held)
        states.append(x)
    return np.array(out), np.array(states)


@needs_cc
@pytest.mark.parametrize(("seed", "n", "m", "p"), [(2, 1, 1, 1), (3, 4, 2, 1), (5, 6, 1, 2)])
def test_saturated_code_is_the_back_calculation(tmp_path, seed, n, m, p):
    model = random_controller(seed, n, m, p)
    limits = [(-0.4, 0.7), (-1.0, 0.1)][:p]
    gain = back_calculation(model, limits, 5e-3)
    source = c_source(model, limits=limits, anti_windup=5e-3)
    y = np.random.default_rng(seed).standard_normal((2000, m))
    wanted, _ = simulated(model, gain, limits, y)
    found = run(compiled(tmp_path, source), model, y)
    assert np.isin(wanted, np.ravel(limits)).mean() > 0.3  # it does saturate
    assert np.abs(found - wanted).max() <= 1e-12


@needs_cc
def test_an_integrator_that_was_saturated_recovers_within_the_stated_time(tmp_path):
    # PI: y = 2 e + 40 x, x' = e; e = +1 for 2 s, far beyond the limit, then -0.1.
    dt, limits = 1e-3, [(-1.0, 1.0)]
    model = rl.StateSpaceModel([[1.0]], [[dt]], [[40.0]], [[2.0]], dt, [("e q", "m")], [("u", "V")])
    e = np.concatenate([np.ones(2000), -0.1 * np.ones(1000)])[:, None]
    source = c_source(model, limits=limits, anti_windup=0.02)
    found = run(compiled(tmp_path, source), model, e)[:, 0]
    gain = back_calculation(model, limits, 0.02)
    wanted, states = simulated(model, gain, limits, e)
    assert np.abs(found - wanted[:, 0]).max() <= 1e-12
    # Held at v = 1 for long, the state rests where dt e + L (v - 40 x - 2 e) = 0; free, it would be at 2.
    assert states[2000, 0] == pytest.approx((1.0 + dt / gain[0, 0] - 2.0) / 40.0, rel=1e-6)
    assert np.abs(states).max() < 0.1
    assert np.argmax(found[2000:] < 1.0) * dt <= 0.02  # the actuator leaves its stop within T
    wound = run(compiled(tmp_path, c_source(model, limits=limits, anti_windup=np.inf), "wound"), model, e)[:, 0]
    assert (wound[2000:] == 1.0).all()  # what it is there for: without it, held for another second and more


def test_an_unobservable_slow_mode_is_rejected():
    model = rl.StateSpaceModel(np.diag([1.0, 0.5]), [[1.0], [1.0]], [[0.0, 1.0]], [[0.0]], 1e-3)
    with pytest.raises(InputError, match="does not show"):
        c_source(model, limits=[(-1.0, 1.0)])
    with pytest.raises(InputError, match="at least one sample time"):
        c_source(model, limits=[(-1.0, 1.0)], anti_windup=1e-4)
    assert "none needed" in c_source(rl.StateSpaceModel([[0.5]], [[1.0]], [[1.0]], [[0.0]], 1e-3), limits=[(-1.0, 1.0)])


HOSTILE = [
    "*/ int main(void) { return 1; } /*",
    'x"; system("rm -rf /"); //',
    "ends with a backslash \\",
    "trigraph ??/",
    "line\nbreak",
    "\u202egnirts",
    "/* nested",
    "**//",
    "ß",
]


@needs_cc
def test_hostile_names_stay_comments(tmp_path):
    m = len(HOSTILE)
    rng = np.random.default_rng(0)
    names = [(name, "/*" if i % 2 else "V*/") for i, name in enumerate(HOSTILE)]
    model = rl.StateSpaceModel(
        [[0.5]], rng.standard_normal((1, m)), [[1.0]], rng.standard_normal((1, m)), 0.1, names, [("int", "")]
    )
    source = c_source(model, notes=['*/ #error "no"', "\\"])
    assert source.count("*/") == source.count("/*")
    assert all(" " <= c <= "~" or c == "\n" for c in source)
    assert "system" not in source.split("*/", 1)[1]
    library = compiled(tmp_path, source)
    y = rng.standard_normal((5, m))
    x, wanted = 0.0, []
    for row in y:
        wanted.append(x + float(model.D[0] @ row))
        x = 0.5 * x + float(model.B[0] @ row)
    assert run(library, model, y)[:, 0] == pytest.approx(wanted, abs=1e-12)


def test_matlab_and_hdf5_give_back_every_bit(tmp_path):
    from scipy.io import loadmat

    model = random_controller(7).renamed([("phi", "rad"), ("omega", "rad/s"), ("i", "A")], [("u", "V"), ("v", "V")])
    held = rl.Controller(model, 1.25, rl.Status.CERTIFIED, "hinf")
    stored = loadmat(rl.export_controller(tmp_path / "k.mat", held))
    again = rl.load(rl.export_controller(tmp_path / "k.h5", held))
    for name in "ABCD":
        np.testing.assert_array_equal(stored[name], getattr(model, name))
        np.testing.assert_array_equal(getattr(again.K, name), getattr(model, name))
    assert stored["dt"].item() == model.dt
    assert (again.gamma, again.status, again.method) == (1.25, "certified", "hinf")


@needs_cc
def test_the_header_of_a_mixed_sensitivity_design_has_the_stabilising_sign(tmp_path):
    """Connected as in the header the loop settles on the reference; with the other sign it does not."""
    plant = rl.StateSpaceModel([[-20.0]], [[40.0]], [[1.0]], [[0.0]], inputs=[("u", "V")], outputs=[("omega", "rad/s")])
    design = rl.mixsyn(plant, rl.performance_weight(bandwidth=50.0, error=1e-3), rl.control_weight(0.1), None)
    digital = discretise(design.K, 1e-3, "tustin")
    source = c_source(digital)
    assert "REFERENCE MINUS MEASUREMENT: (omega wanted) - (omega measured)" in source
    library, held = compiled(tmp_path, source), discretise(plant, 1e-3, "zoh")
    for sign, settles in ((1.0, True), (-1.0, False)):
        step, state, x, u = library.controller_step, np.zeros(digital.n_states), np.zeros(1), np.zeros(1)
        doubles = ctypes.POINTER(ctypes.c_double)
        for _ in range(1000):
            e = np.array([sign * (3.0 - held.C @ x).item()])
            step(*(a.ctypes.data_as(doubles) for a in (state, e, u)))
            x = held.A @ x + held.B @ u
        assert (abs((held.C @ x).item() - 3.0) < 0.05) == settles


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"dt": 0.0}, "continuous controller"),
        ({"prefix": "int"}, "prefix"),
        ({"prefix": "Ab"}, "lower-case"),
        ({"prefix": "a;b"}, "lower-case"),
        ({"saturation": (1.0, -1.0)}, "low < high"),
        ({"saturation": 3.0}, "two numbers"),
        ({"saturation": {"y1": (-1, 1)}}, "no limits of 'y2'"),
        ({"saturation": {"y1": (-1, 1), "y2": (-1, 1), "z": (0, 1)}}, "no output 'z'"),
        ({"m": 0}, "at least one of each"),
    ],
)
def test_bad_inputs_are_named(tmp_path, changes, words):
    sizes = {k: changes[k] for k in ("dt", "m") if k in changes}
    options = {k: v for k, v in changes.items() if k not in sizes}
    with pytest.raises(rl.InputError, match=words) as caught:
        rl.export_controller(tmp_path / "k.c", random_controller(0, **sizes), **options)
    assert not list(tmp_path.iterdir())
    if "dt" in changes:
        assert "discretise" in str(caught.value)
