"""One word for one thing: how the value of each option is written, in all commands, and what options were called.

A parser of words knows texts, numbers and flags; that ``--inputs`` takes names and ``--input-value`` a value is told
here once, and shown by the help of every command that has the option.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

NAMES, VALUE, FILE, WORD, NUMBERS = "NAME,...", "NAME=VALUE", "FILE", "WORD", "NUMBER,..."

# Option -> how its value is written, where that is not a plain number.
VALUES = {
    # signals, states, effects by name
    **dict.fromkeys(("--inputs", "--outputs", "--controls", "--measurements", "--channels", "--regulated"), NAMES),
    **dict.fromkeys(("--disturbance-inputs", "--performance-outputs", "--follow", "--hold"), NAMES),
    **dict.fromkeys(("--clock", "--group", "--exclude", "--prefix"), "NAME"),
    # names with values
    **dict.fromkeys(("--input-value", "--at", "--set", "--tolerance", "--amplitude", "--noise", "--integral"), VALUE),
    **dict.fromkeys(("--state-weight", "--control-weight", "--process-noise", "--measurement-noise"), VALUE),
    **dict.fromkeys(("--stick-speed", "--rate", "--grid", "--input-delay", "--output-delay", "--pole-limit"), VALUE),
    **dict.fromkeys(("--range", "--saturation"), "NAME=LOW:HIGH"),
    "--unit": "NAME=UNIT",
    "--nature": "NAME=WORD",
    # files
    **dict.fromkeys(("--controller", "--input-weight", "--output-weight", "--reference-model", "--cover"), FILE),
    **dict.fromkeys(("--expressions", "--code", "--store", "--model-out", "--from-data"), FILE),
    **dict.fromkeys(("--held-out", "--repeat"), FILE),
    **dict.fromkeys(("--out", "--figure", "--discovery"), "PATH"),
    **dict.fromkeys(("--plant", "--model"), "PLANT"),
    # one of several words
    **dict.fromkeys(("--kind", "--metric", "--method", "--measure", "--objective", "--form", "--structure"), WORD),
    **dict.fromkeys(("--feedback", "--disturbance-at", "--domain", "--noise-norm", "--delta", "--dry"), WORD),
    **dict.fromkeys(("--lyapunov", "--progress"), WORD),
    # numbers
    **dict.fromkeys(("--frequency", "--pose", "--q", "--r", "--v", "--w", "--disturbance-noise"), NUMBERS),
    "--band": "LOW,HIGH",
    "--limit": "NUMBER",
    "--vertices": "NUMBER|all",
    # texts of their own
    **dict.fromkeys(("--goal", "--hard"), "GOAL"),
    **dict.fromkeys(("--w1", "--w2", "--w3", "--disturbance"), "WEIGHT"),
    "--blocks": "ROWS",
    "--sum": "EQUATION",
    "--cluster": "ADDRESS",
    "--delimiter": "SIGN",
    "--decimal": "SIGN",
}

# Command -> what an option was called, and is called; the old word still works, with a note.
_SIDES = {"--input": "--inputs", "--output": "--outputs"}
_DELAYS = {"--input": "--input-delay", "--output": "--output-delay"}
_METRIC = {"--input": "--input-value", "--output": "--outputs", "--from": "--inputs", "--band": "--settling-band"}
_FIGURES = {"--figures": "--figure"}
_CHANNELS = {"--disturbances": "--disturbance-inputs", "--performance": "--performance-outputs"}
_COUNTS = {"--n-meas": "--measurements", "--n-con": "--controls"}
FORMER = {
    "model plot": _SIDES,
    "model connect": _SIDES,
    "model delay": _DELAYS,
    "model reduce": {"--tolerance": "--max-error"},
    "uncertain build": {"--noise": "--rtol", "--order": "--weight-order"},
    "uncertain sample": {"--input": "--input-value"},
    "uncertain delays": {**_DELAYS, "--order": "--pade"},
    "uncertain neglected": {"--order": "--weight-order"},
    "worst-case": _METRIC,
    "campaign run": _METRIC,
    "iqc gain": {"--order": "--filter-order"},
    "iqc anti-windup": {"--order": "--filter-order", "--limit": "--saturation", "--direct": "--correct-outputs"},
    **{f"synth {method}": {**_CHANNELS, **_COUNTS} for method in ("hinf", "h2", "dk", "fixed")},
    "synth tune": {"--limit": "--pole-limit"},
    **{f"lpv {word}": {"--points": "--grid", **_COUNTS} for word in ("build", "gain", "hinf")},
    "data compare": {**_SIDES, **_FIGURES},
    "data discover": {**_SIDES, **_FIGURES},
    "data validate": {"--output": "--outputs", "--cover": "--envelope", **_FIGURES},
    "report compare": {"--tolerance": "--rtol"},
}
_EVERYWHERE = {"--timeout": "--time-limit"}


def of_today(group: str, words: Sequence[str]) -> tuple[list[str], list[str]]:
    """The words behind ``robustlab GROUP`` with today's names of their options, and a note for each that was changed.

    Examples
    --------
    >>> of_today("uncertain", ["sample", "set.h5", "--input", "u=42"])[0]
    ['sample', 'set.h5', '--input-value', 'u=42']
    """
    command = f"{group} {words[0]}" if words and f"{group} {words[0]}" in FORMER else group
    table = {**_EVERYWHERE, **FORMER.get(command, {})}
    found: list[str] = []
    notes: dict[str, None] = {}
    is_folder = False
    for k, word in enumerate(words):
        option, equals, value = word.partition("=")
        if "--" in found or option not in table:
            found.append(f"{word}/" if is_folder else word)
            is_folder = False
            continue
        notes[f"{option} is called {table[option]}; the old word will go"] = None
        folder = option == "--figures"  # it took a folder, and nothing else
        found.append(f"{table[option]}{equals}{value}{'/' * (folder and bool(equals))}")
        is_folder = folder and not equals and k + 1 < len(words)
    return found, list(notes)


def told(command: Any) -> Any:
    """A parser's command, or group of them, whose help says how values are written."""
    for inner in getattr(command, "commands", {}).values():
        told(inner)
    for parameter in command.params:
        if parameter.param_type_name == "option" and parameter.metavar is None:
            parameter.metavar = next((VALUES[o] for o in parameter.opts if o in VALUES), None)
    return command
