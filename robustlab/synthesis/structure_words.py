"""Structures of controllers in words, for commands and recipes: ``pid``, ``order:3``, ``ipd:full``, ..."""

from __future__ import annotations

from typing import Any

from robustlab.errors import InputError, did_you_mean
from robustlab.synthesis.controller_structures import Decentralised, FixedPoles, MultichannelPID, as_structure
from robustlab.synthesis.design_problem import common_scaling
from robustlab.synthesis.partition import GeneralizedPlant

__all__ = ["WORDS", "structure_in_words"]

WORDS = ("static", "p", "i", "pi", "pd", "pid", "ipd", "two-layer", "order", "poles", "decentralised")
GAINS = ("full", "diagonal", "scalar")


def structure_in_words(text: str, plant: GeneralizedPlant) -> Any:
    """A structure for the channels of a plant, as `robustlab.fixed_structure` takes it.

    Parameters
    ----------
    text
        ``static``; ``p``, ``i``, ``pi``, ``pd``, ``pid`` (one per channel); ``order:N``; ``poles:-1,-20`` (rad/s);
        ``ipd`` and ``two-layer``, the thesis' laws, with ``:full``, ``:diagonal`` or ``:scalar`` gains;
        ``decentralised:WORD``, the same structure for every channel by itself.
    plant
        Its channels, and its time scale for the filters of derivatives.

    Raises
    ------
    InputError
        An unknown word, a number that is none.

    Examples
    --------
    >>> from robustlab.statespace import StateSpaceModel
    >>> plant = GeneralizedPlant(StateSpaceModel([[-1.0]], [[1.0]], [[1.0]], [[0.0]]), 1, 1)
    >>> structure_in_words("order:2", plant)
    2
    """
    where = f"structure {text!r}"
    word, _, rest = text.strip().lower().partition(":")
    if word not in WORDS:
        raise InputError(where, "unknown", f"one of {', '.join(WORDS)}", did_you_mean(word, WORDS))
    if word == "order":
        return _order(where, rest)
    if word == "poles":
        return FixedPoles(_poles(where, rest))
    if word in ("ipd", "two-layer"):
        gains = rest or "full"
        if gains not in GAINS:
            raise InputError(where, f"gains {gains!r}", f"one of {', '.join(GAINS)}", did_you_mean(gains, GAINS))
        return MultichannelPID(word, gains)
    if word == "decentralised":
        rate = common_scaling([plant])[0].rate
        part = as_structure(structure_in_words(rest, plant), rate)
        return Decentralised([part] * len(plant.controls))
    if rest:
        raise InputError(where, f"{rest!r} after {word}", "nothing")
    return word


def _order(where: str, text: str) -> int:
    if not text.isdigit() or int(text) > 1000:
        raise InputError(where, f"{text!r}", "a whole number from 0 to 1000: order:3")
    return int(text)


def _poles(where: str, text: str) -> list[complex]:
    try:
        return [complex(part.strip()) for part in text.split(",")]
    except ValueError:
        raise InputError(where, f"{text!r}", "numbers: poles:-1,-20 or poles:-1+2j,-1-2j") from None
