"""`discover` on small simulated records with a known missing effect: names, values, probabilities, errors."""

from functools import cache

import numpy as np
import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st
from naming_cases import AXIS, DT, T, U, all_but, discovered, machine, noisy
from scipy.integrate import solve_ivp
from scipy.signal import cont2discrete

import robustlab as rl
from robustlab.errors import InputError, NoTrustworthyNumber

N = len(T)
LOST = np.ones(N, dtype=bool)
LOST[330:350] = LOST[700:703] = False

# --- effects ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", [3, 5])
def test_no_effect_is_named_for_a_complete_model(seed):
    found = discovered(machine(seed=seed))
    assert (found.verdict, found.complete) == ("no missing effect", True)
    assert found.effects == found.rivals == ()
    assert found.gap_after == pytest.approx(0.1, rel=0.25)  # the noise, in percent of the range


def test_friction_is_named_and_part_of_the_updated_plant():
    found = discovered(machine(friction=20.0))
    assert (found.verdict, found.complete, found.status) == ("named", True, rl.Status.CONVERGED)
    assert found.names == ("coulomb-friction",)
    (force,) = found.effects[0].parameters
    assert force.lower < 20.0 < force.upper
    assert force.value == pytest.approx(20.0, rel=0.02)
    assert found.effects[0].evidence > 100.0
    assert found.gap_after < 0.25 * found.gap_before
    assert found.model.effects[0].values["Fc"] == force.value
    assert found.held_out == "every 4th window of the records, kept from the fit"
    assert set(found.candidates) == {"coulomb-friction", "constant-load", "sensor-gain", "inertia"}
    numbers = found.numbers()
    dry = numbers["dry-friction"]
    assert numbers["kinds"] == ["dry-friction"]
    assert dry["level_lower"] < 20.0 < dry["level_upper"]
    assert numbers["time-delay"]["probability"] == 0.0
    assert np.isnan(numbers["time-delay"]["delay"])
    assert set(numbers) <= set(type(found).quantities)
    (kind,) = found.kinds
    assert (kind.settled, kind.words) == (True, "dry friction at v")


def test_two_effects_are_named_and_probabilities_sum_to_one():
    found = discovered(machine(friction=20.0, load=8.0, seed=3))
    assert set(found.names) == {"coulomb-friction", "constant-load"}
    values = {e.name: e.parameters[0].value for e in found.effects}
    assert values == pytest.approx({"coulomb-friction": 20.0, "constant-load": 8.0}, rel=0.01)
    shares = [s.probability for s in found.posterior]
    assert sum(shares) == pytest.approx(1.0)
    assert shares == sorted(shares, reverse=True)
    assert set(found.posterior[0].names) == set(found.names)
    assert shares[0] > 0.95


@pytest.mark.parametrize(
    ("mass", "size", "named"),
    [
        (1.08, 1e-3, True),
        pytest.param(0.92, 1e-3, True, marks=pytest.mark.slow),
        (1.045, 1e-3, False),
        (1.08, 0.3, False),  # within the noise of 1.04
    ],
)
def test_a_parameter_beyond_its_tolerance_is_named(mass, size, named):
    found = discovered(machine(mass=mass, seed=3, size=size), ("inertia", "coulomb-friction"))
    assert found.names == (("inertia",) if named else ())
    assert found.posterior[0].probability > 0.9
    assert sum(s.probability for s in found.posterior) == pytest.approx(1.0)
    if named:
        assert found.effects[0].parameters[0].value == pytest.approx(mass, rel=0.01)


def test_an_effect_that_only_a_parameter_beyond_its_tolerance_can_replace_is_relevant():
    """A change of the gain by 10 % has the effect of one of the mass by 9 %, whose tolerance is 5 %."""
    run = rl.simulate(AXIS.with_parameters(gain=1.1 * AXIS.values["gain"]), T, U)
    record = rl.Record(T, {"u": U}, noisy({k: run[k] for k in ("q", "v")}, 0), name="strong")
    few = all_but("input-gain", "coulomb-friction")
    found = rl.discover(AXIS, record, exclude=few, tolerances={"M": 0.05, "Fv": 0.05})
    assert found.names == ("input-gain",)
    assert not found.also_detectable
    (factor,) = found.kinds[0].values
    assert found.kinds[0].kind == "factor"
    assert factor.value == pytest.approx(1.1, rel=0.03)


