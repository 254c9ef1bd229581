"""``robustlab verify``: re-verify results from their files, by an independent program."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from robustlab.cli.console import emit, shown
from robustlab.cli.generated import JsonOption, ProgressOption

app = typer.Typer(help="Verify files of results.", add_completion=False)


@app.command()
def verify(
    files: Annotated[list[str], typer.Argument(help="HDF5 files of results, or folders of runs.", metavar="FILE")],
    effort: Annotated[float, typer.Option("--effort", help="Work allowed, as a multiple of the usual.")] = 1.0,
    progress: ProgressOption = "auto",
    as_json: JsonOption = False,
) -> None:
    """Verify the claims of a result from its file alone: in exact and ball arithmetic, for all frequencies.

    Exit code 0: all claims were proved, and the file displays the same numbers. 4: something was not proved, or
    the file is not the one that its claims were written with. 1: a claim was refuted by a counterexample.

    Example: robustlab verify out/first-light
    """
    import robustlab as rl
    from robustlab.errors import EXIT_REQUIREMENT_NOT_MET, InputError, NoTrustworthyNumber
    from robustlab.verification.files import claims_in_file

    chosen = {path: claims_in_file(path) for given in files for path in _files_in(given)}
    holding = {path: claims for path, claims in chosen.items() if claims}
    if not holding:
        hint = "files of earlier versions hold none; docs/proved.md says which results have them"
        raise InputError(", ".join(files), "no claims", "results that were saved with their evidence", hint)
    found: dict[str, Any] = {}
    with shown(progress, "verify", len(holding), budgets=False) as display:
        for done, path in enumerate(holding):
            display.step(done, str(path))
            found[str(path)] = rl.verify(path, effort=effort)
    rows: list[str] = []
    for name, one in found.items():
        rows += [f"{name}: {one.headline()}", *(f"  {label}: {text}" for label, text in one.facts() if text)]
    rows += [f"{path}: no claims" for path in chosen if path not in holding]
    emit("verify", {"files": {name: one.to_json() for name, one in found.items()}}, "\n".join(rows), as_json)
    if any(one.refuted for one in found.values()):
        raise typer.Exit(EXIT_REQUIREMENT_NOT_MET)
    if not all(one.proved for one in found.values()):
        raise typer.Exit(NoTrustworthyNumber.exit_code)


def _files_in(given: str) -> list[Path]:
    path = Path(given)
    if not path.is_dir():
        return [path]
    from robustlab.errors import InputError

    found = sorted([*path.glob("evidence/*.h5")] or [*path.glob("*.h5")])
    if not found:
        raise InputError(given, "a folder without HDF5 files", "a file of a result, or the folder of a run")
    return found
