"""Controllers for other programs: C99 source, JSON, MATLAB; robustlab's own format is `robustlab.storage.save`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from robustlab.dynamics.plant_contract import Plant
from robustlab.errors import InputError, UsageError
from robustlab.files.atomic import atomic_write
from robustlab.provenance import Provenance
from robustlab.statespace import as_model
from robustlab.storage.controller_code import c_source, saturation_limits
from robustlab.storage.controller_json import controller_to_json
from robustlab.storage.interchange import save
from robustlab.synthesis.problem.design import Controller
from robustlab.uncertainty.lft import UncertainModel

EXPORTS = (".c", ".json", ".mat", ".h5", ".hdf5")


def export_controller(
    path: str | Path,
    controller: Any,
    *,
    prefix: str = "controller",
    saturation: Any = None,
    anti_windup: Any = None,
    provenance: Provenance | None = None,
) -> Path:
    r"""Write a controller ``u = K y`` for another program; the extension of the file says which.

    ``.c``
        C99 without allocation: a struct of state, ``<prefix>_init`` and ``<prefix>_step``. The sample time, the names,
        units and signs of all signals, and what the first samples must be, stand in the comment at the top; every
        number is exact (hexadecimal).
    ``.json``
        Matrices, sample time, signals with units, what was verified, provenance; numbers as their shortest exact
        decimals. `robustlab.load` reads it back.
    ``.mat``, ``.h5``
        As `robustlab.save` writes them.

    Parameters
    ----------
    path
        File to write; replaced once the new one is complete.
    controller
        Controller, a synthesis result, or a model with n states; discrete for ``.c``.
    prefix
        Of the C names.
    saturation
        ``(low, high)`` of all control signals, or a mapping by name; the C step holds its outputs between them,
        with back-calculation against windup (`robustlab.synthesis.windup.back_calculation`).
    anti_windup
        For ``.c`` with a saturation: time in s within which, during saturation, all modes of the controller decay. Ten
        samples where left out; inf leaves a stable controller's states alone. Or the gain itself, (n, p), such as that
        of `anti_windup`.
    provenance
        Where it comes from; time and versions of now where left out.

    Returns
    -------
    Path
        The file that was written.

    Raises
    ------
    UsageError
        Another extension, or a saturation or an anti-windup time where there is no place for it.
    InputError
        A continuous controller for ``.c``, limits or a prefix that are none, an anti-windup time below a sample, a slow
        mode that back-calculation cannot move.
    EnvironmentFault
        Disk full, no permission; the previous file is kept.
    """
    suffix = Path(path).suffix.lower()
    if suffix not in EXPORTS:
        raise UsageError(str(path), f"extension {suffix or 'missing'!r}", ", ".join(EXPORTS))
    given = getattr(controller, "controller", controller)
    if isinstance(given, (UncertainModel, Plant)):
        raise InputError(str(path), f"a {type(given).__name__}", "a controller or a model")
    held = given if isinstance(given, Controller) else Controller(as_model(given, "export_controller"))
    if saturation is not None and suffix not in (".c", ".json"):
        raise UsageError(str(path), f"a saturation in a {suffix} file", "a .c or .json file")
    if anti_windup is not None and (saturation is None or suffix != ".c"):
        found = "an anti-windup time " + (f"in a {suffix} file" if suffix != ".c" else "without a saturation")
        raise UsageError(str(path), found, "a .c file with a saturation")
    limits = saturation_limits(held.K, saturation, "export_controller")
    origin = provenance or Provenance.now("export_controller")
    if suffix == ".c":
        text = c_source(held.K, prefix, limits, _notes(held, origin), anti_windup)
        return atomic_write(path, lambda temporary: temporary.write_text(text, encoding="ascii"))
    if suffix == ".json":
        text = json.dumps(controller_to_json(held, limits, origin), indent=1, allow_nan=False, ensure_ascii=True)
        return atomic_write(path, lambda temporary: temporary.write_text(text + "\n", encoding="ascii"))
    return save(path, held, origin)


def _notes(controller: Controller, origin: Provenance) -> list[str]:
    notes = ["Design method and verified norm are not stated by what it was written from."]
    if controller.method:
        gamma = "none" if controller.gamma is None else f"{controller.gamma:.6g}"
        notes = [f"Designed by {controller.method}, verified norm {gamma} ({controller.status})."]
    version = origin.versions.get("robustlab", "")
    notes.append(f"Written by robustlab {version} on {origin.created}, {origin.created_by} {origin.note}".rstrip())
    return [*notes, *(f"From {name}, sha256 {digest}" for name, digest in origin.inputs.items())]
