# SPDX-License-Identifier: CC0-1.0
"""Seeded random numbers that are the same on every machine.

`stream(seed, *names)` gives an independent `random.Random` per named object, so
that changing one object does not reshuffle the others. `uniform_array` gives
many numbers at once from integer arithmetic alone (SplitMix64): no numpy.random,
whose streams may change between versions.
"""
import random

import numpy as np


def stream(seed, *names):
    """An independent random.Random for the object called `names`."""
    return random.Random("/".join(["vshift-street", str(seed)] + [str(n) for n in names]))


def uniform_array(rng, count, low=0.0, high=1.0):
    """`count` float64 numbers in [low, high), started from one number of `rng`."""
    start = np.uint64(int(rng.random() * (1 << 52)))
    with np.errstate(over="ignore"):
        z = start + np.arange(1, count + 1, dtype=np.uint64) * np.uint64(0x9E3779B97F4A7C15)
        z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
        z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
        z = z ^ (z >> np.uint64(31))
    return low + (high - low) * ((z >> np.uint64(11)).astype(np.float64) / float(1 << 53))


def pick(rng, items):
    """One of `items`, by a single random() call."""
    return items[min(int(rng.random() * len(items)), len(items) - 1)]


def shuffled(rng, items):
    """A shuffled copy, by random() calls only (random.shuffle has changed over time)."""
    keyed = [(rng.random(), i) for i in range(len(items))]
    return [items[i] for _, i in sorted(keyed)]


def directions(rng, count):
    """(count, 3) unit vectors, evenly spread; only sqrt, which is exact everywhere."""
    # Rejection in the cube: about 52 % of the tries fall inside the ball.
    tries = int(count * 2.4) + 32
    p = uniform_array(rng, tries * 3, -1.0, 1.0).reshape(-1, 3)
    r2 = (p * p).sum(1)
    p = p[(r2 < 1.0) & (r2 > 1e-3)][:count]
    while len(p) < count:
        p = np.concatenate([p, p[: count - len(p)]])
    return p / np.sqrt((p * p).sum(1))[:, None]
