"""Shell completion, with typer's protocol and scripts.

At TAB the script calls robustlab with the words so far in environment variables; only the group named there is loaded.
"""

from __future__ import annotations

from typing import Annotated, Any

import typer
from typer.core import TyperCommand, TyperGroup
from typer.main import get_command

from robustlab.cli.exit_codes import answer
from robustlab.cli.groups import GROUPS, parser

# Set by the shell's script; typer derives it from the program's name.
COMPLETING = "_ROBUSTLAB_COMPLETE"


class _Commands(TyperGroup):
    """The table of groups for typer; a group's parser is made when its words are completed."""

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
    """Declare the options of the top level for completion; `main` reads them."""


def complete() -> int:
    """Print the completions of the word at the cursor."""
    return answer(lambda: get_command(_top).main([], prog_name="robustlab", complete_var=COMPLETING))


def install_or_show(option: str) -> int:
    """Run typer's ``--install-completion`` or ``--show-completion`` for the calling shell."""
    return answer(lambda: get_command(_top).main([option], prog_name="robustlab"))
