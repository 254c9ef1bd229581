"""Text, figures, page and numbers of a discovery, from results written by hand."""

from __future__ import annotations

import json
import math
from dataclasses import replace

import numpy as np
import pytest

import robustlab as rl
from robustlab.cli.data import DiscoveryFiles
from robustlab.identification.experiment.next_experiment import NextExperiment, Pair, Tried
from robustlab.identification.naming.discovery_result import (
    Discovery,
    EffectValue,
    Gap,
    NamedEffect,
    NamingStep,
    NominalValue,
    Rival,
    StepEntry,
)
from robustlab.identification.naming.discovery_text import compared, headline, with_interval
from robustlab.identification.record_check.suitability import Finding
from robustlab.identification.unnamed.unnamed_effect import ForceCurve, ForceTable, ResidualForce, UnnamedForce
from robustlab.provenance import Provenance
from robustlab.recipe.requirements import judge
from robustlab.recipe.schema import Requirement
from robustlab.recipe.steps.discovery import numbers
from robustlab.report.discovery_figures import discovery_figures, stretch_figure
from robustlab.report.discovery_page import caption, facts, write_page
from robustlab.result import Status, plain

FC = EffectValue("Fc", 20.39, "N", 20.31, 20.47, "friction level")
COULOMB = NamedEffect("coulomb-friction", "Coulomb (dry) friction", "f = -Fc sgn(v)", "v", (FC,), 0.97, 512.0, ())
RIVAL = Rival("presliding", "Presliding", "v", "coulomb-friction", 1.4, -0.7, 0.21, (replace(FC, name="Fb"),))
WINDOWS, LENGTH, DT = 5, 40, 0.01


def series(apart: int):
    """Windows of 40 samples; ``apart`` of such a length from start to start."""
    t = np.concatenate([(apart * k * LENGTH + np.arange(LENGTH)) * DT for k in range(WINDOWS)])
    y = np.sin(3.0 * t)
    worst = np.repeat(np.arange(WINDOWS) == 3, LENGTH)
    signals = {
        "measured": y,
        "nominal": y + 0.02 + 0.1 * worst,
        "refitted": y + 0.01,
        "updated": y + 1e-3 * np.cos(90 * t),
    }
    return {"t": t, "inputs": {"u": 0 * t}, "outputs": {"q": signals}}


def made(**changes):
    steps = (
        NamingStep(
            (),
            (StepEntry("coulomb-friction", "v", 0.0, 0.97), StepEntry("none", "", -512.0, 0.0)),
            "coulomb-friction: held-out error 2 % -> 0.1 % of the range",
            0.1,
        ),
        NamingStep(
            ("coulomb-friction",), (StepEntry("none", "", 0.0, 1.0),), "stop: nothing is more probable", math.nan
        ),
    )
    fields = {
        "status": Status.CONVERGED,
        "verdict": "named",
        "complete": True,
        "effects": (COULOMB,),
        "rivals": (),
        "nominal": (
            NominalValue("M", 95.1, 96.0, "kg", 95.7, 96.3, 0.05, True),
            NominalValue("gain", 35.15, 35.15, "N/V", 35.15, 35.15, 0.0, False),
        ),
        "gap_before": 3.0,
        "gap_refitted": 0.9,
        "gap_after": 0.1,
        "gaps": {"q": Gap("q", "m", 2.0, 0.06, 0.018, 0.002)},
        "held_out": "test",
        "plant": "servo-axis",
        "records": ("train",),
        "window": LENGTH * DT,
        "steps": steps,
        "candidates": ("coulomb-friction", "presliding", "backlash"),
        "structure": {},
        "series": series(1),
        "seconds": 12.0,
    }
    return Discovery(**{**fields, **changes})


def ambiguous(**changes):
    effects = (replace(COULOMB, rivals=("presliding",)),)
    fields = {"status": Status.INCONCLUSIVE, "verdict": "ambiguous", "effects": effects, "rivals": (RIVAL,)}
    return made(**{**fields, **changes})


