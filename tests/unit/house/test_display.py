"""Every public object is displayed: repr, HTML, text, drawings, tables."""

import inspect
import json
import typing
from xml.etree import ElementTree as ET

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
import pytest
import shown_objects
from matplotlib.axes import Axes

import robustlab as rl
from robustlab import errors
from robustlab.display import LINES, Displayable
from robustlab.errors import DependencyMissing, InputError
from robustlab.report import DRAWINGS
from robustlab.result import Result, Status, Tabular, plain
from robustlab.synthesis import Design

mpl.use("Agg")
HOSTILE = "<script>alert(1)</script> & \x1b[31m \u202e $x$"
NAMES = [*shown_objects.OBJECTS, "CampaignResult"]
# What is no result: settings, names, and blocks, whose repr is what one writes to make them.
PLAIN = {
    "Signal", "RealScalar", "ComplexScalar", "FullBlock", "ParameterRange", "PlantEquations", "Varying", "Nonlinearity",
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
    assert [kind.__name__ for kind in kinds if not issubclass(kind, Displayable)] == []
    made = [type(make(name)) for name in NAMES]
    assert [kind.__name__ for kind in kinds if not any(issubclass(one, kind) for one in made)] == []


def check_html(text):
    root = ET.fromstring(text)
    assert {part.tag for part in root.iter()} == {"table", "caption", "tbody", "tr", "th", "td"}
    return root


@pytest.mark.parametrize("name", NAMES)
def test_an_object_shows_itself_short_plain_and_as_a_table(name, make):
    shown = make(name)
    text, summary = repr(shown), shown.summary()
    assert 1 <= len(text.splitlines()) <= LINES
    assert len(text) <= 600
    assert type(shown).__name__ in text or isinstance(shown, rl.Record)
    if isinstance(getattr(shown, "status", None), Status):
        assert f"({shown.status})" in text.splitlines()[0]
    assert summary
    assert all(line.isprintable() for line in summary.split("\n"))
    assert not [word for word in ("array(", "object at 0x") if word in summary]
    root = check_html(shown._repr_html_())
    assert root.find("caption").text.startswith(type(shown).__name__)
    assert len(root.find("tbody")) >= 1


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


PARENT = {"HinfSynthesis": "Synthesis"}  # one for each drawing that is inherited
CASES = [(name, kind) for name in NAMES for kind in DRAWINGS.get(PARENT.get(name, name), {})]


def panels_of(drawn):
    return [drawn] if isinstance(drawn, Axes) else list(drawn)


@pytest.mark.parametrize(("name", "kind"), CASES)
def test_a_drawing_returns_its_axes_with_labels_and_units(name, kind, make):
    drawn = make(name).plot(kind)
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
def test_a_drawing_that_fails_is_reported_in_one_line_and_leaves_no_figure(ask, text, make):
    with pytest.raises(InputError, match=text) as error:
        ask(make("StateSpaceModel"))
    assert "\n" not in error.value.line
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


def test_without_pandas_the_error_has_the_command_to_install_it(make, monkeypatch):
    monkeypatch.setattr(errors, "find_spec", lambda name: None)
    with pytest.raises(DependencyMissing, match="needs the package") as error:
        make("Margin").to_pandas()
    assert "robustlab[frames]" in str(error.value)


# --- what requirements may refer to -----------------------------------------------------------------------------------


KINDS = [
    *("DKSynthesis", "FixedSynthesis", "H2Synthesis", "HinfSynthesis"),
    *("LPVSynthesis", "NcfSynthesis", "ReducedController", "ReducedModel"),
    *("SampledController", "TunedSynthesis"),
]


@pytest.mark.parametrize("kind", KINDS)
def test_what_is_declared_is_there(kind):
    found = shown_objects.made(kind)
    numbers = plain(found.numbers())
    unset = {name for name in found.quantities if getattr(found, name, "") is None}  # a filter that is not there
    assert set(numbers) == set(found.quantities) - unset
    if isinstance(found, Design):
        assert found.headline()
        assert numbers["gamma"] == plain(found.gamma)


# --- results as plain JSON --------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("value", "wanted"),
    [
        (None, None),
        (True, True),
        (np.True_, True),
        (Status.FAILED, "failed"),
        (3, 3),
        (np.int64(3), 3),
        (np.float32(0.5), 0.5),
        (float("inf"), "inf"),
        (-np.inf, "-inf"),
        (np.nan, "nan"),
        (1 + 2j, {"re": 1.0, "im": 2.0}),
        (np.array([[1.0, np.nan]]), [[1.0, "nan"]]),
        (np.array([1j]), [{"re": 0.0, "im": 1.0}]),
        ((1, [2.0]), [1, [2.0]]),
        ({1: {"a": np.zeros(0)}}, {"1": {"a": []}}),
        (Result("Margin", Status.CERTIFIED, {"lower": 2.0}), {"type": "Margin", "lower": 2.0, "status": "certified"}),
    ],
)
def test_plain_forms(value, wanted):
    found = plain(value)
    assert found == wanted
    json.dumps(found, allow_nan=False)


def test_what_has_no_plain_form_is_an_error():
    with pytest.raises(TypeError, match="no plain form"):
        plain(object())
