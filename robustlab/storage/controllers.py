"""Controllers in a file, with what they take; what those of older files took, by their names."""

from __future__ import annotations

import re

import numpy as np

from robustlab.files.tree import Tree
from robustlab.result import Status
from robustlab.signals import Taken
from robustlab.statespace import StateSpaceModel
from robustlab.storage.matrices import Problems, decode_model, encode_model
from robustlab.synthesis.problem.controller import Controller

# How designs called what a controller takes, before its inputs said it themselves.
OLD_NAMES = (
    (re.compile(r"e (.+)|error (.+) measured"), "r - y"),
    (re.compile(r"(.+) reference(?: taken)?|(.+)_ref"), "r"),
    (re.compile(r"(.+) measured"), "y"),
)
# Those whose measurements are named by the plant: "e NAME" is a signal of it.
BY_PLANT = ("hinf", "h2", "h2-hinf", "dk", "fixed")
DESIGNED = re.compile(r"mixsyn|tune|lqg|lqr|lqi|ncf( with a reference model)?|cascade|(reduced|sampled) .+")


def encode_controller(tree: Tree, controller: Controller) -> None:
    """K as a state-space model; ``gamma``, ``status``, ``method`` as attributes."""
    encode_model(tree, controller.K)
    tree.attrs.update(status=controller.status.value, method=controller.method)
    if controller.gamma is not None:
        tree.attrs["gamma"] = controller.gamma


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
    method = str(np.asarray(tree.attrs.get("method", "")))
    return Controller(said_by_names(model, method), gamma, Status(text), method)


def said_by_names(K: StateSpaceModel, method: str) -> StateSpaceModel:
    """A controller of an older file, which does not say what it takes, with what its method and its names say.

    Designs called the error ``e NAME`` or ``error NAME measured``, a reference ``NAME reference (taken)`` or
    ``NAME_ref``, a signal itself ``NAME`` or ``NAME measured``. Of a controller by other hands nothing is known.
    """
    ours = method in BY_PLANT or DESIGNED.fullmatch(method)
    if not ours or any(isinstance(s, Taken) for s in K.inputs):
        return K
    inputs = []
    known = [(pattern, takes) for pattern, takes in OLD_NAMES if takes != "r - y" or method not in BY_PLANT]
    for name, unit in K.inputs:
        met = ((pattern.fullmatch(name), takes) for pattern, takes in known)
        takes, of = next(((t, next(filter(None, m.groups()))) for m, t in met if m), ("y", name))
        inputs.append(Taken(name, unit, takes, of))
    return K.renamed(inputs)