def unknown(**changes):
    x = np.linspace(-1.0, 1.0, 9)
    curves = {
        name: ForceCurve(name, unit, x, x**3, x**3 - 0.1, x**3 + 0.1, np.full(9, 40), share, 0.01)
        for name, unit, share in (("speed", "m/s", 0.4), ("position", "m", 0.0), ("time", "s", 0.1))
    }
    force = ResidualForce("N", 2.5, 0.1, curves, {}, 0.5, 16)
    fields = {
        "status": Status.INCONCLUSIVE,
        "verdict": "unknown",
        "complete": False,
        "effects": (),
        "residual_force": force,
        "unnamed": UnnamedForce("unnamed", "N", 0.0, (ForceTable("speed", "speed", x, x**3),), "speed", 0.38),
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


def hidden():
    """Nothing named, but a wrong friction that tolerances may hide."""
    rival = replace(RIVAL, name="viscous-friction", title="Viscous friction, misjudged or missing", instead_of="none")
    return made(verdict="no missing effect", effects=(), rivals=(rival,))


def test_what_tolerances_may_hide_is_told_beside_no_missing_effect():
    found = hidden()
    assert found.names == ()
    assert found.answer == ("viscous-friction",)
    assert headline(found).endswith("but they do not exclude viscous friction, misjudged or missing.")
    line = next(x for x in found.summary().splitlines() if "not excluded" in x)
    assert "viscous-friction at v" in line
    assert "20.31 to 20.47" in line
    assert "not excluded" not in made(verdict="no missing effect", effects=()).summary()
    assert any(label.startswith("Not excluded: Viscous") for label, _, _ in facts(found))


# --- text ------------------------------------------------------------------------------------------------------------


def test_the_first_line_is_the_verdict_in_a_sentence():
    assert made().summary().splitlines()[0] == (
        "servo-axis lacks Coulomb (dry) friction: error on held-out data 3 % -> 0.1 % of the range."
    )
    assert "cannot tell which" in headline(ambiguous())
    assert "Coulomb (dry) friction or presliding" in headline(ambiguous())
    assert headline(unknown()).startswith("servo-axis lacks something that no effect of the catalogue explains")
    beyond = headline(unknown(effects=(COULOMB,)))
    assert beyond.startswith("servo-axis lacks something beyond Coulomb (dry) friction that no effect")
    none = headline(made(verdict="no missing effect", effects=(), gap_after=0.9))
    assert none.startswith("servo-axis lacks no effect that these records show")
    assert headline(made(complete=False)).endswith("; something else remains.")


def test_effects_gap_and_parameters_are_all_there():
    text = made().summary()
    for part in (
        "Coulomb (dry) friction, coulomb-friction at v",
        "f = -Fc sgn(v)",
        "20.39 N (95 %: 20.31 to 20.47)  friction level",
        "best in 97 % of the resampled windows",
        "these records exclude every other effect",
        "nominal 0.06 m (3 %), refitted 0.018 m (0.9 %), updated 0.002 m (0.1 %)",
        "30 times smaller than nominal, 9 times smaller than refitted",
        "windows of 0.4 s",
        "+0.946 %; tolerance 5 % assumed",
        "held fixed",
        "coulomb-friction 0, none -512",
        "stop: nothing is more probable",
    ):
        assert part in text
    assert "next experiment" not in text
    assert "findings" not in text


def test_rivals_say_how_far_apart_they_are():
    text = ambiguous().summary()
    assert "Presliding, presliding at v (Fb 20.39 N): 1.4 noise sigmas apart (3 tell)" in text
    assert "exclude every other" not in text


def test_the_next_experiment_is_told_and_kept(tmp_path):
    d = ambiguous(next_experiment=experiment())
    text = d.summary()
    assert "next experiment:\n  ramp u slowly through zero\n  predicted separation" in text
    assert numbers(d)["next_experiment"] == {"name": "slow ramp", "separation": 12.0}
    assert numbers(made())["next_experiment"]["name"] == "none"
    files = DiscoveryFiles(out=str(tmp_path)).write(d, {"model": "servo-axis", **d.to_json()}, [])
    assert str(tmp_path / "next-experiment.csv") in files
    assert json.loads((tmp_path / "result.json").read_text(encoding="utf-8"))["next_experiment"]["separation"] == 12.0
    back = rl.load(rl.save(tmp_path / "evidence.h5", d)).data
    assert back["next_experiment"]["inputs"]["u"] == pytest.approx(d.next_experiment.inputs["u"])


def test_what_remains_and_findings_are_said():
    finding = Finding("quantisation", "q", "steps of 5e-08 m", "", "", False, {})
    text = unknown(
        structure={"share": 0.41, "p_value": 0.002, "strongest": "f(speed)"},
        remaining_lines=({"period": 0.0025, "unit": "m"},),
        floor_excess={"q": 7.25},
        findings=(finding,),
    ).summary()
    assert "share 0.41, p_value 0.002, strongest f(speed)" in text
    assert "period 0.0025, unit m" in text
    assert "q: F 7.25" in text
    assert "q: steps of 5e-08 m" in text
    assert "incomplete: structure remains" in text
    assert "rms 2.5 N; 40 % follow speed, 0 % follow position, 10 % follow time" in text
    assert "speed in speed removes 38 % of the held-out variance" in text


@pytest.mark.parametrize(
    ("before", "after", "words"),
    [
        (3.0, 0.1, "30 times smaller than nominal"),
        (1.0, 4.0, "4 times larger than nominal"),
        (1.0, 1.0, "as large as nominal"),
        (5.0, 1e-3, "5000 times smaller than nominal"),
        (1.0, 0.0, "zero, unlike nominal"),
        (0.0, 1.0, "not zero, unlike nominal"),
        (0.0, 0.0, "as large as nominal"),
        (math.nan, 1.0, "not comparable with nominal"),
        (1.0, math.inf, "not comparable with nominal"),
    ],
)
def test_comparisons_in_words(before, after, words):
    assert compared(before, after, "nominal") == words


def test_an_interval_shows_the_digits_that_it_is_worth():
    assert (
        with_interval(EffectValue("x", 20.001234, "N", 20.0005, 20.0019, "")) == "20.0012 N (95 %: 20.0005 to 20.0019)"
    )
    assert with_interval(EffectValue("x", 1.5, "1", 1.0, 2.0, "")) == "1.5 (95 %: 1 to 2)"
    assert with_interval(EffectValue("x", 0.0, "N", -1.0, 1.0, "")) == "0 N (95 %: -1 to 1)"
    assert with_interval(EffectValue("x", 2.0, "N", -math.inf, math.inf, "")) == "2 N (95 %: -inf to inf)"


# --- figures and page ------------------------------------------------------------------------------------------------


def curve(axes, label):
    return next(line for line in axes.get_lines() if line.get_label() == label)


def test_the_story_shows_the_three_errors_of_every_output():
    figures = discovery_figures(made())
    assert list(figures) == ["story", "stretch-q", "evidence"]
    bars, traces = figures["story"].axes
    assert [bar.get_width() for bar in bars.patches] == [0.06, 0.018, 0.002]
    assert "30 times smaller" in bars.get_title(loc="left")
    assert figures["story"].get_suptitle().startswith("servo-axis lacks Coulomb")
    for model, error in (("nominal", -0.02), ("refitted", -0.01)):
        assert np.nanmax(curve(traces, model).get_ydata()) == pytest.approx(error)


@pytest.mark.parametrize("apart", [1, 4])
def test_lines_break_between_windows_and_gaps_are_left_out(apart):
    d = made(series=series(apart))
    above, middle, below = stretch_figure(d, "q").axes
    x, y = curve(above, "record").get_data()
    assert np.isnan(y).sum() == 4  # one break after each of the four windows shown
    # The worst window (the fourth) is among them, and no window is stretched.
    assert np.nanmin(middle.get_lines()[0].get_ydata()) == pytest.approx(-0.12)
    steps = np.diff(x)
    assert np.nanmin(steps) == pytest.approx(DT)
    assert np.nanmax(steps) == pytest.approx(DT)
    span = np.nanmax(x) - np.nanmin(x)
    assert span < 4.3 * LENGTH * DT
    assert ("between them were fitted" in below.get_xlabel()) is (apart > 1)
    if apart > 1:
        ticks = below.xaxis.get_major_locator()()
        shown = [below.xaxis.get_major_formatter()(tick) for tick in ticks]
        assert shown == ["1.6", "3.2", "4.8", "6.4"]


def test_the_ladder_marks_what_was_named():
    panels = discovery_figures(made())["evidence"].axes
    names = [label.get_text() for label in panels[0].get_yticklabels()]
    assert names == ["coulomb-friction (v)", "nothing added"]
    dots = {line.get_ydata()[0]: line.get_color() for line in panels[0].get_lines() if line.get_marker() == "o"}
    assert dots == {0: "#0072B2", 1: "#666666"}
    assert "step 2 on top of coulomb-friction" in panels[1].get_title(loc="left")


def test_what_remains_is_drawn_over_every_coordinate():
    panels = discovery_figures(unknown())["force"].axes
    assert [panel.get_xlabel() for panel in panels[:3]] == ["speed [m/s]", "position [m]", "time [s]"]
    assert "force" not in discovery_figures(made())


def test_an_output_with_an_odd_name_gets_a_file_name_of_its_own():
    d = made()
    signals = {"../x$": d.series["outputs"]["q"]}
    odd = made(gaps={"../x$": d.gaps["q"]}, series={**d.series, "outputs": signals})
    assert list(discovery_figures(odd)) == ["story", "stretch-output1", "evidence"]
    assert all(caption(name) for name in discovery_figures(odd))


def test_missing_samples_do_not_stop_the_figures():
    d = made()
    signals = {name: values.copy() for name, values in d.series["outputs"]["q"].items()}
    signals["measured"][10:60] = np.nan
    assert discovery_figures(made(series={**d.series, "outputs": {"q": signals}}))


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
    return judge(Requirement(text="t", **condition), {"naming": plain(numbers(d))}, {}).met


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
    assert met(d, that="naming.gaps.q.updated", at_most=0.002)
    assert met(d, that="naming.nominal.M", equals=96.0)


def test_a_requirement_on_an_effect_that_was_not_named_is_not_met():
    from robustlab.errors import InputError

    d = made()
    assert not met(d, that="naming.effects.backlash.gap", at_least=0.0)
    assert not met(d, that="naming.effects.backlash.gap", at_most=1.0)
    assert met(d, that="naming.confidence.backlash", at_most=0.0)
    with pytest.raises(InputError, match="did you mean coulomb-friction"):
        met(d, that="naming.effects.coulomb-frction.Fc", at_least=0.0)


def test_two_effects_of_a_kind_are_told_apart_by_their_place():
    d = made(effects=(COULOMB, replace(COULOMB, site="w", parameters=(replace(FC, value=1.0),))))
    found = numbers(d)["effects"]
    assert (found["coulomb-friction"]["Fc"], found["coulomb-friction@w"]["Fc"]) == (20.39, 1.0)


def test_nothing_left_is_an_infinite_ratio():
    assert numbers(made(gap_after=0.0))["gap_ratio"] == math.inf
