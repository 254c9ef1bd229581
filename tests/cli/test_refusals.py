"""Rejected input of commands: the exit code, nothing on stdout, and the hint."""

import shlex

import pytest
from command_files import SPRING, write_models
from shell import robustlab

CHANNELS = "--measurements 1 --controls 1"
PLATFORM = "uncertain plant stewart-platform"
MOTOR = "uncertain plant dc-motor"
COVER = "uncertain cover lag.h5 fast.h5"
WORST = "worst-case motor.h5"
LIMIT = "violation-probability motor.h5 --input-value u=42 --t-end 0.1 --outputs omega"
REFUSED = [
    ("model build dc-motor --set R:2 --out m.h5", 2, "NAME=VALUE"),
    ("model build dc-moter --out m.h5", 3, "did you mean dc-motor?"),
    ("model build dc-motor --set R=2.1V --out m.h5", 3, "expected a number in ohm"),
    ("model build stewart-platform --pose 0,0,0.1 --out m.h5", 2, "6 numbers"),
    ("model build stewart-platform --pose 0,0,9,0,0,0 --out m.h5", 3, ""),
    ("model build machine.h5 --at u=5 --out m.h5", 4, ""),
    ("model build machine.h5 --at v=5 --out m.h5", 3, ""),
    ("model build machine.h5 --at u=0 --pose 0,0,0,0,0,0 --out m.h5", 2, ""),
    ("model build dc-motor --at u=0 --out m.h5", 2, ""),
    ("model build nothing.h5 --out m.h5", 3, "nothing.h5"),
    ("uncertain build run.h5 lag.h5", 3, "holds a Record"),
    ("model convert lag.h5 m.txt", 2, "extension"),
    ("model convert lag.h5 nowhere/m.h5", 5, "no such folder"),
    ("model convert k.h5 k.c", 3, "discretise"),
    ("model convert digital.h5 k.c --anti-windup 0.05", 2, "saturation"),
    ("model margins unstable.h5", 4, "nominal closed loop unstable"),
    ("model margins lag.h5 --at here", 2, "one of input, output, both"),
    ("model margins lag.h5 --feedback minus", 2, "negative or positive"),
    ("model margins lag.h5 -k gain.h5", 3, "1 x 1"),
    ("model classical-margins pole.h5", 2, "one model"),
    ("model reduce k.h5 --order 1 --method stochastic", 3, "floor"),
    ("model reduce k.h5 --order 1 --band 0.2", 2, ""),
    ("mu lag.h5", 3, "an uncertain model"),
    ("mu lost.h5", 4, "nominal closed loop unstable (pole 1.2+0j)"),
    ("mu pole.h5 --accuracy 0", 3, "accuracy"),
    ("mu pole.h5 --frequency 1V", 2, "with a unit: 1,10 or 2Hz"),
    ("mu pole.h5 --feedback negative", 2, "--feedback: without --controller"),
    ("mu pole.h5 --progress loud", 2, "no such mode"),
    ("uncertain build", 2, "FILE"),
    ("uncertain build lag.h5 two-by-two.h5", 3, ""),
    ("uncertain build lag.h5 fast.h5 --structure columms", 2, "did you mean columns?"),
    ("uncertain build a.h5 b.h5 --range Kf=1:2", 2, ""),
    ("uncertain build a.h5 b.h5 --outputs omega", 2, ""),
    (f"{MOTOR} --tolerance Kg=0.1", 2, "no such parameter of dc-motor"),
    (f"{MOTOR} --tolerance Kf", 2, "NAME=VALUE"),
    (f"{MOTOR} --tolerance Km=5", 3, "did you mean 5% = 0.05?"),
    (f"{MOTOR} --tolerance Km=5V", 2, 'expected a share of the value: 0.05, or "5%"'),
    (f"{MOTOR} --tolerance Km=", 2, "share"),
    (f"{MOTOR} --tolerance 5%", 2, "NAME=VALUE"),
    (f"{MOTOR} --range Km=-0.2:0.3", 3, "one that does not hold 0"),
    (f"{MOTOR} --range Km=40mV:60mV", 2, "expected a number in N m/A"),
    (f"{MOTOR} --range Kf=4e-5", 2, ""),
    (f"{MOTOR} --range Kf=9e-5:4e-5", 3, ""),
    (f"{MOTOR} --pose 0,0,0,0,0,0", 2, "it for a nonlinear plant only"),
    (f"{PLATFORM} --pose 0,0", 2, "6 numbers"),
    (f"{PLATFORM} --pose 0,0,0.13,0,0,0 --at phi=0", 2, "one of them"),
    (f"{PLATFORM} --hold phi_1 --tolerance platform_mass=0.1", 3, "the pose is held"),
    (f"{PLATFORM} --at z=1 --tolerance platform_mass=0.1", 3, "pose or phi"),
    (f"{PLATFORM} --pose 0,0,0.5,0,0,0", 3, "mm"),
    (f"{PLATFORM} --tolerance platform_mas=0.1", 2, "no such parameter"),
    ("uncertain expressions nothing.toml", 3, "nothing.toml"),
    ("uncertain expressions spring.toml --tolerance m=0.1", 2, ""),
    ("uncertain cover lag.h5", 3, ""),
    (f"{COVER} --form pcb", 2, "did you mean pca"),
    (f"{COVER} --form additive --controller silent.h5", 3, "both signs leave the loop stable"),
    (f"{COVER} --feedback negative", 2, ""),
    ("uncertain discovery nothing", 3, ""),
    ("uncertain show lag.h5", 3, "holds a StateSpaceModel"),
    ("uncertain sample motor.h5 --vertices some", 2, ""),
    ("uncertain sample motor.h5 -n 0", 3, ""),
    ("uncertain sample motor.h5 --t-end -1", 2, ""),
    ("uncertain sample motor.h5 --input-value v=1", 3, ""),
    ("uncertain sample motor.h5 --input-value u=42A", 2, "'42A', expected a number in V"),
    (WORST, 2, "3 outputs and none named"),
    (f"{WORST} --metric peek-deviation", 2, "did you mean peak-deviation?"),
    (f"{WORST} --metric hinf --outputs speed", 3, "no such signal"),
    (f"{WORST} --metric hinf", 4, "not asymptotically stable"),
    (f"{WORST} --outputs omega --input-value u=42%", 2, "'42%', expected a number in V"),
    (f"{LIMIT} --limit '9 rad'", 3, "'9 rad', expected a number in rad/s"),
    (f"{LIMIT} --limit nan", 3, "a finite number"),
    (f"{LIMIT} --limit 9 -n 0", 3, "a whole number from 1"),
    (f"{LIMIT} --probability 0.1", 2, "--limit"),
    ("synth hinf p.h5 --measurements 1", 2, "channels"),
    ("synth hinf p.h5 --measurements 1 --controls 1 --controls u", 2, "channels"),
    ("synth hinf p.h5 --measurements 9 --controls 1", 3, "n_meas"),
    ("synth hinf p.h5 --measurements yy --controls u", 3, "did you mean"),
    (f"synth hinf bad.h5 {CHANNELS}", 4, "cannot be moved by the controls"),
    (f"synth fixed bad.h5 {CHANNELS}", 4, ""),
    ("synth mixsyn p.h5 --w1 bandwith=1", 2, "did you mean bandwidth"),
    ("synth mixsyn p.h5 --w1 peak=2", 2, "bandwidth is missing"),
    ("synth mixsyn p.h5 --w1 bandwidth=fast", 2, "a number in rad/s"),
    ("synth mixsyn p.h5", 3, "no weight, expected at least one of W1, W2, W3"),
    (f"synth h2 p.h5 {CHANNELS} --nominal", 3, "an uncertain model"),
    (f"synth h2 p.h5 {CHANNELS} --out nowhere/k.h5", 5, "no such folder"),
    (f"synth dk p.h5 {CHANNELS}", 3, "block"),
    (f"synth fixed p.h5 {CHANNELS} --structure pidd", 3, "did you mean pid"),
    ("synth ncf p.h5 --factor 1", 3, "above 1"),
    ("data compare servo-axs run.h5 --set M=1", 2, "did you mean servo-axis"),
    ("data compare servo-axis run.h5 --set M", 2, "NAME=VALUE"),
    ("data compare servo-axis run.h5 --set Mass=1", 3, "Mass"),
    ("data compare servo-axis run.h5 --unit u=A", 3, "the file states V, the unit given is A"),
    ("data compare servo-axis run.h5 --inputs q --outputs u", 3, "no input 'u'"),
    ("data compare servo-axis run.h5 --window 1000", 3, "window"),
    ("data compare dc-motor run.h5", 3, "phi"),
    ("data check run.h5 --set Fv=1.0", 2, "no --model"),
    ("data check run.csv --inputs p", 3, "missing p"),
    ("data check run.csv --unit q", 2, "NAME=UNIT"),
    ("data check comma.csv", 3, "hint: --decimal ,"),
    ("data discover servo-axis run.h5 --exclude backlsh", 3, "did you mean backlash?"),
    ("data discover servo-axis", 2, ""),
    ("run first-ligth", 3, "did you mean first-light?"),
    ("report compare one", 2, ""),
    ("report compare nowhere nowhere", 3, "no such file"),
    ("plant show dc-motor --at u=1", 2, ""),
    ("plant show dc-mtor", 3, ""),
    ("recipe new 'a b'", 2, ""),
    ("recipe new nowhere/mine", 5, "no such folder"),
    ("doctor --nonsense", 2, "--nonsense"),
    ("modle", 2, "did you mean model?"),
]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    made = tmp_path_factory.mktemp("models")
    write_models(made)
    return made


