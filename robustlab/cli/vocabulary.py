"""How the value of each option is written, in all commands.

A parser of words knows texts, numbers and flags; that ``--inputs`` takes names and ``--input-value`` a value is told
here once, and shown by the help of every command that has the option.
"""

from __future__ import annotations

from typing import Any

NAMES, VALUE, FILE, WORD, NUMBERS = "NAME,...", "NAME=VALUE", "FILE", "WORD", "NUMBER,..."

# Option -> how its value is written, where that is not a plain number.
VALUES = {
    # signals, states, effects by name
    **dict.fromkeys(("--inputs", "--outputs", "--controls", "--measurements", "--channels", "--regulated"), NAMES),
    **dict.fromkeys(("--disturbance-inputs", "--performance-outputs", "--hold"), NAMES),
    **dict.fromkeys(("--clock", "--group", "--exclude", "--prefix"), "NAME"),
    # names with values
    **dict.fromkeys(("--input-value", "--at", "--set", "--tolerance", "--amplitude", "--noise", "--integral"), VALUE),
    **dict.fromkeys(("--state-weight", "--control-weight", "--process-noise", "--measurement-noise"), VALUE),
    **dict.fromkeys(("--stick-speed", "--rate", "--grid", "--input-delay", "--output-delay", "--pole-limit"), VALUE),
    **dict.fromkeys(("--range", "--saturation"), "NAME=LOW:HIGH"),
    "--unit": "NAME=UNIT",
    "--nature": "NAME=WORD",
    # files
    **dict.fromkeys(("--controller", "--input-weight", "--output-weight", "--cover"), FILE),
    **dict.fromkeys(("--expressions", "--code", "--store", "--model-out"), FILE),
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


def told(command: Any) -> Any:
    """A parser's command, or group of them, whose help says how values are written."""
    for inner in getattr(command, "commands", {}).values():
        told(inner)
    for parameter in command.params:
        if parameter.param_type_name == "option" and parameter.metavar is None:
            parameter.metavar = next((VALUES[o] for o in parameter.opts if o in VALUES), None)
    return command
