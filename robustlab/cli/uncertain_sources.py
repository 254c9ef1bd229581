"""Sources of ``robustlab uncertain build`` beside two models: a set of models, a discovery's updated plant."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, cast, get_args

from robustlab.cli.console import note, progress
from robustlab.errors import InputError, UsageError

if TYPE_CHECKING:
    from robustlab.dynamics.effects.effect_blocks import EffectBlocks
    from robustlab.mu_analysis.cover import Cover
    from robustlab.provenance import Provenance

__all__ = ["cover_of", "from_discovery"]


def cover_of(
    files: list[str],
    form: str,
    *,
    order: int,
    directions: int | None,
    tolerance: float | None,
    controller: str | None,
    time_limit: float | None,
    effort: float,
) -> tuple[Cover, Provenance]:
    """The cover of the models in the files, its worst gain in the loop of a controller where one is given."""
    from robustlab.mu_analysis.cover import cover
    from robustlab.provenance import Provenance, file_sha256
    from robustlab.statespace import as_model
    from robustlab.storage import load

    models = [as_model(load(path), path) for path in files]
    k = None if controller is None else as_model(load(controller), controller)
    loop = None if k is None else lambda g: g.feedback(k, 1)  # u = K y, positive feedback
    options: dict[str, Any] = {} if tolerance is None else {"tolerance": tolerance}
    with progress("cover") as advance:
        found = cover(
            models, form, directions=directions, order=order, loop=loop, time_limit=time_limit, effort=effort,
            progress=lambda text: advance(0, text), **options,
        )  # fmt: skip
    used = {path: file_sha256(path) for path in [*files, *([controller] if controller else [])]}
    return found, Provenance.now("uncertain build", used, note=f"{form} cover of {len(models)} models")


def from_discovery(
    path: str, outputs: list[str] | None, amplitude: dict[str, float], dry: str | None, pade: int
) -> tuple[EffectBlocks, Provenance]:
    """The blocks of an updated plant: a plant file, or the folder that ``data discover --out`` wrote."""
    from robustlab.cli.discovery_files import PLANT_FILE
    from robustlab.dynamics.effects.force_blocks import Dry
    from robustlab.identification.remaining_uncertainty import uncertain_from
    from robustlab.provenance import Provenance, file_sha256
    from robustlab.storage.plants import is_plant_file, load_plant

    file = str(Path(path) / PLANT_FILE) if Path(path).is_dir() else path
    if not is_plant_file(file):
        raise InputError(file, "no plant in it", f"{PLANT_FILE}, or the folder of: robustlab data discover --out DIR")
    if dry not in (None, *get_args(Dry)):
        raise UsageError("uncertain build", f"--dry {dry}", f"one of {', '.join(get_args(Dry))}")
    given = cast("Dry | None", dry)
    try:
        found = uncertain_from(load_plant(file), outputs, amplitude=amplitude, dry=given, pade=pade)
    except InputError as error:
        if "amplitude" in (error.expected or "") and error.hint:
            raise UsageError("uncertain build", error.found, "--amplitude NAME=VALUE for it", error.hint) from None
        raise
    for name, reason in found.left_out.items():
        note(f"not in it: {name}: {reason}")
    return found, Provenance.now("uncertain build", {file: file_sha256(file)}, note="discovery")
