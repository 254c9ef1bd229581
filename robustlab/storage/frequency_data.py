"""Uncertain frequency responses in a file: M at every frequency beside the blocks of Delta."""

from __future__ import annotations

import numpy as np

from robustlab.errors import InputError
from robustlab.files.tree import Tree, Unread
from robustlab.storage.matrices import Problems, decode_signals, encode_signals, entries, find_children
from robustlab.storage.uncertain_models import decode_blocks, encode_blocks
from robustlab.uncertainty.frequency_responses import UncertainFrequencyData


def encode_frequency_data(tree: Tree, data: UncertainFrequencyData) -> None:
    """Datasets ``omega`` and ``M``, group ``blocks`` as of an uncertain model, ``signals``."""
    tree.put("omega", np.asarray(data.omega, dtype=np.float64))
    tree.put("M", np.asarray(data.M, dtype=np.complex128))
    encode_blocks(tree, data.blocks)
    encode_signals(tree, ((), data.inputs, data.outputs))


def decode_frequency_data(tree: Tree, problems: Problems, _transpose: bool = False) -> UncertainFrequencyData:
    """Inverse of `encode_frequency_data`. Raises InputError: with all that is missing or does not fit."""
    find_children(tree, ("omega", "M"), problems, kind="dataset")
    find_children(tree, ("blocks",), problems, kind="group")
    omega = entries(tree, "omega", "fi", problems) if "omega" in tree.datasets else None
    values = tree.datasets["M"].values if "M" in tree.datasets else None
    if isinstance(values, Unread) or (values is not None and values.dtype.kind not in "fic"):
        problems.add(f"{tree.child_path('M')} is not readable as complex numbers")
    blocks = decode_blocks(tree.groups["blocks"], problems) if "blocks" in tree.groups else ()
    _, inputs, outputs = decode_signals(tree, problems)
    problems.raise_any()
    assert omega is not None
    assert isinstance(values, np.ndarray)
    try:
        return UncertainFrequencyData(omega, values, blocks, inputs, outputs)
    except InputError as error:
        raise InputError(problems.file, f"{error.where}: {error.found}", error.expected, error.hint) from None
