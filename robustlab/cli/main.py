"""The ``robustlab`` command."""

from __future__ import annotations

import sys
from typing import Annotated

import typer

from robustlab.cli.console import main_guard

app = typer.Typer(
    name="robustlab",
    help="Robust-control workbench: uncertain models, mu bounds, H-infinity synthesis, model against measurement.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)


def _version(wanted: bool) -> None:
    if wanted:
        from robustlab.provenance import robustlab_version

        print(robustlab_version())
        raise typer.Exit


@app.callback()
def robustlab(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version and leave.")
    ] = False,
) -> None:
    """Robust-control workbench. Exit codes: 0 done and all requirements met, 1 a stated requirement is not met, 2 usage,
    3 bad input, 4 no trustworthy number, 5 environment, 70 a bug, 130 interrupted.
    """  # noqa: D205


def main() -> None:
    """Entry point of the ``robustlab`` script."""
    sys.exit(main_guard(lambda: app(standalone_mode=False)))


if __name__ == "__main__":
    main()
