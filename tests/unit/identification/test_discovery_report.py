"""Text and numbers of a discovery, from constructed results."""

import math
from dataclasses import replace

import numpy as np
import pytest

from robustlab import Status
from robustlab.identification import (
    Discovery,
    EffectValue,
    ForceCurve,
    Gap,
    InputClock,
    NamedEffect,
    NominalValue,
    ResidualForce,
    Rival,
    SetProbability,
)

FC = EffectValue("Fc", 20.39, "N", 20.31, 20.47)
COULOMB = NamedEffect("coulomb-friction", "Coulomb (dry) friction", "v", (FC,), 0.985, 512.0)
RIVAL = Rival("presliding", "Presliding", "v", (replace(FC, name="Fb"),), 0.21, -0.7, "coulomb-friction", 1.4)
WINDOWS, LENGTH, DT = 5, 40, 0.01


def sentence(d):
    return f"{d.headline()}."


def series():
    """Return five windows of 40 samples, and a free run in which each model drifts."""
    t, run = DT * np.arange(WINDOWS * LENGTH), DT * np.arange(400)
    y, true = np.sin(3.0 * t), np.sin(3.0 * run)
    windows = {"measured": y, "nominal": y + 0.02, "refitted": y + 0.01, "updated": y + 1e-3 * np.cos(90 * t)}
    free = {
        key: true + d * run for key, d in (("measured", 0.0), ("nominal", 0.2), ("refitted", 0.1), ("updated", 0.01))
    }
    free_run = {"t": run, "record": "test", "inputs": {"u": 0 * run}, "outputs": {"q": free}}
    return {"t": t, "inputs": {"u": 0 * t}, "outputs": {"q": windows}, "free_run": free_run}


def made(**changes):
    mass = NominalValue("M", 96.0, "kg", 95.7, 96.3, 95.1, 0.05, True, False)
    gain = NominalValue("gain", 35.15, "N/V", 35.15, 35.15, 35.15, 0.0, False, False)
    best = SetProbability(("coulomb-friction@v",), 0.985, 0.0, 0.0)
    other = SetProbability(("presliding@v",), 0.015, -4.2, 1.4)
    found = Discovery(
        status=Status.CONVERGED, verdict="named", complete=True, effects=(COULOMB,), rivals=(), nominal=(mass, gain),
        gap_before=3.0, gap_refitted=0.9, gap_after=0.1, gaps={"q": Gap("q", "m", 2.0, 0.06, 0.018, 0.002)},
        held_out="test", plant="servo-axis", records=("train",), window=LENGTH * DT,
        search=(((), -512.0), (("coulomb-friction@v",), 0.0)),
        posterior=(best, other), clocks=(InputClock("u", "held", 0.4e-3, 0.02e-3),),
        free_run={"q": Gap("q", "m", 2.0, 0.5, 0.2, 0.01)}, free_run_on="test",
        candidates=("coulomb-friction", "presliding", "backlash"), structure={}, series=series(), seconds=12.0,
    )  # fmt: skip
    return replace(found, **changes)


def ambiguous(**changes):
    effects = (replace(COULOMB, confidence=0.6),)
    sets = (("coulomb-friction", 0.6, 0.0), ("presliding", 0.38, 1.4), ("cogging", 0.02, 5.0))
    posterior = tuple(SetProbability((f"{name}@v",), p, math.log(p / 0.6), d) for name, p, d in sets)
    fields = {"status": Status.INCONCLUSIVE, "verdict": "ambiguous", "effects": effects, "rivals": (RIVAL,)}
    fields["posterior"] = posterior
    return made(**{**fields, **changes})


def unknown(**changes):
    x = np.linspace(-1.0, 1.0, 9)
    curves = {
        name: ForceCurve(name, unit, x, x**3, x**3 - 0.1, x**3 + 0.1, np.full(9, 40), share)
        for name, unit, share in (("speed", "m/s", 0.4), ("position", "m", 0.0), ("time", "s", 0.1))
    }
    force = ResidualForce("N", 2.5, 0.1, curves, 16)
    fields = {
        "status": Status.INCONCLUSIVE,
        "verdict": "unknown",
        "complete": False,
        "effects": (),
        "residual_force": force,
    }
    return made(**{**fields, **changes})


# --- text ------------------------------------------------------------------------------------------------------------


