"""Every public object shows itself: repr, HTML, text, drawings, tables."""

from __future__ import annotations

import dataclasses
import inspect
import re
import typing
from html.parser import HTMLParser
from xml.etree import ElementTree as ET

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
import pytest
import shown_objects
from matplotlib.axes import Axes

import robustlab as rl
from robustlab.errors import DependencyMissing, InputError
from robustlab.files import record_source
from robustlab.report.drawings import DRAWINGS, _function, drawings_of
from robustlab.result import Evidence, Status
from robustlab.shown import LINES, Shown, bracket, in_words, listed, member, number
from robustlab.tables import Tabular

mpl.use("Agg")
HOSTILE = "<script>alert(1)</script> & \x1b[31m \u202e $x$"
NAMES = [*shown_objects.OBJECTS, "CampaignResult"]
# What is no result: settings, names, and blocks, whose repr is what one writes to make them.
PLAIN = {
    "Signal", "RealScalar", "ComplexScalar", "FullBlock", "ParameterRange", "PlantEquations", "Varying", "Nonlinearity",
}  # fmt: skip
# Nothing to draw: a few numbers.
NUMBERS = {
    "ClassicalMargins", "Conservatism", "CoprimeMargin", "DcMotor", "DelayGain",
    "DelayStability", "EffectGain", "H2Norm", "HinfNorm", "Influence",
    "IqcGain", "IqcStability", "LPVController", "LPVGain", "LPVModel", "LPVSynthesis", "LinearSolution", "NuGap",
    "Passivity", "PlantSamples", "Reduction", "Result", "Verified",
    "RiccatiSolution", "RobustGain", "TrackingProblem", "Trim", "WellPosedness", "Zeros",
    "Watch", "WatchedPiece",
}  # fmt: skip


def public_classes() -> set[type]:
    """The classes among the public names, and those that public functions return."""
    found = set()
    for name in rl.__all__:
        thing = getattr(rl, name)
        answers = [thing] if inspect.isclass(thing) else [typing.get_type_hints(thing).get("return")]
        for answer in answers:
            for part in (answer, *typing.get_args(answer)):
                if inspect.isclass(part) and part.__module__.startswith("robustlab") and not issubclass(
                    part, (BaseException, Status)
                ):  # fmt: skip
                    found.add(part)
    return {kind for kind in found if kind.__name__ not in PLAIN}


@pytest.fixture(autouse=True)
def nothing_is_shown(monkeypatch):
    def shown(*_args, **_options):
        raise AssertionError("plt.show was called")

    monkeypatch.setattr(plt, "show", shown)
    plt.close("all")
    yield
    plt.close("all")


@pytest.fixture(scope="module")
def make(tmp_path_factory):
    folder = str(tmp_path_factory.mktemp("campaign"))
    return lambda name: shown_objects.campaign(folder) if name == "CampaignResult" else shown_objects.made(name)


def test_every_public_result_is_among_the_examples_and_shows_itself(make):
    kinds = public_classes()
    assert len(kinds) > 45
    assert [kind.__name__ for kind in kinds if not issubclass(kind, Shown)] == []
    made = [type(make(name)) for name in NAMES]
    missing = {kind.__name__ for kind in kinds if not any(issubclass(one, kind) for one in made)}
    assert missing == {"FreeRun"}  # tests/dynamics/test_fmu.py has a unit for it


@pytest.mark.parametrize("name", NAMES)
def test_a_repr_is_short_and_says_the_status(name, make):
    shown = make(name)
    text = repr(shown)
    assert 1 <= len(text.splitlines()) <= LINES
    assert len(text) <= 600
    assert not text.endswith("\n")
    assert text.isprintable() or "\n" in text
    assert type(shown).__name__ in text or isinstance(shown, rl.Record)
    if isinstance(getattr(shown, "status", None), Status):
        assert f"({shown.status})" in text.splitlines()[0]


@pytest.mark.parametrize("name", NAMES)
def test_the_summary_is_plain_text_with_what_the_repr_cuts(name, make):
    shown = make(name)
    text = shown.summary()
    assert isinstance(text, str)
    assert text
    assert not text.endswith("\n")
    assert all(line.isprintable() for line in text.split("\n"))
    assert "array(" not in text
    assert "object at 0x" not in text
    for label, words in shown.facts():
        assert isinstance(label, str)
        assert isinstance(words, str)


