"""Words completed by TAB: what a shell asks for, and the lines it loads to ask.

The protocol and the scripts are typer's: at TAB the script calls robustlab again with the words so far in environment
variables, and the parsers of the commands answer. As everywhere, only the group that is named is loaded.
"""

from __future__ import annotations

import io
import os
import shlex
from collections.abc import Sequence
from contextlib import redirect_stdout
from pathlib import Path
from typing import Annotated, Any

import typer
from typer.core import TyperCommand, TyperGroup
from typer.main import get_command

from robustlab.cli.ending import answer
from robustlab.cli.groups import GROUPS, parser
from robustlab.errors import UsageError

SHELLS = ("bash", "zsh", "fish")
# Set by the script that the shell has loaded; typer makes the name of the program's.
COMPLETING = "_ROBUSTLAB_COMPLETE"


class _Commands(TyperGroup):
    """The table of groups as typer knows groups; the parser of one is made when its own words are completed."""

    def list_commands(self, ctx: Any) -> list[str]:
        return list(GROUPS)

    def get_command(self, ctx: Any, cmd_name: str) -> TyperCommand | None:
        return TyperCommand(cmd_name, short_help=GROUPS[cmd_name][1]) if cmd_name in GROUPS else None

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        name, *rest = args
        return (name, parser(name), rest) if name in GROUPS else super().resolve_command(ctx, args)


_top = typer.Typer(cls=_Commands)


@_top.callback()
def _options(version: Annotated[bool, typer.Option("--version", help="Print the version and leave.")] = False) -> None:
    """The options of the top level, besides those that typer adds: they are completed, and read in `main`."""


def complete() -> int:
    """Answer the shell: on stdout what may stand at the place of the cursor."""
    return answer(lambda: get_command(_top).main([], prog_name="robustlab", complete_var=COMPLETING))


def show(arguments: Sequence[str]) -> int:
    """Print what the shell loads."""
    print(_script(_shell("--show-completion", arguments)))
    return 0


def install(arguments: Sequence[str]) -> int:
    """Write it into the user's own files, and a line that loads it where the shell does not look by itself."""
    shell = _shell("--install-completion", arguments)
    script, start, line = _places(shell)
    script.parent.mkdir(parents=True, exist_ok=True)
    text = _script(shell) + "\n"
    _tell(script, not script.is_file() or script.read_text(encoding="utf-8") != text)
    script.write_text(text, encoding="utf-8")
    if start is not None:
        before = start.read_bytes() if start.exists() else b""
        missing = line.encode() not in before.splitlines()
        _tell(start, missing)
        if missing:
            with start.open("ab") as file:  # not replaced: it is often a link into a folder of settings
                file.write(b"\n" * bool(before and not before.endswith(b"\n")) + line.encode() + b"\n")
    print(f"completion takes effect in a new {shell}")
    return 0


def _tell(path: Path, written: bool) -> None:
    print(f"{'written' if written else 'unchanged'}: {path}")


def _shell(option: str, arguments: Sequence[str]) -> str:
    """The shell that is named, or that of the user."""
    if len(arguments) > 1:
        raise UsageError(f"robustlab {option}", f"{len(arguments)} words", "one shell at most")
    login = Path(os.environ.get("SHELL", "")).name
    shell = arguments[0] if arguments else login
    if shell not in SHELLS:
        found = f"no completion for {shell!r}" if shell else "no shell, and $SHELL is not set"
        raise UsageError(f"robustlab {option}", found, f"one of {', '.join(SHELLS)}")
    return shell


def _script(shell: str) -> str:
    os.environ[COMPLETING] = f"source_{shell}"
    told = io.StringIO()
    with redirect_stdout(told):
        complete()
    return told.getvalue().strip()


def _places(shell: str) -> tuple[Path, Path | None, str]:
    """File of the script, file that the shell reads at its start, and the line in it; where typer puts its own."""
    home = Path.home()
    if shell == "bash":
        script = home / ".bash_completions" / "robustlab.sh"
        return script, home / ".bashrc", f"source {shlex.quote(str(script))}"
    if shell == "zsh":
        start = Path(os.environ.get("ZDOTDIR") or home) / ".zshrc"
        return home / ".zfunc" / "_robustlab", start, "fpath+=~/.zfunc; autoload -Uz compinit; compinit"
    settings = Path(os.environ.get("XDG_CONFIG_HOME") or home / ".config")
    return settings / "fish" / "completions" / "robustlab.fish", None, ""
