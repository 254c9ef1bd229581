"""Write docs/measured.md, the page that says how good robustlab is: ``python benchmarks/measured.py``.

The words are here; every number of a measurement is taken from a file of ``benchmarks/results`` by a pattern, and the
script ends with a line that names the pattern where it is not there any more. ``--check`` only compares.
"""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[1]
RESULTS = ROOT / "benchmarks" / "results"
PAGE = ROOT / "docs" / "measured.md"
MISSED = "**missed**"
# Raw results that no row of the page is taken from, and why.
UNUSED = {"rebuild.txt": "figures of the code itself, before and after a change of the house"}


class Row(NamedTuple):
    """A line of a table: its words have {0}, {1} ... in the places of the groups of ``pattern``.

    With ``every`` the first groups of all matches are numbers: {n} of them, {least}, {median} and {most}.
    """

    asked: str
    measured: str
    file: str
    pattern: str
    missed: bool = False
    date: str = ""  # the last one before the match where empty; "first": the first one of the file
    every: bool = False


@cache
def text_of(file: str) -> str:
    """A file of results."""
    return (RESULTS / file).read_text(encoding="utf-8")


def groups(file: str, pattern: str) -> tuple[str, ...]:
    """The groups of a pattern in a file of results; the script ends where it is not there."""
    found = re.search(pattern, text_of(file), re.MULTILINE | re.DOTALL)
    if found is None:
        sys.exit(f"benchmarks/results/{file}: nothing matches {pattern!r}: mend the row in benchmarks/measured.py")
    return tuple(" ".join(part.split()) for part in found.groups())


