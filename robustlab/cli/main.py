"""The ``robustlab`` command: the first word selects a group, whose parser (typer) reads the rest.

The top level needs no parser, so ``robustlab --help`` loads neither typer nor any numerical library.
"""

from __future__ import annotations

import gc
import os
import sys
from collections.abc import Sequence
from functools import cache
from importlib import import_module
from typing import Any

# Command -> (module:app of commands written by hand, and the modules of operations with its commands; a line of help).
GROUPS: dict[str, tuple[str, str]] = {
    "plant": ("plant:PLANT", "List plants, show one; start one of your own in a file."),
    "model": ("plant:MODEL designs models robustness", "Build, show, check, compare and convert models."),
    "uncertain": ("models worst_cases", "Build, show and sample uncertain models."),
    "worst-case": ("worst_cases", "Search for the worst member of an uncertain model."),
    "violation-probability": ("worst_cases", "Probability that random members violate a limit."),
    "campaign": ("worst_cases", "Run samples and searches of any size, resumable."),
    "mu": ("robustness", "Robust stability margin with proved mu bounds."),
    "worst-gain": ("robustness", "Proved worst-case gain of an uncertain model."),
    "performance-margin": ("robustness", "Robust performance margin of a set."),
    "synth": ("designs", "Design a controller and verify its loop."),
    "data": ("data:app", "Check and compare records; identify missing effects."),
    "run": ("run:RUN", "Run a recipe: steps, requirements, report."),
    "recipe": ("run:RECIPE", "Check a recipe, list kinds of steps, start a new one."),
    "report": ("run:REPORT", "Write a finished run's report again; compare two runs."),
    "verify": ("run:VERIFY", "Verify results again, from their files alone."),
    "doctor": ("run:DOCTOR", "Check whether this installation works."),
}

# One BLAS thread unless the user sets another number: matrices are small, threads made a run several times slower on a
# busy machine, and one thread gives repeatable bits. Read when numpy is loaded.
_THREADS = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")

# Threshold of the garbage collector: loading the modules of a command makes some hundred thousand objects.
YOUNG = 200_000

_HEAD = """\
Usage: robustlab COMMAND [OPTIONS] [ARGS]...

  Robust-control workbench: uncertain models, mu bounds, H-infinity synthesis,
  model against measurement. Every number is proved or labelled.

Commands:
"""

_FOOT = """
Options:
  --version  Print the version and exit.
  --help     Show this message and exit; COMMAND --help shows that command's.
  --install-completion  Install TAB completion for the current shell.
  --show-completion     Print the completion script.

Start with:
  robustlab run first-light

Exit codes:
  0 done and all requirements met   1 a stated requirement is not met
  2 usage                           3 bad input
  4 no trustworthy number           5 environment
  70 a bug in robustlab             130 interrupted (Ctrl-C, SIGTERM)
"""


FIRST_WORDS = """\
robustlab: uncertain models, proved bounds, verified controllers, model against measurement.

What one can do first:
  robustlab run first-light               a whole design of a motor, with its report
  robustlab plant new mymachine           your own plant, in one file
  robustlab uncertain --help              what is uncertain about it
  robustlab data compare --help           how far a model is off a record
  robustlab recipe new my-project         a commented recipe to start from

robustlab --help lists the commands; docs/words.md says what the words of a result mean.
"""


@cache
def parser(name: str) -> Any:
    """Return typer's command or group that parses the words after ``robustlab NAME``."""
    import typer
    from typer.main import get_command

    made, title = GROUPS[name]
    app, families = typer.Typer(), made.split()
    if ":" in made:
        module, _, app_name = families.pop(0).partition(":")
        app = getattr(import_module(f"robustlab.cli.{module}"), app_name)
    if families:
        from robustlab.cli.generated import add_commands

        add_commands(app, name, *families)
    app.info.help = app.info.help or title
    app.info.no_args_is_help, app._add_completion = True, False
    app.rich_markup_mode = None  # plain text, as in the documentation
    return get_command(app)


def help_text() -> str:
    width = max(map(len, GROUPS))
    rows = [f"  {name.ljust(width)}  {line}\n" for name, (_, line) in GROUPS.items()]
    return _HEAD + "".join(rows) + _FOOT


def run_command(arguments: Sequence[str]) -> int:
    if not arguments:
        print(FIRST_WORDS, end="")
        return 2
    if arguments[0] in ("--help", "-h"):
        print(help_text(), end="")
        return 0
    name, *rest = arguments
    if name == "--version":
        from robustlab.provenance import robustlab_version

        print(robustlab_version())
        return 0
    if name in ("--install-completion", "--show-completion"):
        from robustlab.cli.completion import run_top

        return run_top(GROUPS, parser, name)
    if name not in GROUPS:
        from robustlab.errors import UsageError, did_you_mean

        kind = "option" if name.startswith("-") else "command"
        hint = did_you_mean(name, list(GROUPS)) or "robustlab --help lists the commands"
        raise UsageError("robustlab", f"no such {kind} {name!r}", f"one of {', '.join(GROUPS)}", hint)
    from robustlab.cli.console import answer

    for variable in _THREADS:
        os.environ.setdefault(variable, "1")
    command = parser(name)

    # Not command.main(), which turns a closed pipe at stdout into exit code 1.
    def called() -> int | None:
        with command.make_context(f"robustlab {name}", rest) as context:
            return command.invoke(context)

    try:
        return answer(called)
    except Exception as error:
        if type(error).__name__ == "MissingParameter":  # the parser's; the class is click's, or typer's own copy of it
            _raise_with_choices(error)
        raise


def _raise_with_choices(error: Any) -> None:
    """Raise a UsageError with the possible values of a missing argument, where there are any."""
    from robustlab.cli.completion import PLANTS
    from robustlab.errors import UsageError
    from robustlab.recipe.builtin_recipes import shipped_titles

    if error.param is None or error.ctx is None:
        return
    names = [item.value for item in error.param.shell_complete(error.ctx, "")]
    if names:
        titles = PLANTS if PLANTS.keys() & set(names) else shipped_titles()
        missing = f"{error.param.metavar or error.param.name.upper()} is missing"
        width, command = max(map(len, names)), error.ctx.command_path
        lines = tuple(f"  {name:<{width}}  {titles.get(name, '')}".rstrip() for name in names)
        raise UsageError(command, missing, "a file, or one of these", f"{command} --help", lines) from None


def main() -> None:
    from robustlab.cli.console import main_guard, ready_streams

    def command() -> int:
        ready_streams()
        if "_ROBUSTLAB_COMPLETE" in os.environ:  # called by a shell's completion
            from robustlab.cli.completion import run_top

            return run_top(GROUPS, parser)
        return run_command(sys.argv[1:])

    # Objects made by loading live to the end and need no collection.
    gc.set_threshold(YOUNG)
    try:
        sys.exit(main_guard(command))
    finally:
        gc.freeze()


if __name__ == "__main__":
    main()