@pytest.mark.parametrize(("line", "code", "word"), REFUSED, ids=[line for line, _, _ in REFUSED])
def test_refused(folder, monkeypatch, line, code, word):
    monkeypatch.chdir(folder)
    before = set(folder.rglob("*"))
    found, out, err = robustlab(*shlex.split(line))
    assert (found, out) == (code, ""), err
    assert word in err
    assert "Traceback" not in err
    assert set(folder.rglob("*")) == before


@pytest.mark.parametrize(
    ("old", "new", "code", "word"),
    [
        ('"-k/m"', '"-q/m"', 3, "no parameter 'q'"),
        ("[3.0, 0.4]", "[3.0, 1.4]", 4, "vanishes at m = 0"),
        ("[parameters]", "[paramters]", 3, "did you mean parameters?"),
        ("D = [[0]]", "", 3, "no D"),
        ("D = [[0]]", "D = [[", 3, "not valid TOML"),
        ("low = 0.8", "low = 1.8", 3, "low < nominal < high"),
        ("low = 0.8", "lwo = 0.8", 3, "did you mean low?"),
        ("low = 0.8, ", "", 3, "low and high"),
        ("low = 0.8", 'low = "a"', 3, "numbers for low"),
        ('unit = "N s/m"', "unit = 3", 3, "a text for unit"),
        ('["F", "N"]', "[3, 4]", 3, "a list of names"),
        ('outputs = ["x"]', 'outputs = "x"', 3, "a list of names"),
        ('outputs = ["x"]', 'outputs = ["x", "y"]', 3, "2 signal names"),
        (SPRING, "#" * (1 << 20) + "##", 3, "at most"),
        (SPRING, "\udcff\udcfe", 3, "spring.toml"),
    ],
)
def test_expressions_that_cannot_be_used(tmp_path, old, new, code, word):
    file = tmp_path / "spring.toml"
    file.write_text(SPRING.replace(old, new), encoding="utf-8", errors="surrogateescape")
    found, out, err = robustlab("uncertain", "expressions", file)
    assert (found, out) == (code, "")
    assert word in err
    assert code == 4 or str(file) in err
