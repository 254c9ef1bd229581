"""Controllers in a file, with what they take."""

from __future__ import annotations

import numpy as np

from robustlab.evidence import claims_of
from robustlab.files.tree import Tree
from robustlab.result import Status
from robustlab.storage.matrices import Problems, decode_model, encode_model
from robustlab.storage.results import encode_claims
from robustlab.synthesis.problem.controller import Controller


def encode_controller(tree: Tree, controller: Controller) -> None:
    """K as a state-space model; ``gamma``, ``status``, ``method`` as attributes; the claims of its design."""
    encode_model(tree, controller.K)
    tree.attrs.update(status=controller.status.value, method=controller.method)
    if controller.gamma is not None:
        tree.attrs["gamma"] = controller.gamma
    claims = claims_of(controller.design)
    own = {f"K_{letter}": getattr(controller.K, letter) for letter in "ABCD"}
    if any(all(np.array_equal(claim.numbers.get(name, np.nan), X) for name, X in own.items()) for claim in claims):
        encode_claims(tree, claims)


def decode_controller(tree: Tree, problems: Problems, transpose: bool = False) -> Controller:
    """Inverse of `encode_controller`. Raises InputError: with all that is missing or does not fit."""
    model = decode_model(tree, problems, transpose)
    gamma = None
    if "gamma" in tree.attrs:
        value = np.asarray(tree.attrs["gamma"])
        if value.dtype.kind in "fi" and value.size == 1:
            gamma = float(value.flat[0])
        else:
            problems.add("attribute gamma is not one real number")
    text = str(np.asarray(tree.attrs.get("status", Status.INCONCLUSIVE.value)))
    if text not in [status.value for status in Status]:
        problems.add(f"attribute status is {text!r}, expected one of {', '.join(s.value for s in Status)}")
    problems.raise_any()
    assert model is not None
    return Controller(model, gamma, Status(text), str(np.asarray(tree.attrs.get("method", ""))))
