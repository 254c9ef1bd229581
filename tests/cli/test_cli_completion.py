"""Completion by TAB: bash as a user runs it."""

import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import get_args, get_type_hints

import pytest

import robustlab as rl
from robustlab.campaign import CampaignSettings
from robustlab.cli import GROUPS, PLANTS, parser
from robustlab.operations import METRICS

HEAVY = {"numpy", "scipy", "control", "cvxpy", "h5py", "matplotlib", "jinja2"}  # typer itself takes pydantic
SCRIPTS = Path(sys.executable).parent
needs_bash = pytest.mark.skipif(shutil.which("bash") is None, reason="no bash")


def called(*arguments, home=None, shell="/bin/bash", **variables):
    environment = {**os.environ, "PATH": f"{SCRIPTS}{os.pathsep}{os.environ['PATH']}", "SHELL": shell, **variables}
    for name in ("ZDOTDIR", "XDG_CONFIG_HOME"):
        environment.pop(name, None)
    if home is not None:
        environment["HOME"] = str(home)
    return subprocess.run(
        [sys.executable, "-m", "robustlab.cli.main", *arguments],
        env=environment, cwd=home, capture_output=True, text=True, check=False,
    )  # fmt: skip


# What a line's last word may become, by bash's own machinery: the script is loaded, its function is called.
IN_BASH = """\
source "$SCRIPT" || exit 9
COMP_WORDS=("$@"); COMP_CWORD=$(($# - 1))
complete -p robustlab >&2 || exit 8
_robustlab_completion robustlab
printf '%s\\n' "${COMPREPLY[@]}"
"""


@pytest.fixture(scope="module")
def script(tmp_path_factory):
    path = tmp_path_factory.mktemp("bash") / "robustlab.sh"
    path.write_text(called(_ROBUSTLAB_COMPLETE="source_bash").stdout)
    return path


@pytest.fixture
def tab(script, tmp_path):
    def completed(*words):
        environment = {**os.environ, "PATH": f"{SCRIPTS}{os.pathsep}{os.environ['PATH']}", "SCRIPT": str(script)}
        command = ["bash", "--norc", "-c", IN_BASH, "bash", "robustlab", *words]
        done = subprocess.run(command, env=environment, cwd=tmp_path, capture_output=True, text=True, check=True)
        assert done.stderr == "complete -o default -F _robustlab_completion robustlab\n"
        return [word for word in done.stdout.splitlines() if word]

    return completed


@needs_bash
def test_bash_completes_words(tab, tmp_path):
    for name in ("first-try.toml", "first-try.csv"):
        (tmp_path / name).touch()
    (tmp_path / "first-folder").mkdir()
    assert tab("m") == ["model", "mu"]
    assert tab("synth", "") == list(parser("synth").commands)
    assert tab("mu", "x.h5", "--in") == ["--intervals"]
    assert tab("worst-case", "x.h5", "--metric", "p") == ["peak-deviation", "peak"]
    assert tab("model", "build", "s") == ["servo-axis", "stewart-platform"]
    assert tab("recipe", "check", "first") == ["first-light", "first-folder/", "first-try.toml"]
    assert tab("mu", "") == []  # and `complete -o default` means files then
    assert tab("no-such-command", "") == list(GROUPS)


def test_tab_loads_no_numerical_library_and_only_the_group_that_is_named():
    for words in ("robustlab\nsynth\nh", "robustlab\nrun\nf", "robustlab\nmodel\nplot\nd"):
        code = (
            "import sys, runpy, atexit\n"
            "atexit.register(lambda: print(*sys.modules, file=sys.stderr))\n"
            "sys.argv = ['robustlab']\n"
            "runpy.run_module('robustlab.cli.main', run_name='__main__')\n"
        )
        completion = {"COMP_WORDS": words, "COMP_CWORD": str(words.count("\n")), "_ROBUSTLAB_COMPLETE": "complete_bash"}
        environment = {**os.environ, **completion}
        done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True)
        assert done.stdout
        loaded = done.stderr.split()
        assert not {module.split(".")[0] for module in loaded} & HEAVY
        assert ("robustlab.cli.run" in loaded) == ("run" in words)


# --- what is offered is what the library takes -----------------------------------------------------------------------


def offered(*words):
    """Option -> all that is offered for it."""
    command = parser(words[0])
    for word in words[1:]:
        command = command.commands[word]
    context = command.make_context(" ".join(words), [], resilient_parsing=True)
    found = {}
    for parameter in command.get_params(context):
        values = [item.value for item in parameter.shell_complete(context, "")]
        if values:
            found |= dict.fromkeys(parameter.opts, values)
    return found


def test_plants_and_metrics_are_those_of_the_library():
    from robustlab.dynamics import plant_names
    from robustlab.worst_case_analysis import METRICS as KNOWN

    assert set(PLANTS) == set(plant_names())
    assert set(METRICS) == set(KNOWN)


def literals(function, argument):
    """The words that an argument of a function may be."""
    hint = get_type_hints(function)[argument]
    return {word for part in (hint, *get_args(hint)) for word in get_args(part) if isinstance(word, str)}


def test_choices_are_those_of_the_library():
    for words, option, function, argument in [
        (("model", "margins"), "--at", rl.disk_margin, "at"),
        (("model", "reduce"), "--method", rl.reduce_model, "method"),
        (("uncertain", "discovery"), "--dry", rl.uncertain_from, "dry"),
        (("data", "validate"), "--domain", rl.validate, "domain"),
        (("campaign", "run"), "--kind", CampaignSettings, "kind"),
    ]:
        assert set(offered(*words)[option]) == literals(function, argument), (words, option)
