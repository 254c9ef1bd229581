"""``robustlab data``: check, convert and compare measured records; identify missing effects, validate a set."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

import robustlab as rl
from robustlab.cli.console import FIGURE, SCHEMA, emit, note, save_figures, shown
from robustlab.cli.generated import AS_JSON, PROGRESS, READ, Options, add_commands, provenance_of, read_record, taking
from robustlab.errors import EnvironmentFault

if TYPE_CHECKING:
    from robustlab.identification.missing_effects.discovery_result import Discovery
    from robustlab.provenance import Provenance

PLANT_FILE, EXPERIMENT_FILE = "updated-plant.h5", "next-experiment.csv"

app = typer.Typer()


@app.command()
@taking(*READ["record"], AS_JSON, PROGRESS)
def convert(
    source: Annotated[str, typer.Argument(help="HDF5, MATLAB, CSV or TXT file.", metavar="IN")],
    target: Annotated[str, typer.Argument(help="HDF5 file to write.", metavar="OUT")],
    as_json: bool,
    progress: str,
    **reading: Any,
) -> None:
    """Write a record as HDF5, format 1.

    Example: robustlab data convert run3.csv run3.h5 --inputs u --outputs q --unit q=rad
    """
    with shown(progress, "data convert"):
        record = read_record(source, reading, reading["inputs"])
        rl.save(target, record, provenance_of("data convert", [source], {}))
    emit("data convert", {"from": source, "to": target, "samples": record.n}, f"{target}: {record!r}", as_json)


FILES: Options = (
    ("figures", str | None, typer.Option("--figure", metavar="PATH", help=FIGURE), None),
    ("folder", str | None, typer.Option("--out", "-o", metavar="PATH", help="Folder for report, result, figures and"
     " updated plant."), None),
    ("details", bool, typer.Option("--details", help="Print the details of the answer, too."), False),
)  # fmt: skip


def _discovered(
    found: Discovery, values: Mapping[str, Any], options: Mapping[str, Any], files: list[str]
) -> tuple[Mapping[str, Any], str]:
    result = {"model": options["named"]["plant"], **found.to_json()}
    origin, written = provenance_of("data discover", files, values), list[str]()
    if options["figures"] or options["folder"]:
        options["report"]("figures and files")
    if options["figures"]:
        from robustlab.report.drawings import pictures_of

        written += save_figures(dict(pictures_of(found)), options["figures"])
    if options["folder"]:
        written += _fill_folder(found, result, Path(options["folder"]), origin)
    for file in written:
        note(f"wrote {file}")
    if found.interrupted:
        note("interrupted: the result contains what was found until then")
    elif not found.status.trustworthy:
        incomplete = ("named, incomplete", "more than half of the error is unexplained")
        whole = (found.verdict, "no single effect is identified")
        verdict, why = incomplete if found.verdict == "named" else whole
        note(f"the verdict is {verdict!r}: {why} (exit code 4)")
    text = found.report() if options["details"] else found.summary()
    return {**result, "files": written}, f"{found.headline()}.\n{text}"


def _fill_folder(found: Discovery, result: Mapping[str, Any], folder: Path, origin: Provenance) -> list[str]:
    from robustlab.files.atomic import atomic_write
    from robustlab.report.discovery import write_page
    from robustlab.result import plain

    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        reason = error.strerror or type(error).__name__
        raise EnvironmentFault(str(folder), f"cannot be made ({reason})", "a folder to write results into") from error
    files = [*map(str, write_page(found, folder, origin))]
    if found.model is not None:
        files.append(str(rl.save(folder / PLANT_FILE, found.model, origin)))
    if found.next_experiment is not None:
        files.append(str(found.next_experiment.save(folder / EXPERIMENT_FILE)))
    data = {"schema": SCHEMA, "command": "data discover", **plain(result), "provenance": plain(origin.to_json())}
    text = json.dumps(data, indent=1, allow_nan=False, ensure_ascii=False)
    target = folder / "result.json"
    atomic_write(target, lambda temporary: temporary.write_text(text, encoding="utf-8"))
    return [*files, str(target)]


add_commands(app, "data", "data", extended={"data discover": (FILES, _discovered)})