class Balance(HTMLParser):
    """Which tags are open, and the text outside of them."""

    def __init__(self):
        super().__init__()
        self.open, self.seen = [], []

    def handle_starttag(self, tag, attrs):
        self.open.append(tag)
        self.seen.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag


def check_html(text):
    parser = Balance()
    parser.feed(text)
    parser.close()
    assert parser.open == []
    assert set(parser.seen) == {"table", "caption", "tbody", "tr", "th", "td"}
    return ET.fromstring(text)


@pytest.mark.parametrize("name", NAMES)
def test_the_notebook_gets_a_valid_table(name, make):
    shown = make(name)
    root = check_html(shown._repr_html_())
    assert root.find("caption").text.startswith(type(shown).__name__)
    assert len(root.find("tbody")) >= 1


def inside(thing, seen, depth=6):
    """Everything of ours that can be reached from an object by attributes, tables and lists."""
    if id(thing) in seen or depth == 0:
        return
    seen[id(thing)] = thing
    if type(thing).__module__.startswith("robustlab"):
        yield thing
        parts = list(getattr(thing, "__dict__", {}).values())
    elif isinstance(thing, dict):
        parts = list(thing.values())
    else:
        parts = list(thing)[:30] if isinstance(thing, (list, tuple)) else []
    for part in parts:
        yield from inside(part, seen, depth - 1)


@pytest.mark.parametrize("name", NAMES)
def test_what_stands_inside_of_a_result_is_short_too(name, make):
    found = list(inside(make(name), {}))
    long = {type(part).__name__ for part in found if len(repr(part)) > 600 or len(repr(part).splitlines()) > LINES}
    assert long == set()


def test_a_proof_says_what_is_proved(make):
    piece = make("Margin").proof[0]
    assert re.fullmatch(r"Piece\n  proved: mu <= [\d.]+ for [\d.]+ \.\. [\d.inf]+ rad/s", repr(piece))


def test_names_from_files_are_escaped():
    model = rl.StateSpaceModel([[-1.0]], [[1.0]], [[1.0]], [[0.0]], inputs=[(HOSTILE, "V")], states=[HOSTILE])
    text = model._repr_html_()
    check_html(text)
    assert "<script>" not in text
    assert "&lt;script&gt;" in text
    for shown in (text, model.summary(), repr(model)):
        assert "\x1b" not in shown
        assert "\u202e" not in shown
    (above, _) = model.plot("bode")
    assert "<script>" in above.get_title(loc="left")  # drawn as the text that it is
    above.figure.canvas.draw()


def test_many_signals_and_long_names_stay_short():
    n = 40
    names = [f"a very long name of a signal, number {k}" for k in range(n)]
    model = rl.StateSpaceModel([], [], [], np.eye(n), inputs=names, outputs=names)
    run = rl.Record([0.0, 1.0], {}, {name: [0.0, 1.0] for name in names}, name="r" * 500)
    for shown in (model, rl.UncertainModel(model, []), run, rl.plant("stewart-platform")):
        assert len(repr(shown)) <= 600
        assert len(repr(shown).splitlines()) <= LINES
    assert "and 34 more" in repr(model)


# --- drawings ---------------------------------------------------------------------------------------------------------


def test_the_table_of_drawings_names_functions_and_shown_classes(make):
    parents = {parent.__name__ for name in NAMES for parent in type(make(name)).__mro__}
    assert set(DRAWINGS) - parents == set()
    for kinds in DRAWINGS.values():
        for function in kinds.values():
            assert (_function(function).__doc__ or "").strip()


def test_whatever_has_more_than_numbers_can_be_drawn(make):
    assert {name for name in NAMES if not drawings_of(type(make(name)))} == NUMBERS
    for name in sorted(NUMBERS):
        with pytest.raises(InputError, match="nothing to draw"):
            make(name).plot()


