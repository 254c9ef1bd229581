r"""The uniform numbers of many samples at once, bit for bit those of a generator for each of them.

Sample i has the numbers of ``Generator(PCG64(SeedSequence(seed, spawn_key=(i,)))).uniform(-1, 1, d)``. To make that
generator takes longer than its numbers, and all samples share the seed: here the words of many indices are mixed into
the seed's pool together, and all numbers follow from

.. math:: s_j = M^{j + 2} (c + a) + (1 + M + ... + M^{j + 1}) c \mod 2^{128}

with the start a and the increment c of a sample, a linear congruence that need not be gone through step by step.

References
----------
O'Neill, "PCG: A family of simple fast space-efficient statistically good algorithms for random number generation"
(2014), XSL-RR 128/64; numpy's `SeedSequence`, whose streams numpy guarantees to stay (NEP 19).
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from robustlab.arrays import Array

__all__ = ["uniform_numbers"]

Words = NDArray[np.uint32]
Longs = NDArray[np.uint64]

# The constants of numpy's SeedSequence, and of the generator.
POOL, SHIFT = 4, np.uint32(16)
INIT_A, MULT_A, INIT_B, MULT_B = 0x43B0D7E5, 0x931E8875, 0x8B51F9DD, 0x58F38DED
MIX_LEFT, MIX_RIGHT = np.uint32(0xCA01F9DD), np.uint32(0x4973F715)
MULTIPLIER = 0x2360ED051FC65DA44385DF649FCCF645
WORD, HALF, LOW_HALF = 2**32 - 1, np.uint64(32), np.uint64(2**32 - 1)
# Numbers made at a time, so that the arrays on the way stay in the cache.
STRETCH = 8_192


def uniform_numbers(seed: int, indices: NDArray[np.integer], count: int) -> Array:
    """The first ``count`` numbers in [-1, 1) of some samples, shape (k, count).

    Examples
    --------
    >>> one = np.random.Generator(np.random.PCG64(np.random.SeedSequence(7, spawn_key=(3,)))).uniform(-1, 1, 2)
    >>> bool((uniform_numbers(7, np.array([3]), 2)[0] == one).all())
    True
    """
    found = np.empty((len(indices), count))
    step = max(1, STRETCH // max(1, count))
    for first in range(0, len(indices), step):
        part = slice(first, first + step)
        found[part] = _numbers(_start(seed, indices[part].astype(np.uint64)), count)
    return found


class _Wide(NamedTuple):
    """Numbers of 128 bits, as two of 64."""

    high: Longs
    low: Longs

    @classmethod
    def of(cls, values: list[int]) -> _Wide:
        high, low = ([v >> 64 for v in values], [v & (2**64 - 1) for v in values])
        return cls(np.array(high, dtype=np.uint64), np.array(low, dtype=np.uint64))

    def plus(self, other: _Wide) -> _Wide:
        low = self.low + other.low
        return _Wide(self.high + other.high + (low < self.low), low)

    def times(self, other: _Wide) -> _Wide:
        """The product modulo 2^128, from those of halves of 32 bits."""
        (a, b), (c, d) = ((n.low >> HALF, n.low & LOW_HALF) for n in (self, other))
        below, cross = b * d, a * d
        middle = b * c + (below >> HALF) + (cross & LOW_HALF)
        high = a * c + (cross >> HALF) + (middle >> HALF) + self.high * other.low + self.low * other.high
        return _Wide(high, (middle << HALF) | (below & LOW_HALF))


def _start(seed: int, indices: Longs) -> tuple[_Wide, _Wide]:
    """Start a and increment c of the samples' generators, each (k, 1)."""
    pool = [np.full(len(indices), word, dtype=np.uint32) for word in np.random.SeedSequence(seed).pool]
    # What the seed's own words have made of the constant: each is hashed once for every place of the pool.
    more = max(0, -(-int(seed).bit_length() // 32) - POOL)
    constant = INIT_A * pow(MULT_A, POOL**2 + POOL * more, 2**32) & WORD
    words = [(indices & LOW_HALF).astype(np.uint32), (indices >> HALF).astype(np.uint32)]
    for place, word in enumerate(words):
        mixed = []
        for before in pool:
            hashed, constant = _hashed(word, constant, MULT_A)
            both = MIX_LEFT * before - MIX_RIGHT * hashed
            mixed.append(both ^ (both >> SHIFT))
        # An index below 2^32 has no second word.
        pool = [np.where(word != 0, new, old) for new, old in zip(mixed, pool, strict=True)] if place else mixed
    constant, state = INIT_B, []
    for k in range(2 * POOL):
        hashed, constant = _hashed(pool[k % POOL], constant, MULT_B)
        state.append(hashed.astype(np.uint64)[:, None])
    high, low, high_c, low_c = (state[k] | (state[k + 1] << HALF) for k in range(0, 2 * POOL, 2))
    one = np.uint64(1)
    return _Wide(high, low), _Wide((high_c << one) | (low_c >> np.uint64(63)), (low_c << one) | one)


def _hashed(value: Words, constant: int, multiplier: int) -> tuple[Words, int]:
    """A word hashed with the running constant, and the next of that."""
    following = constant * multiplier & WORD
    value = (value ^ np.uint32(constant)) * np.uint32(following)
    return value ^ (value >> SHIFT), following


def _numbers(generators: tuple[_Wide, _Wide], count: int) -> Array:
    """The numbers of generators, (k, count)."""
    start, increment = generators
    powers, sums = _jumps(count)
    high, low = powers.times(increment.plus(start)).plus(sums.times(increment))
    turn, word = high >> np.uint64(58), high ^ low
    word = (word >> turn) | (word << (-turn & np.uint64(63)))
    return -1.0 + 2.0 * ((word >> np.uint64(11)) * 2.0**-53)


@lru_cache(maxsize=8)
def _jumps(count: int) -> tuple[_Wide, _Wide]:
    """``M^(j + 2)`` and ``1 + M + ... + M^(j + 1)`` for the states of the first numbers, each (count,)."""
    powers, sums, power, total = [], [], MULTIPLIER, 1
    for _ in range(count):
        total, power = (total + power) % 2**128, power * MULTIPLIER % 2**128
        powers.append(power)
        sums.append(total)
    return _Wide.of(powers), _Wide.of(sums)
