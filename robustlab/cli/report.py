"""``robustlab report``: write the report of a finished run again."""

from __future__ import annotations

from typing import Annotated

import typer

from robustlab.cli.console import emit
from robustlab.cli.options import JsonOption

app = typer.Typer(help="Write the report of a finished run again.")


@app.command()
def report(
    run_dir: Annotated[str, typer.Argument(help="The folder that robustlab run wrote.", show_default=False)],
    as_json: JsonOption = False,
) -> None:
    """Write report.html and junit.xml again from result.json and figures of a finished run; nothing is computed again.

    Example: robustlab report out/first-light
    """
    from pathlib import Path

    from robustlab.recipe.run import read_result, write_report

    folder = Path(run_dir)
    write_report(read_result(folder), folder)
    files = [str(folder / name) for name in ("report.html", "junit.xml")]
    emit("report", {"files": files}, "\n".join(files), as_json)
