"""What ``robustlab data discover`` writes: report, result, figures, updated plant."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from robustlab.cli.console import SCHEMA, note
from robustlab.errors import EnvironmentFault, NoTrustworthyNumber

if TYPE_CHECKING:
    from robustlab.identification.discovery_result import Discovery
    from robustlab.provenance import Provenance

__all__ = ["checked_effects", "write_discovery"]

PLANT_FILE, EXPERIMENT_FILE = "updated-plant.h5", "next-experiment.csv"


def checked_effects(names: Sequence[str]) -> tuple[str, ...]:
    """The ids; an unknown one is refused with the nearest known one."""
    from robustlab.dynamics.effects.catalogue import effect

    return tuple(effect(name).id for name in names)


def write_discovery(
    found: Discovery,
    result: Mapping[str, Any],
    sources: Sequence[str],
    *,
    out: str | None,
    figures: str | None,
    model_out: str | None,
) -> list[str]:
    """Write what was asked for, with a note for each file; the paths.

    Parameters
    ----------
    result
        What ``--json`` prints, for ``result.json``.
    sources
        Files that were read (names that are no files, such as a plant's, are left out of the provenance).
    out
        Folder for ``report.html``, ``result.json``, ``figures/``, ``updated-plant.h5``, and ``next-experiment.csv``
        where one is proposed.
    """
    from robustlab.provenance import Provenance, file_sha256

    used = {source: file_sha256(source) for source in sources if Path(source).is_file()}
    provenance = Provenance.now("data discover", inputs=used)
    files: list[str] = []
    if figures:
        files += _figures(found, figures)
    if model_out:
        files.append(_plant(found, Path(model_out), provenance))
    if out:
        files += _folder(found, result, Path(out), provenance)
    for file in files:
        note(f"wrote {file}")
    return files


def _figures(found: Discovery, folder: str) -> list[str]:
    from robustlab.report.discovery_figures import discovery_figures
    from robustlab.report.figures import save_figure

    drawn = discovery_figures(found).items()
    return [str(path) for name, figure in drawn for path in save_figure(figure, folder, name)]


def _plant(found: Discovery, path: Path, provenance: Provenance) -> str:
    from robustlab.storage import save

    if found.model is None:
        raise NoTrustworthyNumber(str(path), "there is no updated plant to write")
    return str(save(path, found.model, provenance))


def _folder(found: Discovery, result: Mapping[str, Any], folder: Path, provenance: Provenance) -> list[str]:
    from robustlab.files.atomic import atomic_write
    from robustlab.report.discovery_report import write_page
    from robustlab.result import plain

    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        reason = error.strerror or type(error).__name__
        raise EnvironmentFault(str(folder), f"cannot be made ({reason})", "a folder to write results into") from error
    files = [*map(str, write_page(found, folder, provenance))]
    if found.model is not None:
        files.append(_plant(found, folder / PLANT_FILE, provenance))
    if found.next_experiment is not None:
        files.append(str(found.next_experiment.save(folder / EXPERIMENT_FILE)))
    data = {"schema": SCHEMA, "command": "data discover", **plain(result), "provenance": plain(provenance.to_json())}
    text = json.dumps(data, indent=1, allow_nan=False, ensure_ascii=False)
    target = folder / "result.json"
    atomic_write(target, lambda temporary: temporary.write_text(text, encoding="utf-8"))
    return [*files, str(target)]
