"""Which function writes an object of a class, and which reads a file of a kind: one table, each imported where met.

What a file holds is known by its kind, what an object is by the names of its class and of those beneath it: neither
needs the class itself. So a process loads what it reads and writes, and nothing beside it.
"""

from __future__ import annotations

from dataclasses import dataclass
from importlib import import_module
from typing import Any

from robustlab.files.tree import Tree
from robustlab.storage.matrices import Problems


@dataclass(frozen=True)
class Codec:
    """One kind of file of format 1, and the class whose objects it holds."""

    kind: str
    # Where the class, and the two functions of this room, are: a module's path and a name in it.
    type: str
    encode: str  # (tree, object)
    decode: str  # (tree, problems, transpose) -> object; `transpose` is for matrices in groups of their own

    def write(self, tree: Tree, obj: Any) -> None:
        """Put an object into a tree. Raises InputError: what the format has no place for."""
        _found(f"storage.{self.encode}")(tree, obj)

    def read(self, tree: Tree, problems: Problems, transpose: bool = False) -> Any:
        return _found(f"storage.{self.decode}")(tree, problems, transpose)


CODECS = (
    Codec("state-space", "statespace.StateSpaceModel", "matrices.encode_model", "matrices.decode_state_space"),
    Codec(
        "uncertain",
        "uncertainty.lft.UncertainModel",
        "uncertain_models.encode_uncertain",
        "uncertain_models.decode_uncertain",
    ),
    Codec("delayed", "delays.model.DelayedModel", "delayed_models.encode_delayed", "delayed_models.decode_delayed"),
    Codec(
        "frequency-data",
        "uncertainty.frequency_responses.UncertainFrequencyData",
        "frequency_data.encode_frequency_data",
        "frequency_data.decode_frequency_data",
    ),
    Codec(
        "lpv",
        "synthesis.scheduling.parameter_varying.LPVModel",
        "scheduled_models.encode_lpv",
        "scheduled_models.decode_lpv",
    ),
    Codec(
        "lpv-controller",
        "synthesis.scheduling.parameter_varying.LPVController",
        "scheduled_models.encode_lpv_controller",
        "scheduled_models.decode_lpv_controller",
    ),
    Codec(
        "controller",
        "synthesis.problem.controller.Controller",
        "controllers.encode_controller",
        "controllers.decode_controller",
    ),
    Codec("record", "record.Record", "records.encode_record", "records.decode_record"),
    Codec("plant", "dynamics.plant_contract.Plant", "plants.encode_plant", "plants.decode_plant"),
    Codec("result", "result.Result", "results.encode_result", "results.decode_result"),
)
BY_KIND = {codec.kind: codec for codec in CODECS}
_BY_TYPE = {f"robustlab.{codec.type}": codec for codec in CODECS}


def codec_of(obj: Any) -> Codec | None:
    """The codec of an object's class, or of the nearest one that it inherits from; None where files know none."""
    names = (f"{cls.__module__}.{cls.__qualname__}" for cls in type(obj).__mro__)
    return next((_BY_TYPE[name] for name in names if name in _BY_TYPE), None)


def _found(place: str) -> Any:
    module, name = place.rsplit(".", 1)
    return getattr(import_module(f"robustlab.{module}"), name)
