"""Words completed by TAB: what a shell asks for, and the lines it loads to ask.

The protocol and the scripts are typer's: at TAB the script calls robustlab again with the words so far in environment
variables, and the parsers of the commands answer. As everywhere, only the group that is named is loaded.
"""

from __future__ import annotations

from typing import Annotated, Any

import typer
from typer.core import TyperCommand, TyperGroup
from typer.main import get_command

from robustlab.cli.ending import answer
from robustlab.cli.groups import GROUPS, parser

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


def install_or_show(option: str) -> int:
    """``--install-completion``, ``--show-completion``: typer's own, for the shell that this one was started by."""
    return answer(lambda: get_command(_top).main([option], prog_name="robustlab"))
