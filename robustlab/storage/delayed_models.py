"""Models with exact delays in a file: the model without them, and their lengths."""

from __future__ import annotations

import numpy as np

from robustlab.delays.model import DelayedModel
from robustlab.errors import InputError
from robustlab.files.tree import Tree
from robustlab.storage.matrices import Problems, decode_model, encode_model, entries, find_children


def encode_delayed(tree: Tree, model: DelayedModel) -> None:
    """Group ``H`` as a state-space model, dataset ``delays`` in s: those of its first inputs and outputs."""
    encode_model(tree.group("H"), model.H)
    tree.put("delays", np.asarray(model.delays, dtype=np.float64))


def decode_delayed(tree: Tree, problems: Problems, transpose: bool = False) -> DelayedModel:
    """Inverse of `encode_delayed`. Raises InputError: with all that is missing or does not fit."""
    find_children(tree, ("H",), problems, kind="group")
    find_children(tree, ("delays",), problems, kind="dataset")
    model = decode_model(tree.groups["H"], problems, transpose) if "H" in tree.groups else None
    lengths = entries(tree, "delays", "fi", problems) if "delays" in tree.datasets else None
    problems.raise_any()
    assert model is not None
    try:
        return DelayedModel(model, np.array(lengths, dtype=np.float64))
    except InputError as error:
        raise InputError(problems.file, f"{error.where}: {error.found}", error.expected, error.hint) from None
