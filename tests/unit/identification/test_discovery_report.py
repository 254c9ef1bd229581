"""Text, figures, page and numbers of a discovery, from results written by hand."""

from __future__ import annotations

import json
import math
from dataclasses import replace

import numpy as np
import pytest

import robustlab as rl
from robustlab.cli.data import _fill_folder
from robustlab.identification import Discovery
from robustlab.identification.experiment import NextExperiment, Pair, Tried
from robustlab.identification.naming.discovery_numbers import numbers_of
from robustlab.identification.naming.named_effects import (
    EffectValue,
    Gap,
    InputClock,
    NamedEffect,
    NominalValue,
    Rival,
    SearchEntry,
    SetProbability,
    overall,
    wave_amplitude,
)
from robustlab.identification.naming.residual_force import ForceCurve, ResidualForce
from robustlab.identification.record_check import Finding
from robustlab.provenance import Provenance
from robustlab.recipe.schema import Requirement, judge
from robustlab.report.discovery import discovery_figures, write_page
from robustlab.result import Status, plain

FC = EffectValue("Fc", 20.39, "N", 20.31, 20.47, "friction level")
COULOMB = NamedEffect("coulomb-friction", "Coulomb (dry) friction", "f = -Fc sgn(v)", "v", (FC,), 0.985, 512.0, ())
RIVAL = Rival("presliding", "Presliding", "v", "coulomb-friction", 1.4, -0.7, 0.21, (replace(FC, name="Fb"),))
WINDOWS, LENGTH, DT = 5, 40, 0.01


def sentence(d):
    return f"{d.headline()}."


def series():
    """Five windows of 40 samples, and a free run in which each model drifts away."""
    t, run = DT * np.arange(WINDOWS * LENGTH), DT * np.arange(400)
    y, true = np.sin(3.0 * t), np.sin(3.0 * run)
    windows = {"measured": y, "nominal": y + 0.02, "refitted": y + 0.01, "updated": y + 1e-3 * np.cos(90 * t)}
    free = {
        key: true + d * run for key, d in (("measured", 0.0), ("nominal", 0.2), ("refitted", 0.1), ("updated", 0.01))
    }
    free_run = {"t": run, "record": "test", "inputs": {"u": 0 * run}, "outputs": {"q": free}}
    return {"t": t, "inputs": {"u": 0 * t}, "outputs": {"q": windows}, "free_run": free_run}


def made(**changes):
    mass = NominalValue("M", 95.1, 96.0, "kg", 95.7, 96.3, 0.05, True)
    gain = NominalValue("gain", 35.15, 35.15, "N/V", 35.15, 35.15, 0.0, False)
    best = SetProbability(("coulomb-friction@v",), ("coulomb-friction",), 0.985, 0.0, 0.0)
    other = SetProbability(("presliding@v",), ("presliding",), 0.015, -4.2, 1.4)
    found = Discovery(
        status=Status.CONVERGED, verdict="named", complete=True, effects=(COULOMB,), rivals=(), nominal=(mass, gain),
        gap_before=3.0, gap_refitted=0.9, gap_after=0.1, gaps={"q": Gap("q", "m", 2.0, 0.06, 0.018, 0.002)},
        held_out="test", plant="servo-axis", records=("train",), window=LENGTH * DT,
        search=(SearchEntry((), -512.0, "start"), SearchEntry(("coulomb-friction@v",), 0.0, "best")),
        posterior=(best, other), clocks=(InputClock("u", "held", 0.4e-3, 0.02e-3),),
        free_run={"q": Gap("q", "m", 2.0, 0.5, 0.2, 0.01)}, free_run_on="test",
        candidates=("coulomb-friction", "presliding", "backlash"), structure={}, series=series(), seconds=12.0,
    )  # fmt: skip
    return replace(found, **changes)


def ambiguous(**changes):
    effects = (replace(COULOMB, confidence=0.6, rivals=("presliding",)),)
    sets = (("coulomb-friction", 0.6, 0.0), ("presliding", 0.38, 1.4), ("cogging", 0.02, 5.0))
    posterior = tuple(SetProbability((f"{name}@v",), (name,), p, math.log(p / 0.6), d) for name, p, d in sets)
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