@pytest.mark.slow
def test_bristle_friction_is_dry_friction_of_its_level():
    """Dahl friction of 20 N over 0.2 mm, by small explicit steps."""
    p, h, q, v, z = AXIS.values, DT / 20, 0.0, 0.0, 0.0
    seen = np.empty((N, 2))
    for k, now in enumerate(U):
        seen[k] = q, v
        for _ in range(20):
            middle = v + 0.5 * h * (p["gain"] * now - p["Fv"] * v - 1e5 * z) / p["M"]
            z += h * (middle - abs(middle) * z / 2e-4)
            v += h * (p["gain"] * now - p["Fv"] * middle - 1e5 * z) / p["M"]
            q += h * middle
    record = rl.Record(T, {"u": U}, noisy(dict(zip("qv", seen.T, strict=True)), 5), name="bristles")
    found = discovered(record, ("coulomb-friction", "presliding", "bouc-wen", "constant-load"))
    (kind,) = found.kinds
    assert (kind.kind, kind.place) == ("dry-friction", "v")
    (level,) = kind.values
    assert level.lower < level.value < level.upper
    assert level.value == pytest.approx(20.0, rel=0.05)  # without the stored energy of the bristles
    assert sum(kind.members.values()) == pytest.approx(1.0, abs=1e-6)


# --- indistinguishable effects ---------------------------------------------------------------------------------------


def path(rng):
    """Return a mass on a spring and a damper, and steps of its force over three seconds."""
    m, c, k = rng.uniform(0.5, 5.0), rng.uniform(1.0, 30.0), rng.uniform(60.0, 400.0)
    plant = rl.StateSpaceModel(
        [[0.0, 1.0], [-k / m, -c / m]], [[0.0], [1.0 / m]], [[1.0, 0.0]], [[0.0]],
        states=[("q", "m"), ("v", "m/s")], inputs=[("u", "N")], outputs=[("q", "m")],
    )  # fmt: skip
    t = 5e-3 * np.arange(600)
    u = np.repeat(rng.uniform(-3.0, 3.0, 30), 20)
    return plant, t, u


@pytest.mark.slow
@settings(max_examples=6, phases=[Phase.explicit, Phase.reuse, Phase.generate])
@given(seed=st.integers(0, 10_000), late=st.floats(2.5, 9.4))
def test_sensor_and_input_delays_of_one_path_are_equally_probable(seed, late):
    """Random masses, dampings, springs and delays."""
    rng = np.random.default_rng(seed)
    plant, t, u = path(rng)
    shifted = np.concatenate([np.full(round(10 * late), u[0]), np.repeat(u, 10)])[:6000]
    clean = rl.simulate(plant, 5e-4 * np.arange(6000), {"u": shifted})["q"][::10]
    record = rl.Record(t, {"u": u}, noisy({"q": clean}, seed, 1e-4), {"u": "N", "q": "m"}, name="late")
    found = discovered(record, ("sensor-delay", "input-delay"), plant)
    by_names = {s.names: s.probability for s in found.posterior}
    one, other = by_names[("sensor-delay",)], by_names[("input-delay",)]
    assert abs(np.log(one / other)) < 0.1
    assert [k.kind for k in found.kinds] == ["time-delay"]
    assert found.verdict == "named"
    (delay,) = found.kinds[0].values
    assert delay.value == pytest.approx(late * 5e-3, abs=3e-3)  # half a sample
    assert "a time delay of" in found.headline()


@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.slow)])
@pytest.mark.parametrize(
    ("pair", "gain", "bias", "apart", "kinds"),
    [
        (("input-gain", "sensor-gain"), 1.12, 0.0, 0.1, ["factor"]),
        (("constant-load", "sensor-bias"), 1.0, 2e-3, 0.3, []),
    ],
)
def test_gains_and_biases_of_one_path_are_equally_probable(seed, pair, gain, bias, apart, kinds):
    """A gain before a linear plant equals one after it; a bias of a spring's end is a load on it."""
    rng = np.random.default_rng(seed)
    plant, t, u = path(rng)
    clean = rl.simulate(plant, t, {"u": gain * u})["q"] + bias
    record = rl.Record(t, {"u": u}, noisy({"q": clean}, seed, 1e-4), {"u": "N", "q": "m"}, name="twins")
    found = discovered(record, pair, plant)
    by_names = {s.names: s.probability for s in found.posterior}
    assert abs(np.log(by_names[pair[:1]] / by_names[pair[1:]])) < apart
    assert [kind.kind for kind in found.kinds] == kinds
    assert found.verdict == ("named" if kinds else "ambiguous")
    if not kinds:
        (rival,) = found.rivals
        assert {rival.name, rival.instead_of} == set(pair)
        assert rival.distance < 3.0
        assert found.next_experiment is not None