PARENT = {"HinfSynthesis": "Synthesis", "WorstCaseDiskMargin": "DiskBounds"}  # one for each drawing that is inherited
CASES = [(name, kind) for name in NAMES for kind in DRAWINGS.get(PARENT.get(name, name), {})]


def panels_of(drawn):
    return [drawn] if isinstance(drawn, Axes) else list(drawn)


@pytest.mark.parametrize(("name", "kind"), CASES)
def test_a_drawing_returns_its_axes_with_labels_and_units(name, kind, make):
    other = shown_objects.OTHERS.get((name, kind))
    drawn = (other() if other else make(name)).plot(kind)
    panels = panels_of(drawn)
    assert panels
    assert isinstance(drawn, Axes) or drawn.shape == (len(panels),)
    assert plt.get_fignums() == [panels[0].figure.number]
    for panel in panels:
        assert panel.has_data()
        for word, unit in (("time", "s"), ("frequency", "rad/s|Hz"), ("speed", "m/s|rad/s"), ("phase", "degrees")):
            for label in (panel.get_xlabel(), panel.get_ylabel()):
                if label.startswith(word) and "[" not in label:
                    pytest.fail(f"{label!r} carries no unit ({unit})")
    assert any(panel.get_xlabel() for panel in panels)
    assert any(panel.get_ylabel() or panel.get_yticklabels() for panel in panels)


FIRST = [case for k, case in enumerate(CASES) if k == 0 or CASES[k - 1][0] != case[0]]


@pytest.mark.parametrize(("name", "kind"), FIRST)
def test_a_drawing_goes_into_given_axes(name, kind, make):
    figure, (left, right) = plt.subplots(1, 2, figsize=(12, 4))
    drawn = make(name).plot(kind, ax=right)
    panels = panels_of(drawn)
    assert plt.get_fignums() == [figure.number]
    if right in figure.axes:
        assert drawn is right
    else:  # several panels are in its place
        assert left in figure.axes
        (part,) = figure.subfigs
        assert set(panels) <= set(part.axes)
    figure.canvas.draw()
    assert all(panel.has_data() for panel in panels)


def test_the_axes_of_the_caller_keep_their_figure_free_of_our_legend(make):
    figure, axes = plt.subplots()
    assert make("Margin").plot(ax=axes) is axes
    assert figure.legends == []
    assert axes.get_legend() is not None


def test_axes_in_no_grid_hold_one_panel_only(make):
    figure = plt.figure()
    axes = figure.add_axes((0.1, 0.1, 0.8, 0.8))
    assert make("Margin").plot(ax=axes) is axes
    with pytest.raises(InputError, match="axes that are in no grid"):
        make("StateSpaceModel").plot("bode", ax=axes)


@pytest.mark.parametrize(
    ("ask", "text"),
    [
        (lambda g: g.plot("bodee"), r"StateSpaceModel\.plot: 'bodee', expected one of bode, step, sigma, pzmap"),
        (lambda g: g.plot("bode", omgea=[1.0]), r"option 'omgea', expected one of omega"),
        (lambda g: g.plot("bode", ax=3), "ax is a int, expected one matplotlib Axes"),
        (lambda g: g.plot("bode", omega=[1.0]), "at least two"),
        (lambda g: g.plot("bode", omega=[1.0, -1.0]), "positive"),
        (lambda g: (-1 * (g ** 0)).select(inputs=[]).plot("step"), "inputs and outputs"),
    ],
)  # fmt: skip
def test_what_cannot_be_drawn_is_said_in_one_line_and_leaves_no_figure(ask, text, make):
    with pytest.raises(InputError, match=text) as error:
        ask(make("StateSpaceModel"))
    assert "\n" not in error.value.line
    assert plt.get_fignums() == []


def test_what_has_no_data_for_a_drawing_says_so(make):
    for name, kind in shown_objects.OTHERS:
        with pytest.raises(InputError, match=f"plot\\('{kind}'\\)"):
            make(name).plot(kind)
        assert plt.get_fignums() == []


