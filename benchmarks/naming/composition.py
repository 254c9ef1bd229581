"""Cases of a data set: every class of six families once, pairs, nothing, outside, poor excitation."""

from __future__ import annotations

import random
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from hidden import FAMILIES, Family, NothingInCommon, make_case, merged

from robustlab.dynamics import KIND_OF

CONDITIONS = ("single", "pair", "nothing", "outside", "poor")
RICH = ("rich", "multisine", "square", "oneway", "steps")  # excitations under which nothing is missing
POOR = ("square", "oneway")
AGAIN = 20  # seeds that are tried
PAIRS, OUTSIDE, POOR_ONES = 8, 4, 5  # cases a family; singles: every class


@dataclass(frozen=True)
class Entry:
    """A case before it is drawn."""

    id: str
    family: str
    condition: str
    excitation: str
    effects: tuple[str, ...]
    seed: int


def composition(seed: int) -> tuple[Entry, ...]:
    """Return all cases of the data set of this seed, which determines all draws."""
    draw = random.Random(seed)
    rows = [(name, *row) for name, family in FAMILIES.items() for row in _of_family(family, draw)]
    draw.shuffle(rows)  # a program that reads them in order, or a part of them, sees a fair sample
    return tuple(
        Entry(f"{k:04d}", family, condition, excitation, effects, seed * 10_000 + k)
        for k, (family, condition, excitation, effects) in enumerate(rows, 1)
    )


def _of_family(family: Family, draw: random.Random) -> Iterator[tuple[str, str, tuple[str, ...]]]:
    for name in family.classes:
        yield "single", "rich", (name,)
    for pair in draw.sample(family.pairs, PAIRS):
        yield "pair", "rich", pair
    for excitation in RICH:
        yield "nothing", excitation, ()
    for name in draw.sample(family.outside, OUTSIDE):
        yield "outside", "rich", (name,)
    for k, name in enumerate(draw.sample(family.classes, POOR_ONES)):
        yield "poor", POOR[k % len(POOR)], (name,)


def drawn(entry: Entry) -> Any:
    """Return the case (`hidden.Case`); from a later seed if the records of this one do not both show the effect."""
    family = FAMILIES[entry.family]
    for seed in range(entry.seed, entry.seed + AGAIN * 1_000_000, 1_000_000):
        try:
            return make_case(
                entry.effects or "none", seed, plant=family.plant, current=family.current, excitation=entry.excitation
            )
        except NothingInCommon:
            continue
    raise NothingInCommon(f"case {entry.id}: no seed of {AGAIN} draws it")


def accepted(entry: Entry) -> list[list[str]]:
    """Return the accepted sets of kinds, with all alternatives that no record of the family distinguishes."""
    if entry.condition == "outside":
        return []
    twins = FAMILIES[entry.family].twins
    ways: list[list[str]] = [[]]
    for effect in entry.effects:
        same = [[effect]] + [list(merged(twins, [effect]))] * (effect in twins)
        same += [[other] for other, names in twins.items() if names == (effect,)]
        ways = [way + names for way in ways for names in same]
    return [list(way) for way in sorted({tuple(sorted(KIND_OF[name] for name in way)) for way in ways})]