# --- inconclusive answers --------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_set_that_fails_on_held_out_data_is_not_the_answer():
    """The held-out record has no friction."""
    found = discovered(machine(friction=20.0), ("coulomb-friction", "constant-load"), held_out=machine(seed=3))
    assert "coulomb-friction" not in found.names
    assert all("coulomb-friction" not in s.names for s in found.collection)


@pytest.mark.parametrize("budget", ["MOST_EXPANSIONS", "MOST_WORK"])
def test_a_search_beyond_its_budget_is_inconclusive(monkeypatch, budget):
    monkeypatch.setattr(f"robustlab.identification.missing_effects.effect_search.{budget}", 1)
    found = rl.discover(AXIS, machine(friction=20.0, seed=3), exclude=all_but("coulomb-friction", "constant-load"))
    assert "search" in [f.kind for f in found.findings]
    assert found.verdict == "ambiguous"
    assert "coulomb-friction" in found.names


class StopAfter:
    """Listener that stops the search at the given number of reports."""

    def __init__(self, count):
        self.left = count

    def __call__(self, text):
        """Ignore the texts."""

    def part(self, done, expected, text):
        self.left -= 1
        if not self.left:
            raise KeyboardInterrupt


@pytest.mark.parametrize("after", [1, 25])
def test_an_interrupted_search_is_reported_and_inconclusive(after):
    few = all_but("coulomb-friction", "constant-load", "sensor-delay", "input-delay")
    found = rl.discover(AXIS, machine(friction=20.0, seed=3), exclude=few, progress=StopAfter(after))
    assert "interrupted" in [f.kind for f in found.findings]
    assert found.verdict != "named"
    assert found.status is rl.Status.INCONCLUSIVE


def test_a_failed_stage_after_the_search_keeps_the_effects(monkeypatch):
    def fails(*_):
        raise NoTrustworthyNumber("the model", "u[552,1] is infinite", "a number")

    monkeypatch.setattr("robustlab.identification.missing_effects.build_result.updated_plant", fails)
    found = rl.discover(AXIS, machine(friction=20.0, seed=3), exclude=all_but("coulomb-friction"))
    assert found.names == ("coulomb-friction",)
    assert any("not computed" in f.found for f in found.findings if f.kind == "stage")
    assert found.model is None


def test_a_ripple_over_time_makes_the_answer_incomplete():
    """A force of 50 Hz and 1 % of the motor's force, without a candidate effect."""
    t = np.arange(4000) * 1e-3
    u = 1.5 * np.sin(2 * np.pi * 1.3 * t) + np.repeat(np.random.default_rng(1).choice([-1.0, 1.0], 40), 100)
    run = rl.simulate(AXIS, t, u + 0.05 * np.sin(2 * np.pi * 50.0 * (t + 5e-4)))
    record = rl.Record(t, {"u": u}, noisy({"v": run["v"]}, 0, 1e-4), name="hum")
    found = discovered(record, ("coulomb-friction", "constant-load", "sensor-delay", "input-delay"))
    assert (found.verdict, found.complete) == ("unknown", False)
    line = found.remaining_lines[0]
    assert line["over"] == "time"
    assert line["period"] == pytest.approx(0.02, rel=0.01)


# --- records of all kinds --------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_records_are_fitted_together_and_evaluated_on_others():
    other = machine(friction=20.0, seed=9, sign=-1.0)
    one, both = (
        discovered(machine(friction=20.0)),
        rl.discover(AXIS, [machine(friction=20.0), other], exclude=all_but("coulomb-friction", "constant-load")),
    )
    assert both.names == ("coulomb-friction",)
    assert both.records == ("run 0", "run 9")
    width = [np.subtract(*(getattr(f.effects[0].parameters[0], e) for e in ("upper", "lower"))) for f in (one, both)]
    assert width[1] < width[0]
    judged = discovered(machine(friction=20.0), held_out=other)
    assert (judged.names, judged.held_out) == (("coulomb-friction",), "run 9")
    assert judged.gaps["q"].range == pytest.approx(np.ptp(other["q"]))