def test_the_drawn_delta_is_that_of_the_validation():
    found = shown_objects.validation_over_frequency()
    axes = found.plot("delta")
    curve, level = axes.lines
    assert curve.get_ydata() == pytest.approx(found.line_sizes[:, 0])
    assert level.get_ydata() == pytest.approx([found.upper] * 2)
    assert level.get_label() == f"gamma: {found.upper:.4g}"


def test_the_drawn_harmonics_are_those_of_the_test():
    comparison = shown_objects.periodic_comparison()
    axes = comparison.plot("harmonics")
    signal = comparison.nonlinearity.signals["q"]
    excited, even, odd = axes.lines[:3]
    by_hand = np.abs(np.fft.rfft(comparison.measured["q"][-512:]))  # one period: lines 1, 3, 5, skip 7, ...
    assert excited.get_xdata()[:4] == pytest.approx(np.array([1, 3, 5, 9]) / 5.12)
    assert len(excited.get_xdata()) == 30
    ratio = excited.get_ydata()[:4] / by_hand[[1, 3, 5, 9]]
    assert ratio == pytest.approx(ratio[0], rel=1e-3)
    assert len(even.get_xdata()) > 30
    assert np.max(odd.get_ydata()) > 100 * np.max(even.get_ydata())  # friction is odd
    assert axes.get_ylabel() == "amplitude [m]"
    assert "odd at least" in axes.get_title(loc="left")
    assert set(signal.kind.tolist()) == {0, 1, 2}


def test_a_channel_without_response_is_said_and_not_drawn(make):
    panels = make("GeneralizedPlant").plot("bode")
    (above,) = (p for p in panels if p.get_title(loc="left") == "n to x")
    assert [text.get_text() for text in above.texts] == ["no response"]
    below = panels[list(panels).index(above) + 3]
    assert all(np.isnan(line.get_ydata()).all() for line in below.lines)


def test_an_endless_disk_is_cut_and_says_so(make):
    axes = make("WorstCaseDiskMargin").plot("disk")
    assert axes.get_xlim() == (-60.0, 60.0)
    assert axes.get_xlabel() == "change of gain [dB], shown to 60 dB"
    assert make("DiskMargins").plot("disk").get_xlabel() == "change of gain [dB]"


def test_an_unknown_output_is_named(make):
    with pytest.raises(InputError, match="no such output, expected one of q"):
        make("Comparison").plot("time", output="p")
    assert plt.get_fignums() == []


def test_the_drawn_numbers_are_those_of_the_model(make):
    model = make("StateSpaceModel")
    omega = np.geomspace(0.1, 10.0, 30)
    above, below = model.plot("bode", omega=omega)
    response = rl.frequency_response(model, omega)[:, 0, 0]
    assert above.lines[-1].get_ydata() == pytest.approx(np.abs(response))
    assert below.lines[-1].get_ydata() == pytest.approx(np.degrees(np.unwrap(np.angle(response))))
    t = np.linspace(0.0, 30.0, 301)
    axes = model.plot("step", t=t)
    assert axes.lines[-1].get_ydata() == pytest.approx(rl.simulate(model, t, np.ones(301))["x"])
    assert axes.get_ylabel() == "x [m/N]"
    poles = model.plot("pzmap").lines[-1]
    assert sorted(poles.get_xdata()) == pytest.approx(sorted(model.poles().real))


def test_the_envelope_holds_the_members(make):
    axes = make("UncertainModel").plot("step", n=10, seed=3)
    (band,) = axes.collections
    top = band.get_paths()[0].vertices[:, 1].max()
    assert top == pytest.approx(max(np.max(line.get_ydata()) for line in axes.lines))
    assert top > np.max(axes.lines[-1].get_ydata()) * 1.1  # the nominal one


def test_complex_blocks_are_drawn_with_real_members():
    lag = rl.unstructured(shown_objects.lag(), 0.2)
    axes = lag.plot("step", n=8)
    assert len(axes.lines) > 8
    assert all(np.isrealobj(line.get_ydata()) for line in axes.lines)


def test_the_margin_shows_the_level_that_is_proved(make):
    margin = make("Margin")
    axes = margin.plot("mu")
    labels = [text.get_text() for text in axes.figure.legends[0].get_texts()]
    assert f"{1 / margin.lower:.4g}: proved on the whole axis" in labels