def test_the_first_line_is_the_verdict_in_a_sentence():
    assert sentence(made()) == (
        "servo-axis lacks Coulomb (dry) friction: error on held-out data 3 % of the range as given, 0.9 % refitted, "
        "0.1 % with it; in free run 25 % -> 10 % -> 0.5 %."
    )
    assert "cannot distinguish them" in sentence(ambiguous())
    unsettled = made(verdict="ambiguous", status=Status.INCONCLUSIVE)
    assert "may lack Coulomb (dry) friction, which is not sure" in sentence(unsettled)
    assert "either Coulomb (dry) friction or presliding (elastic dry friction): these" in sentence(ambiguous())
    assert sentence(unknown()).startswith("servo-axis lacks something that no effect of the catalogue explains")
    beyond = sentence(unknown(effects=(COULOMB,)))
    assert beyond.startswith("servo-axis lacks something beyond Coulomb (dry) friction that no effect")
    none = sentence(made(verdict="no missing effect", effects=(), gap_after=0.9))
    assert none.startswith("servo-axis lacks no effect that these records show")
    assert sentence(made(complete=False)).endswith("; incomplete: something else remains.")


def test_the_facts_have_verdict_effects_errors_and_next_step():
    facts = dict(made().facts())
    found = facts["Coulomb (dry) friction, coulomb-friction at v"]
    assert found == "probability 98.5 %; Fc = 20.39 N (95 %: 20.31 to 20.47)"
    assert facts["q: windows of 0.4 s"] == "rms 0.06 m (3 %) -> 0.018 m (0.9 %) -> 0.002 m (0.1 %)"
    assert facts["q: free run"] == "rms 0.5 m (25 %) -> 0.2 m (10 %) -> 0.01 m (0.5 %)"
    assert facts["next"] == "use the updated plant (.model)"
    assert "f = -Fc" not in made().summary()
    assert "f = -Fc" in made().report()


def test_periodic_effects_have_amplitude_and_period():
    values = {"Ac": (3.0, "N m"), "As": (-4.0, "N m"), "k": (7.0, "1/rad")}
    parts = tuple(EffectValue(name, x, unit, x - 0.1, x + 0.1) for name, (x, unit) in values.items())
    ripple = NamedEffect("cogging", "Cogging", "omega", parts, 1.0, 9.0)
    d = made(effects=(ripple,), candidates=("cogging", "coulomb-friction"))
    assert "amplitude 5 N m, period 0.8976 rad, 7 a turn" in d.summary()
    assert d.numbers()["effects"]["cogging"]["amplitude"] == pytest.approx(5.0)
    assert "amplitude" not in made().numbers()["effects"]["coulomb-friction"]
    assert made(candidates=("cogging",)).numbers()["effects"]["cogging"]["amplitude"] == 0.0


def test_divergence_is_reported():
    gap = Gap("q", "m", 2.0, math.inf, math.inf, 0.01)
    found = made(free_run={"q": gap})
    assert dict(found.facts())["q: free run"] == "rms diverges -> diverges -> 0.01 m (0.5 %)"
    assert "in free run diverges -> diverges -> 0.5 %" in found.headline()
    both = made(free_run={"q": gap, "v": replace(gap, updated=0.02)}).numbers()["free_run"]
    assert (both["before"], both["after"]) == (math.inf, pytest.approx(100 * math.sqrt((0.005**2 + 0.01**2) / 2)))


# --- numbers for requirements ----------------------------------------------------------------------------------------


def test_numbers_for_requirements():
    numbers = made().numbers()
    assert (numbers["verdict"], numbers["names"], numbers["count"]) == ("named", ["coulomb-friction"], 1)
    assert "presliding" in ambiguous().numbers()["answer"]
    assert numbers["effects"]["coulomb-friction"]["Fc"] == 20.39
    assert numbers["lower"]["coulomb-friction"]["Fc"] == 20.31
    assert (numbers["gap_ratio"], numbers["refitted_ratio"]) == (pytest.approx(30.0), pytest.approx(9.0))
    assert numbers["gaps"]["q"]["updated"] == 0.002
    assert numbers["nominal"]["M"] == 96.0
    # An evaluated effect that is not named has probability 0 and NaN parameters: no requirement on it is met.
    assert numbers["confidence"] == {"coulomb-friction": 0.985, "presliding": 0.0, "backlash": 0.0}
    assert math.isnan(numbers["effects"]["backlash"]["gap"])