@pytest.mark.slow
def test_a_state_space_model_is_accepted_as_plant():
    m = AXIS.state_space()
    model = rl.StateSpaceModel(m.A, m.B, m.C, m.D, inputs=AXIS.inputs, outputs=AXIS.outputs, states=AXIS.states)
    found = discovered(machine(friction=20.0), plant=model)
    assert found.names == ("coulomb-friction",)
    value = found.effects[0].parameters[0]
    assert value.unit == "N/kg"
    assert value.value == pytest.approx(20.0 / AXIS.values["M"], rel=0.02)


def with_gaps():
    run = machine(friction=20.0)
    return rl.Record(run.t[LOST], {"u": run["u"][LOST]}, {k: run[k][LOST] for k in ("q", "v")}, name="gappy")


def one_sensor():
    return rl.Record(T, {"u": U}, {"q": machine(friction=20.0)["q"]}, name="one sensor")


@pytest.mark.slow
@pytest.mark.parametrize(("record", "options"), [(with_gaps, {"window": 0.16}), (one_sensor, {})])
def test_gaps_and_missing_sensors_are_accepted(record, options):
    found = discovered(record(), **options)
    assert found.names == ("coulomb-friction",)
    assert found.effects[0].parameters[0].value == pytest.approx(20.0, rel=0.03)
    assert set(found.gaps) == set(record().outputs)


@cache
def oscillation(kind):
    """Simulate a lightly damped oscillator by DOP853; its force held over each sample, smooth, or smooth and late."""
    dt, count = 2 * np.pi / 20.0 / 9, 1200
    rng = np.random.default_rng(4)
    omega, phase = rng.uniform(1.0, 40.0, 12), rng.uniform(0.0, 2 * np.pi, 12)

    def drive(t):
        return 20.0 * np.sin(np.multiply.outer(t, omega) + phase).sum(axis=-1) / 12

    t = dt * np.arange(count)
    sampled, late = drive(t), 0.3 * dt if kind == "late" else 0.0
    q, x = np.zeros(count), np.zeros(2)
    for k in range(count - 1):
        q[k] = x[0]
        force = (lambda now, k=k: sampled[k]) if kind == "held" else (lambda now: drive(now - late))
        rate = lambda t, x, force=force: [x[1], force(t) - 0.4 * x[1] - 400.0 * x[0]]  # noqa: E731
        x = solve_ivp(rate, (t[k], t[k + 1]), x, method="DOP853", rtol=1e-10, atol=1e-13).y[:, -1]
    q[-1] = x[0]
    q = q + 2e-4 * np.ptp(q) * np.random.default_rng(7).normal(size=count)
    return rl.Record(t, {"f": sampled}, {"q": q}, {"f": "N", "q": "m"}, kind)


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "hold", "shift"), [("held", "held", 0.0), ("smooth", "smooth", 0.0),
                                                     ("late", "smooth", 0.3)])  # fmt: skip
def test_hold_and_time_shift_of_an_input_are_found(kind, hold, shift):
    plant = rl.plant("mass-spring-damper", m=1.0, c=0.4, k=400.0)
    few = all_but("coulomb-friction", "constant-load")
    found = rl.discover(plant, oscillation(kind), exclude=few, tolerances={"m": 0.05, "c": 0.5, "k": 0.05})
    assert found.verdict == "no missing effect"  # the residual is estimated under the same clock
    (clock,) = found.clocks
    assert (clock.input, clock.hold) == ("f", hold)
    dt = float(oscillation(kind).dt)
    assert 0.0 < clock.std < 0.1 * dt
    assert clock.shift == pytest.approx(shift * dt, abs=max(5 * clock.std, 0.02 * dt))


# --- errors and the updated plant ------------------------------------------------------------------------------------


def stepped(x0, u):
    """Simulate q and v of the axis with a held input, by scipy."""
    p = AXIS.values
    a, b = np.array([[0.0, 1.0], [0.0, -p["Fv"] / p["M"]]]), np.array([[0.0], [p["gain"] / p["M"]]])
    a_d, b_d, *_ = cont2discrete((a, b, np.eye(2), np.zeros((2, 1))), DT)
    x = np.empty((len(u), 2))
    x[0] = x0
    for k in range(len(u) - 1):
        x[k + 1] = a_d @ x[k] + b_d[:, 0] * u[k]
    return x