def test_a_margin_without_curves_shows_its_intervals():
    margin = rl.robust_stability(shown_objects.loop())
    assert len(margin.omega) == 0
    axes = margin.plot()
    low, high = axes.get_xlim()
    assert 0 < low < margin.frequency < high


def test_the_callers_settings_stay(make):
    before = dict(mpl.rcParams)
    make("StateSpaceModel").plot()
    assert dict(mpl.rcParams) == before


# --- tables -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", [n for n in NAMES if n not in ("Record", "Trim")])
def test_tables_become_frames(name, make):
    shown = make(name)
    if not isinstance(shown, Tabular):
        assert not hasattr(shown, "to_pandas")
        return
    table = shown.table()
    frame = shown.to_pandas()
    assert list(frame.columns) == list(table.columns)
    assert frame.index.name == table.index[0]
    assert frame.attrs["units"] == dict(table.units)
    assert set(table.units) <= {*table.columns, table.index[0]}
    for key, values in table.columns.items():
        np.testing.assert_array_equal(np.asarray(frame[key]), np.asarray(values))


def test_the_table_of_a_margin_is_its_curves(make):
    margin = make("Margin")
    frame = margin.to_pandas()
    assert (frame["mu_upper"] >= frame["mu_lower"] - 1e-9).all()
    assert frame.attrs["units"] == {"omega": "rad/s"}
    campaign = make("CampaignResult").to_pandas()
    assert campaign["peak-deviation"].max() == pytest.approx(make("CampaignResult").worst)


def test_a_full_block_has_a_column_for_each_entry():
    model = rl.UncertainModel(rl.StateSpaceModel([], [], [], np.zeros((4, 3))), [rl.FullBlock("gap", 2, 3)])
    samples = rl.sample(model, 5, 1)
    columns = samples.table().columns
    assert list(columns) == [f"gap[{i},{j}]" for i in (1, 2) for j in (1, 2, 3)]
    for k, delta in enumerate(samples.deltas):
        assert [columns[name][k] for name in columns] == list(np.ravel(delta["gap"]))
    assert list(samples.to_pandas().columns) == list(columns)


def test_without_pandas_it_is_said_how_to_get_it(make, monkeypatch):
    monkeypatch.setattr(record_source.importlib.util, "find_spec", lambda name: None)
    with pytest.raises(DependencyMissing, match="needs the package") as error:
        make("Margin").to_pandas()
    assert "robustlab[frames]" in str(error.value)


# --- words ------------------------------------------------------------------------------------------------------------


def test_a_class_without_facts_of_its_own_counts_what_is_long():
    @dataclasses.dataclass(frozen=True)
    class Part(Evidence):
        status: Status
        values: np.ndarray
        name: str
        limit: float

    part = Part(Status.FAILED, np.zeros((1000, 3)), "run", 0.5)
    assert repr(part) == "Part (failed)\n  values: array of 1000 x 3\n  name: run\n  limit: 0.5"
    assert part.summary().splitlines()[1] == "  values  array of 1000 x 3"


def test_a_margin_was_18_kilobytes_long(make):
    assert len(repr(make("Margin"))) < 400
    assert re.match(
        r"Margin \(certified\)\n  robust stability margin: 1\.485 \(proved\) \.\. 1\.487 \(attained\)",
        repr(make("Margin")),
    )


def test_words():
    assert number(float("nan")) == ""
    assert number(3) == "3"
    assert number(0.30000000004, "V") == "0.3 V"
    assert number(2.0, "1") == "2"
    assert bracket(np.inf, np.inf, ("proved", "attained")) == "inf (proved and attained)"
    assert bracket(float("nan"), float("nan"), ("a", "b")) == ""
    assert listed([]) == ""
    assert member({}) == ""
    assert member({"k": 0.5, "F": np.ones((2, 2))}) == "k: delta = 0.5, F: delta = array of 2 x 2"
    assert in_words(None) == in_words(len) == ""
    assert in_words(np.ones(3)) == "1, 1, 1"
    assert in_words({k: [1] for k in "abcdefgh"}) == "a, b, c, d, e, f and 2 more"