def spread(file: str, pattern: str) -> dict[str, str]:
    """How many numbers match, the least, the median and the largest of them."""
    found = sorted(re.findall(pattern, text_of(file), re.MULTILINE), key=float)
    if len(found) < 2:
        sys.exit(f"benchmarks/results/{file}: {len(found)} lines match {pattern!r}: mend benchmarks/measured.py")
    return {"n": str(len(found)), "least": found[0], "median": found[len(found) // 2], "most": found[-1]}


def date_of(file: str, pattern: str) -> str:
    """The last date before the match."""
    found = re.search(pattern, text_of(file), re.MULTILINE | re.DOTALL)
    dates = re.findall(r"20\d\d-\d\d-\d\d", text_of(file)[: found.end()] if found else "")
    return dates[-1] if dates else ""


def first_date(file: str) -> str:
    """The first date in a file."""
    return groups(file, r"(20\d\d-\d\d-\d\d)")[0]


def table(rows: Sequence[Row]) -> str:
    """Rows as Markdown: asked, measured, when, raw."""
    lines = ["| asked | measured | when | raw |", "|---|---|---|---|"]
    for row in rows:
        found = () if row.every else groups(row.file, row.pattern)
        numbers = spread(row.file, row.pattern) if row.every else {}
        asked, said = (words.format(*found, **numbers) for words in (row.asked, row.measured))
        when = first_date(row.file) if row.date == "first" else row.date or date_of(row.file, row.pattern)
        mark = f" {MISSED}" if row.missed else ""
        lines.append(f"| {asked} | {said}{mark} | {when} | [{row.file}](../benchmarks/results/{row.file}) |")
    return "\n".join(lines)


def words(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A table of words."""
    lines = [f"| {' | '.join(header)} |", "|" + "---|" * len(header)]
    return "\n".join([*lines, *(f"| {' | '.join(row)} |" for row in rows)])


CERTIFICATES = [
    Row(
        "no false certificate: designs, margins, gains, mu, norms on hostile plants",
        "{0} cases, {1} held, {2} not certified, {3} refused, 0 false",
        "attack.txt",
        r"^all +(\d+) +(\d+) +(\d+) +(\d+) +0 .*?^False certificates: 0",
        date="first",
    ),
    Row(
        "H-infinity designs proved once more by the small checker, two a plant",
        "all {0}; evidence and check {1} times the time of the norm in the median, a check {2} s at most",
        "verify.txt",
        r"^proved (\d+); evidence and check over analysis: median ([\d.]+); longest check ([\d.]+) s\n\n# mu",
        date="first",
    ),
    Row(
        "claims with changed numbers: 10^5, none accepted that is false",
        "{0} claims: {1} proved, {2} refuted, {3} neither, 0 false acceptances, 0 false refutations",
        "verify_attack.txt",
        r"^all +(\d+) +(\d+) +(\d+) +(\d+) +0 +0 +0 ",
        date="first",
    ),
    Row(
        "files edited everywhere but in their claims: 10^4, none accepted",
        "0 accepted, {0} not proved, {1} refused",
        "verify_files.txt",
        r"^all +0 +(\d+) +(\d+)",
        date="first",
    ),
    Row(
        "zeros in exact arithmetic, 0 wrong",
        "{0} models, {1} vouched for, {2} said to be inaccurate, 0 wrong",
        "attack_zeros.txt",
        r"^all +(14000) +(\d+) +(\d+) +0 +0",
    ),
    Row(
        "the loop proved is the loop meant",
        "{0} wrong combinations of sign, unit, file: {1} judged right, the rest refused",
        "conventions.txt",
        r"(\d+) trials.*?^ +(\d+)  judged: the loop printed, and meant.*?^no certified number about another loop",
    ),
    Row(
        "bounds next to their limits, 0 wrong",
        "gains {0} of 120, disk margins {1} of 60, delays {2} of 80 certified, 0 wrong",
        "near_limits.txt",
        r"gain   0 to 119: \{'certified': (\d+).*?disk   0 to 59: \{'certified': (\d+)"
        r".*?delay  0 to 79: \{'certified': (\d+)",
    ),
    Row(
        "no mutated file gives a traceback, a hang, or a silent number",
        "{0} mutants of 15 kinds of file: {1} read as they are, "
        "{2} refused in a line, {3} readers ended from outside; no traceback, no hang",
        "fuzz.txt",
        r"^all +(\d+) +(\d+) +\d+ +(\d+) +(\d+) +0 +0 +0 +0 +0",
    ),
]
MU = [
    Row(
        "upper bound of mu as tight as SLICOT's, 24 complex blocks",
        "bound {2} of the peer's (1: equal), {0} ms, peer {1} ms",
        "mu.txt",
        r"^24 complex +([\d.]+) +([\d.]+) +[\d.]+ +([\d.]+)",
    ),
    Row(
        "the same, 40 real blocks",
        "bound {2} of the peer's, {0} ms, peer {1} ms",
        "mu.txt",
        r"^40 real +([\d.]+) +([\d.]+) +[\d.]+ +([\d.]+)",
    ),
    Row(
        "margin of 24 masses, 4 repeated springs, within 5 % in 60 s",
        "{0} % in {1} s of CPU",
        "mu_axis.txt",
        r"^24 x 4, 0 +\S+ \.\. \S+ +(\S+) +(\S+)$",
    ),
    Row(
        "the same, five chains not seen before, the one that takes longest",
        "{0} % in {1} s",
        "mu_axis.txt",
        r"^24 x 4, 502 +\S+ \.\. \S+ +(\S+) +(\S+)$",
    ),
    Row(
        "the same, an older one",
        "{0} % in {1} s",
        "mu_axis.txt",
        r"^24 x 4, 11 +\S+ \.\. \S+ +(\S+) +(\S+)$",
        missed=True,
    ),
    Row(
        "the same, 20 masses, damping 0.003",
        "{0} % in {1} s",
        "mu_axis.txt",
        r"^20 x 4, 1, damping 0.003 +\S+ \.\. \S+ +(\S+) +(\S+)$",
        missed=True,
    ),
    Row(
        "peak of mu of six modes of damping 0.002 to 0.01, exactly 0.2, to 1 % in 30 s",
        "proved {0} in {1} s",
        "mu_axis.txt",
        r"^damping 0.002 \.\. 0.01 +\S+ \.\. \S+ +\S+ +\S+ \.\. (\S+) +(\S+)$",
    ),
    Row(
        "margin of the platform's legs at the thesis' damping",
        "{0} .. {1}, {2} % in {3} s",
        "mu_axis.txt",
        r"^platform legs, thesis .*?(\S+) \.\. (\S+) +(\S+) +(\S+)$",
    ),
    Row(
        "lower bound of mu, 24 mixed blocks, as a share of the upper one",
        "median {0}",
        "mu_lower.txt",
        r"^mixed +24 +\| +([\d.]+)",
    ),
]
SYNTHESIS = [
    Row(
        "H-infinity of COMPleib's plants at the reference",
        "{n} runs: {least} to {most} of it (below 1: better than was known), median {median}",
        "hinf.txt",
        r"^\S+ +n= +\d+ +tight +([\d.]+) +[\d.]+ s  \|",
        date="first",
        every=True,
    ),
    Row(
        "mixed sensitivity of Skogestad and Postlethwaite 2.17, squared weight",
        "{1} of the reference {0}, certified; a peer's controller for the same claim leaves the loop unstable",
        "loop_designs.txt",
        r"^SP_2.17_W1_squared +reference +([\d.]+) +robustlab +[\d.]+ \(([\d.]+)\)",
    ),
    Row(
        "loop shaping at 1.1 of gamma_min on random plants",
        "at most {0} of the level, {1} of 40 certified",
        "loop_designs.txt",
        r"40 random plants, dt = 0 s .*? at most ([\d.]+); certified (\d+)",
    ),
    Row(
        "two degrees of freedom: the aero-engine of Skogestad and Postlethwaite, published {1}",
        "{0}, certified",
        "aero_engine.txt",
        r"^factor +1.01: gamma ([\d.]+) \(certified\), published ([\d.]+)",
        date="2026-11-23",
    ),
    Row(
        "D-K of the distillation column, at most 0.960 in 60 s",
        "{0}, certified, {1} states, {2} s of CPU",
        "dk.txt",
        r"^  default: gamma ([\d.]+) certified \((\d+) states.*?CPU ([\d.]+) s",
    ),
    Row(
        "the same with at most 14 states within 1 %",
        "{0} states, {1} % above",
        "dk.txt",
        r"^  reduced: gamma [\d.]+ \((\d+) states, ([\d.]+) % above",
    ),
    Row(
        "static gains at the best norm known, smallest plants first",
        "{n} plants: {least} to {most} of it, median {median}",
        "fixed.txt",
        r"norm .*?/ best +([\d.]+)  HIFOO",
        date="2026-11-21",
        every=True,
    ),
    Row(
        "the same by HIFOO",
        "{n} plants: {least} to {most} of it, median {median}",
        "fixed.txt",
        r"HIFOO / best +([\d.]+)",
        date="2026-11-21",
        every=True,
    ),
    Row(
        "H2 at the best norm known",
        "{n} plants: {least} to {most} of it, median {median}; the largest is one that cannot be attained",
        "h2.txt",
        r"best known +\S+ +tight +([\d.]+)",
        date="first",
        every=True,
    ),
    Row(
        "scheduled by speed: spinning disks, published {1}",
        "{0}, certified",
        "scheduling.txt",
        r"^spinning disks: .*?proved ([\d.]+).*?published ([\d.]+)",
        date="2026-11-23",
    ),
    Row(
        "digital at 20 samples per crossover: loss of performance",
        "direct {0} %, by first-order hold 20.13 %",
        "discretise.txt",
        r"where the force acts: .*?^ +20 +\S+ % +\S+ % +\S+ % +20.13 % +\S+ % +([\d.]+) %",
    ),
    Row(
        "robustness of the sampled loop: proved gain by the one attained",
        "{n} cases: {least} to {most}, median {median}",
        "sampled_robustness.txt",
        r"^ +\d+ +\d +\S+ +\S+ +[\d,]+ +[\d.]+ +[\d.]+ +([\d.]+)",
        date="first",
        every=True,
    ),
    Row(
        "reduction of a controller of 18 states at 0.1 % of mu",
        "{0} states, {1} % lost, certified",
        "reduction.txt",
        r"^18 -> (\d+) states: .*?loss ([\d.]+) % \(allowed 0.1 %\), certified",
    ),
]
SPEED = [
    Row(
        "`robustlab --help`, `import robustlab`",
        "{0} and {1} ms",
        "startup.txt",
        r"^robustlab --help +(\d+) ms.*?^import robustlab +(\d+) ms",
    ),
    Row(
        "`robustlab model show FILE` in 500 ms, `data check FILE` too",
        "{0} and {1} ms",
        "startup.txt",
        r"^robustlab model show FILE +(\d+) ms.*?^robustlab data check FILE +(\d+) ms",
    ),
    Row(
        "`robustlab mu FILE`, warm, in 600 ms",
        "{0} ms",
        "startup.txt",
        r"^robustlab mu FILE, least of 5 +(\d+) ms",
        missed=True,
    ),
    Row(
        "the same on a machine that has compiled nothing yet, in 8 s",
        "{0} ms",
        "startup.txt",
        r"^robustlab mu FILE, empty cache +(\d+) ms",
    ),
    Row(
        "`robustlab run first-light` in 8 s, the first time in 25 s",
        "{0} ms, {1} ms",
        "startup.txt",
        r"^robustlab run first-light, warm +(\d+) ms.*?^robustlab run first-light, first +(\d+) ms",
    ),
    Row(
        "`make demo` with downloads at hand, in 45 s",
        "{0} s",
        "startup.txt",
        r"^make demo, wall time, pip's downloads at hand +([\d.]+) s",
    ),
    Row(
        "`robustlab run flagship` in 60 s",
        "{0} s: naming and two D-K designs",
        "startup.txt",
        r"^robustlab run flagship, wall time +([\d.]+) s",
        missed=True,
    ),
    Row("a figure of a report in 20 ms", "{0} ms", "startup.txt", r"^a figure of a report +(\d+) ms", missed=True),
    Row(
        "an installation of 500 MB",
        "{0} MB and {1} MB of bytecode",
        "startup.txt",
        r"^size of the installation: (\d+) MB and (\d+) MB",
        missed=True,
    ),
]
SETS = [
    Row(
        "smallest Delta that explains a record: truth known",
        "{n} cases: {least} to {most} % off, median {median} %",
        "validate.txt",
        r"known .* error ([\d.]+) %",
        date="first",
        every=True,
    ),
    Row(
        "a cover of the platform's members is no larger than it must be",
        "worst gain of the cover by that of the set: {n} covers, at most {most}",
        "cover.txt",
        r"^\S+ +\d+ (?:elements|pca|ellipsoid) +\d+ +\d+ +\S+ +([\d.]+)",
        date="first",
        every=True,
    ),
    Row(
        "a search finds the worst member that brute force finds",
        "{n} metrics: brute force was better by {most} % at most",
        "worst_case.txt",
        r"^[a-z0-9-]+ +([\d.e+]+) +\S+ +[\d.]+ +\d+ +\w+$",
        date="first",
        every=True,
    ),
    Row(
        "a campaign of 100 000 killed ten times",
        "the same digest; {0} samples lost, {1} % done twice",
        "campaign.txt",
        r"^lost samples +(\d+) and 0.*?samples \(([\d.]+) %\)",
        date="2026-11-21",
    ),
    Row(
        "a million samples of a platform",
        "{0} s of CPU, at most {1} MB",
        "campaign_scale.txt",
        r"^  CPU +([\d.]+) s of all.*?at most +main (\d+) MB",
    ),
    Row(
        "cost of a sample: one thread, streamed",
        "{0} us; scipy model by model {1} us",
        "sampling.txt",
        r"^streamed statistics, 1 thread +100000 .*? ([\d.]+)$.*?^scipy.signal, model by model .*? ([\d.]+)$",
    ),
    Row(
        "10 000 samples streamed by two threads, in turns with the version before",
        "{1} s of CPU, before {0} (wanted: half of it)",
        "sampling.txt",
        r"^2 threads, cpu s +([\d.]+) +([\d.]+) +",
    ),
]


def naming_bars() -> str:
    """The bars of naming on blind cases, as the campaign printed them."""
    text = re.search(r"^== bars\n(.*?)^== ", text_of("discover.txt"), re.MULTILINE | re.DOTALL)
    rows = []
    for line in (text[1] if text else "").splitlines():
        found = re.match(r"  (\S.*?)  +([\d.]+) +(.*?)  +((?:[<>]= \S+\s*)+)(pass|MISS)\s*$", line)
        if found:
            what, value, of, bar, verdict = (part.strip() for part in found.groups())
            rows.append((what, bar, f"{value} ({of}){f' {MISSED}' if verdict == 'MISS' else ''}"))
    if len(rows) < 10:
        sys.exit("benchmarks/results/discover.txt: the table of bars has another form: mend benchmarks/measured.py")
    return words(("blind cases, seeds run once", "bar", "measured"), rows)


# Row of the table of the open benchmark -> what the third generation of naming is to reach, and whether a value does.
OPEN_ROWS: dict[str, tuple[str, float, int]] = {
    "singles that the records can tell: right": (">= 0.97", 0.97, 1),
    "singles: sure and wrong": ("<= 0.005", 0.005, -1),
    "pairs: both, and no third": (">= 0.85", 0.85, 1),
    "nothing missing: a name all the same": ("0", 0.0, -1),
    "outside the catalogue: unknown, or something remains": (">= 0.95", 0.95, 1),
    "poor excitation: right, or open with the truth in it": (">= 0.97", 0.97, 1),
    "CPU s a case: median, at 95 %": ("5, 15", 5.0, -1),
}


def open_benchmark() -> str:
    """The main rows of the open benchmark of naming, three programs side by side."""
    rows = []
    for what, (bar, least, better) in OPEN_ROWS.items():
        line = next((x for x in text_of("naming.txt").splitlines() if x.startswith(what + "  ")), "")
        found = re.findall(r"\d+/\d+|[\d.]+, [\d.]+", line[len(what) :])
        if len(found) != 3:
            sys.exit(f"benchmarks/results/naming.txt: no row of three programs {what!r}: mend benchmarks/measured.py")
        number, of = re.split("/|, ", found[0])
        value = float(number) / float(of) if "/" in found[0] else float(number)
        rows.append((what, bar, f"{found[0]}{f' {MISSED}' if better * (value - least) < 0.0 else ''}", *found[1:]))
    return words(("", "bar", "robustlab", "stepwise regression", "PySINDy"), rows)


def peers() -> str:
    """Ours beside a peer, of the last table."""
    text = text_of("peers.txt").split("NOW, and the version before")[1]
    rows = []
    for line in text.splitlines():
        found = re.match(r"(\S.*?) / (\S.*?) {2,}(\d+) +(\S+) +(\S+) +([\d.]+) +(\S+) +(\S+)\s*$", line)
        if found and found[5] != "-":
            what, peer, size, _, now, theirs, _, ratio = found.groups()
            bar = 3.0 if int(size) <= 4 else 1.5
            small = float(now) - float(theirs) < 3.0 and int(size) <= 4
            missed = float(ratio) > bar and not small and "mu" not in what
            rows.append((what, peer, size, now, theirs, f"{ratio}{f' {MISSED}' if missed else ''}"))
    if len(rows) < 10:
        sys.exit("benchmarks/results/peers.txt: the table has another form: mend benchmarks/measured.py")
    return words(("ours", "peer", "size", "ours ms", "peer ms", "ratio"), rows)


def platform() -> str:
    """Naming on the Stewart platform, in a sentence."""
    right, of, there, cases, wrong, pairs, silent, median, low, high = groups(
        "platform_discover.txt",
        r"kind and leg right (\d+) of (\d+).*?in the answer (\d+) of (\d+); sure and wrong (\d+).*?"
        r"two legs: (\d+ of \d+).*?a name: (\d+ of \d+).*?CPU a case: (\d+) s median, (\d+) to (\d+) s",
    )
    return (
        f"On the Stewart platform in closed loop, seeds asked once: kind and leg right in {right} of {of} cases (93 % of 60 wanted, "
        f"more had no time) {MISSED}, the truth in\nthe answer in {there} of {cases}, {wrong} sure and wrong; two legs {pairs}, the "
        f"other one sure of one of its two ripples {MISSED}; nothing missing told as a name: {silent}. A lateness is told of its leg where input and sensor cannot be told apart; a backlash where its gap opens "
        f"for long.\nA case takes {low} to {high} s of CPU on a loaded machine, {median} s in the median (60 wanted {MISSED})"
        ". [Raw](../benchmarks/results/platform_discover.txt)"
    )


MACHINES = words(
    ("machine", "what is published, or known", "what robustlab says", "missed"),
    [
        (
            "EMPS, a servo axis (Janot, Gautier, Brunot)",
            "dry friction, viscous friction that differs with the direction",
            "these two and nothing else, the form of the dry friction open (Coulomb's 79 %); mass and viscous friction within 3 %; held-out windows of 0.48 s 8.7 mm to 0.18 mm (refitted nominal 2.4, the "
            "published parameters 0.38)",
            f"0.18 mm where 0.11 is asked for, friction 21.2 N, 4 % above {MISSED}",
        ),
        (
            "unloaded brushless motor (ODrive)",
            "cogging of 7 periods a turn; a driver that takes it out",
            "dry friction of 0.024 N m (0.4 A) and cogging of 6.998 periods; where the driver takes it out, dry friction of 0.021 N m in an open form and no cogging",
            f"amplitude of the cogging 3 % below what the current shows {MISSED}",
        ),
        (
            "cart on a belt",
            "2.5 to 4 N of friction",
            "dry friction of 2.0 N (1.7 to 2.4) and a force of the position, something remains; free run 24 ranges refitted, 2.1 % with them",
            f"a fifth below the least; five minutes {MISSED}",
        ),
        ("rack and pinion", "a delay of 4 ms", "a lateness, as a lag of 9.2 ms", f"twice as late {MISSED}"),
        (
            "servo motor, HSM150 records",
            "a static fit: load 0.0093 N m, friction 0.0244",
            "load 0.0084, level of the friction 0.022",
            f"one of eight requirements, a load that one direction alone does not show {MISSED}",
        ),
        ("Maxon motor on a ball screw", "its data sheet", "`robustlab run emps` compares model and record", ""),
    ],
)
STORIES = words(
    ("recipe", "what it shows", "missed"),
    [
        (
            "`flagship` (simulated records)",
            "proved μ of one requirement 0.72 before naming, 0.27 after; largest error of the simulated machine "
            "0.025 mm to 0.0060 mm (26 November 2026). Part of that is the sluggishness that the large set asks for: the plain controller before has 0.0098 mm",
            "",
        ),
        (
            "`flagship-emps` (measured)",
            "87 times less unmodelled dynamics; a requirement that a member missed (μ 1.03) is proved (0.79)",
            f"It ends in exit code 1 all the same: μ falls by 24 % where 30 % are asked for, the referee's error 1.29 times where 2 times are {MISSED}",
        ),
        (
            "`platform-discover` (simulated)",
            "leg and name of dry friction, 53.4 mN m; μ promised 0.83, kept 2.02, with the friction fed forward 0.84; leg 6 of the hidden machine 8.0 counts off before, 2.3 after (rms, slow path with reversals)",
            "at fast references it brings nothing; not proved are the moments of reversal and the sampled loop",
        ),
        (
            "`robust-machine`",
            "actuator: PID μ 1.027, H-infinity 0.619; platform: 0.988 and 0.294, proved at every frequency; simulated error 0.20 mm "
            "to 0.08 mm",
            "D-K gains nothing over H-infinity, on the platform it is worse (0.357)",
        ),
        (
            "`odrive`, `rack-pinion`, `hsm150`",
            "end in exit code 1, each for one requirement; `emps-discover` for two",
            MISSED,
        ),
    ],
)


def page() -> str:
    """The page."""
    return f"""# How good it is

Written by `benchmarks/measured.py` from the raw results in `benchmarks/results`; a bar that is not met says {MISSED}.
All CPU times are of two shared cores, often beside other work, so absolute times are rather too long.

- **No false certificate** is known of this version: thousands of hostile cases, judged in exact arithmetic or balls of 60 digits and more.
- **Bounds of mu and margins** are as tight as any, and proved between frequencies; one older chain of lightly damped masses stays above 5 %.
- **Naming effects** is right in 97 of 100 single names where 98 are wanted, first in 83 % of blind cases where 93 % are; real machines are told rightly in part.
- **Small models cost more** than with compiled peers, evidence included; H-infinity synthesis from 20 states on costs less.

## What tried to break the certificates

It holds: nothing false was found in what is vouched for.

{table(CERTIFICATES)}

An attack on reduced models, judged in balls: [reduction_attack.py](../benchmarks/reduction_attack.py). What "proved" means: [proved](proved.md).

## Mu and margins

Tight on the classes asked for and on six chains not seen before; of the older ones one is loose and one is slow.

{table(MU)}

## Controllers

At the published or reference value wherever there is one.

{table(SYNTHESIS)}

## Speed, beside compiled peers

Wanted: 3 times the peer's time at 3 states (or 3 ms more), 1.5 times from 20 states on. {groups("peers.txt", r"NOW.*?(20[0-9-]+)")[0]}, [raw](../benchmarks/results/peers.txt).

{peers()}

## Start, and size

CPU time of all processes, on a machine twice as fast as the one that the bars were set on.

{table(SPEED)}

## Naming an effect: blind cases

Hidden effects from other equations than the catalogue's, other parameters, seeds that were run once.
{date_of("discover.txt", "^== bars")}, [raw, later seeds and all misses included](../benchmarks/results/discover.txt).

{naming_bars()}

Later seeds: {later()}

[The open benchmark](naming-benchmark.md), the same cases for three programs, ours asked once ([all rows](../benchmarks/results/naming.txt)):

{open_benchmark()}

{new_cases()}

{platform()} On a two-link arm, three cases, all right: 14, 60 and 61 s
where 60 s are wanted ([own plants](../benchmarks/results/own_plants.txt)).

## Real machines

Names are right where the physics is simple. Measured with the recipes of the same names; the records are not ours to ship.

{MACHINES}

## From data to a better controller

{STORIES}

The flagship's records and those of the demo are simulated by programs of their own, because real ones are not ours to ship; the recipes say so.

## Sets, worst cases, campaigns

{table(SETS)}

## The thesis

`robustlab run thesis` computes 62 rows of chapters 6-11 beside the thesis: 21 are reproduced, 2 are fits and not counted as such (the platform's mass and a controller pole
are not printed), 23 are so in part or under a reading that is stated, 16 are not reproducible from the text, each with its reason. Its header lists all that was chosen.
The platform's equations beside two other programs: [stewart.txt](../benchmarks/results/stewart.txt).
"""


def new_cases() -> str:
    """What was answered of the newer seeds of the open benchmark, each asked once."""
    return "\n\n".join(_of_seed(seed) for seed in (2028, 2027))


def _of_seed(seed: int) -> str:
    name = f"naming_{seed}.txt"
    rows = [
        groups(name, rf"^{what} +(\d+)/(\d+)")
        for what in (
            "singles that the records can tell: right", "pairs: both, and no third", "singles: sure and wrong",
            "nothing missing: a name all the same",
        )
    ]  # fmt: skip
    (count,) = groups(name, r"^(\d+) cases")
    (right, of), (both, pairs), (wrong, singles), (false, nothing) = rows

    def judged(met: bool) -> str:
        return "" if met else f" {MISSED}"

    return (
        f"{count} cases of seed {seed}, asked once ([rows and misses](../benchmarks/results/{name})): "
        f"{right} of {of} singles that the records can tell where 97 % are wanted{judged(int(right) >= 0.97 * int(of))}, "
        f"{both} of {pairs} pairs where 85 % are{judged(int(both) >= 0.85 * int(pairs))}, "
        f"{wrong} of {singles} singles sure and wrong{judged(not int(wrong))}, {false} of {nothing} false names."
    )


def later() -> str:
    """What later seeds of naming gave."""
    first, of, bad, n = groups(
        "discover.txt", r"SEED 77003.*?first set right (\d+)/(\d+).*?nothing missing -> a name (\d+)/(\d+)"
    )
    second, of2, wrong, n2 = groups(
        "discover.txt", r"SEED 77031.*?first set right (\d+)/(\d+).*?sure and wrong (\d+)/(\d+)"
    )
    kinds = groups(
        "discover.txt",
        r"SEED 77041.*?a name (\d+)/(\d+).*?no third (\d+)/(\d+).*?named right (\d+)/(\d+)"
        r".*?sure and wrong (\d+)/(\d+).*?square wave: named right (\d+)/(\d+)",
    )
    bad3, n3, both, pairs, named, of3, wrong3, n4, square, of4 = kinds
    return (
        f"{first} of {of} right where 93 % are wanted {MISSED}, {bad} of {n} false names; {second} of {of2} right {MISSED}, "
        f"{wrong} of {n2} sure and wrong. Since answers are told at the level that is sure, right at that level: {named} of "
        f"{of3} where 97 % are wanted {MISSED}, {wrong3} of {n4} sure and wrong where 0.5 % may be {MISSED}, {square} of {of4} "
        f"under a square wave, both of a pair in {both} of {pairs}, {bad3} of {n3} false names."
    )


def main() -> None:
    """Write the page, or compare it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--check", action="store_true")
    found = page()
    if parser.parse_args().check:
        sys.exit(0 if PAGE.read_text(encoding="utf-8") == found else "docs/measured.md is not what this script writes")
    PAGE.write_text(found, encoding="utf-8")


if __name__ == "__main__":
    main()
