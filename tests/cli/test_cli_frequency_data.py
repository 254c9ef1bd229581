"""Frequency-response data and given frequencies, from the shell: tables, files, `mu`, margins, a recipe."""

import numpy as np
import pytest
from shell import robustlab

import robustlab as rl

OMEGA = np.array([0.5, 1.0, 4.0])
LAG = rl.StateSpaceModel([[-1.0]], [[1.0]], [[1.0]], [[0.0]], inputs=["u"], outputs=["y"])
G = rl.frequency_response(LAG, OMEGA)[:, 0, 0]


@pytest.fixture(autouse=True)
def files(monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    data = rl.frequency_data(G, OMEGA, radius=0.1 * abs(G), inputs=["u"], outputs=["y"])
    rl.save("data.h5", data)
    rl.save("loop.h5", data.feedback(3.0))
    rl.save("set.h5", rl.unstructured(LAG, 0.1, "output-multiplicative").feedback(3.0))


@pytest.mark.slow
def test_mu_of_data_reports_its_frequencies():
    printed = robustlab("mu", "loop.h5", code=0).out
    assert "at the 3 given frequencies only; nothing is claimed between them" in printed
    assert "taken for granted" in printed
    found = robustlab("mu", "loop.h5", "--json", code=0).json
    expected = abs(1 + 3 * G) / (0.3 * abs(G))
    assert found["lower_at"] == pytest.approx(expected.tolist(), rel=1e-6)
    assert found["lower"] == pytest.approx(expected.min(), rel=1e-6)
    gain = robustlab("worst-gain", "loop.h5", "--json", code=0).json
    assert gain["upper_at"][0] > abs(G[0] / (1 + 3 * G[0]))
    robustlab("mu", "loop.h5", "--figure", "margin", "--out", "margin.h5", code=0)
    assert rl.load("margin.h5").status is rl.Status.CERTIFIED


def test_a_set_at_given_frequencies():
    found = robustlab("mu", "set.h5", "--frequency", "0.5,1,4", "--json", code=0).json
    assert found["lower_at"] == pytest.approx((abs(1 + 3 * G) / (0.3 * abs(G))).tolist(), rel=1e-6)
    assert "numbers" in robustlab("mu", "set.h5", "--frequency", "one", code=2).err


def test_margins_of_data():
    found = robustlab("model", "show", "data.h5", "--json", code=0).json
    assert found["kind"] == "frequency-data"
    rl.save("plain.h5", rl.frequency_data(3.0 * G, OMEGA))
    printed = robustlab("model", "margins", "plain.h5", "--json", code=0).json
    S = 1 / (1 + 3 * G)
    assert printed["simultaneous"]["lower_at"] == pytest.approx((1 / abs(S - 0.5)).tolist(), rel=1e-6)


def test_a_recipe_bounds_measured_data(tmp_path):
    rl.save("k.h5", rl.StateSpaceModel([], [], [], [[3.0]], inputs=["y"], outputs=["u"]))
    text = f"""schema = "robustlab.recipe/1"
name = "measured"

[step.data]
do = "load"
path = "{tmp_path}/data.h5"

[step.k]
do = "load"
path = "{tmp_path}/k.h5"

[step.margin]
do = "robust-stability"
of = "data"
controller = "k"
sign = -1

[[require]]
text = "Every measured frequency keeps a margin"
that = "margin.lower"
at_least = 10.0
"""
    (tmp_path / "r.toml").write_text(text)
    robustlab("run", "r.toml", "--out", "out", code=0)
    assert "nothing is claimed between them" in (tmp_path / "out" / "report.html").read_text(encoding="utf-8")


# --- tables ----------------------------------------------------------------------------------------------------------

RADIUS = 0.1 * abs(G)


def write_table(path, header, *columns):
    rows = [",".join(f"{value:.17g}" for value in row) for row in zip(*columns, strict=True)]
    path.write_text("\n".join([header, *rows]) + "\n")


def refused(path, **options):
    with pytest.raises(rl.InputError) as error:
        rl.UncertainFrequencyData.read(path, **options)
    return str(error.value)


def test_a_measured_table_becomes_data_and_its_loop_is_bounded(tmp_path):
    head = "f [Hz],y from u magnitude [dB],y from u phase [deg],y from u radius"
    write_table(tmp_path / "t.csv", head, OMEGA / (2 * np.pi), 20 * np.log10(abs(G)), np.degrees(np.angle(G)), RADIUS)
    made, known = rl.UncertainFrequencyData.read("t.csv"), rl.load("data.h5")
    rl.save("t.h5", made)
    np.testing.assert_allclose(made.omega, OMEGA, rtol=1e-14)
    np.testing.assert_allclose(made.M, known.M, atol=1e-14)
    rl.save("k.h5", rl.StateSpaceModel([], [], [], [[3.0]]))
    found = robustlab("mu", "t.h5", "-k", "k.h5", "--feedback", "negative", "--json", code=0).json
    np.testing.assert_allclose(found["lower_at"], abs(1 + 3 * G) / (3 * RADIUS), rtol=1e-6)
    positive = robustlab("mu", "t.h5", "-k", "k.h5", "--feedback", "positive", "--json", code=0).json
    np.testing.assert_allclose(positive["lower_at"], abs(1 - 3 * G) / (3 * RADIUS), rtol=1e-6)
    assert made.blocks[0].name == "measured y from u"


def test_tables_of_several_channels_and_of_one_without_a_name(tmp_path):
    H = np.stack([[G, 2 * G], [1j * G, G**2]])  # outputs a, b; inputs u, v
    names = [f"{y} from {u} {part}" for y in "ab" for u in "uv" for part in ("real", "imag")]
    parts = [part(H[i, j]) for i in range(2) for j in range(2) for part in (np.real, np.imag)]
    write_table(tmp_path / "m.csv", ",".join(["w", *names, "radius"]), OMEGA, *parts, RADIUS)
    rl.save("m.h5", rl.UncertainFrequencyData.read("m.csv", units={"w": "rad/s"}))
    made = rl.load("m.h5")
    np.testing.assert_allclose(made.nominal, H.transpose(2, 0, 1), rtol=1e-15)
    assert [(b.name, b.rows, b.cols) for b in made.blocks] == [("measured", 2, 2)]
    np.testing.assert_allclose(np.linalg.norm(made.M[:, :2, 2:], 2, axis=(1, 2)), RADIUS, rtol=1e-15)
    write_table(tmp_path / "one.csv", "w [rad/s],real,imag", OMEGA, G.real, G.imag)
    one = rl.UncertainFrequencyData.read("one.csv")
    assert not one.blocks
    np.testing.assert_allclose(one.nominal[:, 0, 0], G, rtol=1e-15)


@pytest.mark.parametrize(
    ("header", "text"),
    [
        ("f,real,imag", "column 'f' without a unit, expected the frequency, in rad/s or Hz"),
        ("f [V],real,imag", "column 'f' in 'V'"),
        ("f [Hz],real,imga", "did you mean imag?"),
        ("f [Hz],y from u real,y from u radius", "y from u with real, expected real and imag, or magnitude and phase"),
        ("f [Hz],magnitude,phase", "column 'phase' without a unit, expected rad or deg"),
        ("f [Hz],real [mm],imag", "column 'real' in 'mm'"),
        ("f [Hz],y real,y imag", "expected a name that begins with OUTPUT from INPUT"),
        ("f [Hz],radius", "no columns of OUTPUT from INPUT"),
    ],
)
def test_faults_of_a_table_are_reported(tmp_path, header, text):
    count = header.count(",")
    write_table(tmp_path / "t.csv", header, OMEGA, *[np.ones(3)] * count)
    assert text in refused("t.csv").replace("\n", " ")


def test_numbers_and_names_that_do_not_fit_are_reported(tmp_path):
    write_table(tmp_path / "t.csv", "f [Hz],real,imag,radius", OMEGA[::-1], G.real, G.imag, -RADIUS)
    assert "t.csv: UncertainFrequencyData: omega: frequencies that do not increase" in refused("t.csv")
    write_table(tmp_path / "t.csv", "f [Hz],real,imag,radius", OMEGA, G.real, G.imag, -RADIUS)
    assert "radius: negative" in refused("t.csv")
    assert "did you mean real?" in refused("t.csv", units={"reel": "V"})
    head = "f [Hz],a from u real,a from u imag,b from v real,b from v imag"
    write_table(tmp_path / "t.csv", head, OMEGA, *[np.ones(3)] * 4)
    assert "no columns of a from v" in refused("t.csv")
    head = "f [Hz],a from u real,a from u imag,a from u radius,a from v real,a from v imag"
    write_table(tmp_path / "t.csv", head, OMEGA, *[np.ones(3)] * 5)
    assert "a radius of a from u, and none of a from v" in refused("t.csv")
    (tmp_path / "t.csv").write_text("1,2,3\n2,3,4\n")
    assert "no header" in refused("t.csv")