def experiment():
    t = np.arange(5) * 0.1
    tried = (Tried("slow ramp", ("q",), 0.5, 12.0, True),)
    pairs = (Pair("coulomb-friction", "presliding", 12.0),)
    return NextExperiment(
        "slow ramp", "ramp u slowly through zero", "measure the breakaway force", t, {"u": t}, {"u": "V"}, 0.5, ("q",),
        (), {}, 12.0, 12.0, 1.4, ("coulomb-friction", "presliding"), pairs, tried,
    )  # fmt: skip


# --- text ------------------------------------------------------------------------------------------------------------


def test_the_first_line_is_the_verdict_in_a_sentence():
    assert sentence(made()) == (
        "servo-axis lacks Coulomb (dry) friction: error on held-out data 3 % of the range as given, 0.9 % refitted, "
        "0.1 % with it; in free run 25 % -> 10 % -> 0.5 %."
    )
    assert "cannot tell which" in sentence(ambiguous())
    unsettled = made(verdict="ambiguous", status=Status.INCONCLUSIVE)
    assert "lacks Coulomb (dry) friction, as far as the search came before its work was used up" in sentence(unsettled)
    no_nearer = made(verdict="ambiguous", status=Status.INCONCLUSIVE, gap_refitted=0.09)
    assert "may lack Coulomb (dry) friction, which is on held-out data no nearer than the refitted" in sentence(
        no_nearer
    )
    assert "either Coulomb (dry) friction or presliding (elastic dry friction): these" in sentence(ambiguous())
    assert sentence(unknown()).startswith("servo-axis lacks something that no effect of the catalogue explains")
    beyond = sentence(unknown(effects=(COULOMB,)))
    assert beyond.startswith("servo-axis lacks something beyond Coulomb (dry) friction that no effect")
    none = sentence(made(verdict="no missing effect", effects=(), gap_after=0.9))
    assert none.startswith("servo-axis lacks no effect that these records show")
    assert sentence(made(complete=False)).endswith("; incomplete: something else remains.")


def test_the_facts_have_verdict_names_gaps_and_what_to_do():
    facts = dict(made().facts())
    found = facts["Coulomb (dry) friction, coulomb-friction at v"]
    assert found == "probability 98.5 %; Fc = 20.39 N (95 %: 20.31 to 20.47)"
    sizes = "rms 0.06 m (3 %) -> 0.018 m (0.9 %) -> 0.002 m (0.1 %)"
    assert facts["q: windows of 0.4 s"].startswith(f"{sizes}; 30 times smaller than the given model")
    assert facts["q: free run"].startswith("rms 0.5 m (25 %) -> 0.2 m (10 %) -> 0.01 m (0.5 %); 50 times smaller")
    assert facts["next"] == "use the updated plant (.model)"
    assert "f = -Fc" not in made().summary()
    assert "f = -Fc" in made().report()


def test_what_is_periodic_is_told_by_amplitude_and_period():
    values = {"Ac": (3.0, "N m"), "As": (-4.0, "N m"), "k": (7.0, "1/rad")}
    parts = tuple(EffectValue(name, x, unit, x - 0.1, x + 0.1, "") for name, (x, unit) in values.items())
    ripple = NamedEffect("cogging", "Cogging", "f = ...", "omega", parts, 1.0, 9.0, ())
    d = made(effects=(ripple,), candidates=("cogging", "coulomb-friction"))
    assert "amplitude 5 N m, period 0.8976 rad, 7 a turn" in d.summary()
    assert numbers_of(d)["effects"]["cogging"]["amplitude"] == pytest.approx(5.0)
    assert "amplitude" not in numbers_of(made())["effects"]["coulomb-friction"]
    assert numbers_of(made(candidates=("cogging",)))["effects"]["cogging"]["amplitude"] == 0.0
    assert wave_amplitude({"Fc": 1.0}) is None


def test_what_diverges_is_told_as_such():
    gap = Gap("q", "m", 2.0, math.inf, math.inf, 0.01)
    found = made(free_run={"q": gap})
    assert (
        "diverges -> diverges -> 0.01 m (0.5 %); finite, unlike the given model" in dict(found.facts())["q: free run"]
    )
    assert "in free run diverges -> diverges -> 0.5 %" in found.headline()
    assert overall({"q": gap}, "updated") == pytest.approx(0.5)
    assert overall({"q": gap, "v": replace(gap, updated=0.02)}, "updated") == pytest.approx(math.sqrt(0.625))
    assert json.dumps(plain(made(free_run={"q": gap}).to_json()), allow_nan=False)