def test_free_runs_are_simulations_of_whole_records(tmp_path):
    found = discovered(machine(mass=1.25, seed=4), ("inertia",))
    run = found.series["free_run"]
    measured, given, updated = (
        np.column_stack([run["outputs"][name][key] for name in "qv"]) for key in ("measured", "nominal", "updated")
    )
    u = U[np.searchsorted(T, run["t"] - 1e-9)]
    expected = stepped(given[0], u)
    assert given == pytest.approx(expected, rel=1e-6, abs=1e-9)
    for j, name in enumerate("qv"):
        rms = np.sqrt(np.mean((measured[:, j] - expected[:, j]) ** 2))
        assert found.free_run[name].nominal == pytest.approx(rms, rel=1e-6)
        assert found.free_run[name].nominal > 10 * found.free_run[name].updated
        assert found.gaps[name].updated < 1.2e-3 * found.gaps[name].range
    assert found.free_run["q"].nominal > found.gaps["q"].nominal
    # The updated plant has the fitted value, two standard deviations as tolerance, and the same response from a file.
    mass, row = found.model.parameters["M"], next(p for p in found.nominal if p.name == "M")
    assert mass.value == pytest.approx(1.25 * AXIS.values["M"], rel=5e-3)
    assert mass.value == pytest.approx(row.value)
    assert mass.tolerance == pytest.approx((row.upper - row.lower) / 1.96 / row.value, rel=0.05)
    assert found.model.parameters["gain"] == AXIS.parameters["gain"]  # fixed
    rl.save(tmp_path / "axis.h5", found.model)
    again = rl.load(tmp_path / "axis.h5")
    one, other = (rl.simulate(m, run["t"], u, updated[0]) for m in (found.model, again))
    for j, name in enumerate("qv"):
        assert (one[name] == other[name]).all()
        assert one[name] == pytest.approx(updated[:, j], abs=2e-3 * np.ptp(updated[:, j]))


# --- errors of the user ----------------------------------------------------------------------------------------------


def plain():
    return machine(seed=3)


def with_holes():
    """Return a record without ten of every eighty samples."""
    run, kept = machine(friction=20.0), np.arange(N) % 80 < 70
    return rl.Record(run.t[kept], {"u": run["u"][kept]}, {"q": run["q"][kept]}, {"u": "V", "q": "m"}, "holes")


def only(inputs, outputs, n=N):
    return rl.Record(T[:n], {k: x[:n] for k, x in inputs.items()}, {k: x[:n] for k, x in outputs.items()}, name="run 8")


@pytest.mark.parametrize(
    ("plant", "records", "options", "message"),
    [
        (AXIS, list, {}, r"discover.*no record.*at least one"),
        (AXIS, with_holes, {}, r"holes.*windows of \d+ samples without gaps.*at least 4"),
        (rl.with_effects(rl.plant("dc-motor"), {"coulomb-friction": {"Fc": 5e-3}}), plain, {},
         r"discover.*dc-motor with effects(?s:.*)give its plant"),
        (rl.StateSpaceModel([[0.5]], [[1.0]], [[1.0]], [[0.0]], dt=DT), plain, {}, r"discover.*discrete"),
        ("servo-axis", plain, {}, None),
        (AXIS, lambda: only({"voltage": U}, {"q": T}), {}, r"run 8.*'u'"),
        (AXIS, lambda: only({"u": U}, {"x": T}), {}, "run 8"),
        (AXIS, lambda: only({"u": U}, {"q": plain()["q"]}, 30), {}, "run 8"),
        (AXIS, plain, {"window": 0.6}, r"run 3.*1000 samples.*at least 1200 \(4 windows\)"),
        *((AXIS, plain, {"window": w}, r"discover: window.*length in s above 0") for w in (0.0, -1.0, np.nan, np.inf)),
        (AXIS, plain, {"tolerances": {"Mx": 0.1}}, r"'Mx'.*no such parameter of servo-axis"),
        (AXIS, plain, {"exclude": ["coulom-friction"]}, r"coulom-friction.*coulomb-friction"),
        (AXIS, lambda: only({"u": 0 * U}, {"q": 1e-6 * np.random.default_rng(1).normal(size=N)}), {}, "run 8"),
    ],
)  # fmt: skip
def test_unsuitable_input_is_an_error(plant, records, options, message):
    with pytest.raises((InputError, NoTrustworthyNumber), match=message):
        rl.discover(plant, records(), **options)