def test_an_interrupted_search_says_so_first():
    stopped = Finding("interrupted", "search", "stopped after 3 sets", "", "", False, {})
    found = made(status=Status.INCONCLUSIVE, findings=(stopped,))
    assert found.interrupted
    assert found.headline().startswith("Interrupted; by then: servo-axis lacks Coulomb")
    assert not made().interrupted


def test_the_next_experiment_is_told_and_kept(tmp_path):
    d = ambiguous(next_experiment=experiment())
    assert dict(d.facts())["next"] == "measure what tells them apart: ramp u slowly through zero"
    assert "predicted separation" in d.report()
    assert numbers_of(d)["next_experiment"] == {"name": "slow ramp", "separation": 12.0}
    assert numbers_of(made())["next_experiment"]["name"] == "none"
    files = _fill_folder(d, {"model": "servo-axis", **d.to_json()}, tmp_path, Provenance.now("test"))
    assert str(tmp_path / "next-experiment.csv") in files
    assert json.loads((tmp_path / "result.json").read_text(encoding="utf-8"))["next_experiment"]["separation"] == 12.0
    back = rl.load(rl.save(tmp_path / "evidence.h5", d)).data
    assert back["next_experiment"]["inputs"]["u"] == pytest.approx(d.next_experiment.inputs["u"])


# --- figures and page ------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize(
    ("d", "tone", "mark"), [(made(), "good", "✓"), (ambiguous(), "warn", "?"), (unknown(), "warn", "?")]
)
def test_the_page_states_the_verdict_first(tmp_path, d, tone, mark):
    files = write_page(d, tmp_path, Provenance.now("data discover"))
    page = files[-1].read_text(encoding="utf-8")
    head = page.index(f'class="verdict {tone}"')
    assert head < page.index("servo-axis against train")
    assert page[head:].split("\n")[0].startswith(f'class="verdict {tone}" role="status">{mark} servo-axis lacks')
    assert page.count("data:image/svg+xml") == len(discovery_figures(d))
    assert "Recipe (SHA-256)" not in page
    assert "This recipe states" not in page


def test_a_hostile_name_cannot_leave_its_place(tmp_path):
    d = made(plant="<script>alert(1)</script>", records=("\u202eevil",))
    page = write_page(d, tmp_path, Provenance.now("data discover"))[-1].read_text(encoding="utf-8")
    assert "<script>" not in page
    assert "\u202e" not in page


# --- numbers for requirements ----------------------------------------------------------------------------------------


def met(d, **condition):
    return judge(Requirement(text="t", **condition), {"naming": plain(numbers_of(d))}, {}).met


def test_requirements_may_address_names_and_numbers():
    d = made()
    assert met(d, that="naming.verdict", equals="named")
    assert not met(ambiguous(), that="naming.verdict", equals="named")
    assert met(d, that="naming.names", contains="coulomb-friction")
    assert not met(d, that="naming.names", contains="presliding")
    assert met(ambiguous(), that="naming.answer", contains="presliding")
    assert met(d, that="naming.count", equals=1)
    assert met(d, that="naming.complete", equals=True)
    assert met(d, that="naming.effects.coulomb-friction.Fc", equals=20.39, tolerance=0.01)
    assert met(d, that="naming.lower.coulomb-friction.Fc", at_least=20.0)
    assert met(d, that="naming.confidence.coulomb-friction", at_least=0.9)
    assert met(d, that="naming.gap_ratio", within=[29.9, 30.1])
    assert met(d, that="naming.refitted_ratio", within=[8.9, 9.1])
    assert met(d, that="naming.gaps.q.updated", at_most=0.002)
    assert met(d, that="naming.nominal.M", equals=96.0)


def test_a_requirement_on_an_effect_that_was_not_named_is_not_met():
    d = made()
    assert not met(d, that="naming.effects.backlash.gap", at_least=0.0)
    assert not met(d, that="naming.effects.backlash.gap", at_most=1.0)
    assert met(d, that="naming.confidence.backlash", at_most=0.0)
    mistyped = Requirement(text="t", that="naming.effects.coulomb-frction.Fc", at_least=0.0)
    found = judge(mistyped, {"naming": plain(numbers_of(d))}, {})
    assert (found.met, found.misstated) == (False, True)
    assert "did you mean coulomb-friction" in found.why_not
