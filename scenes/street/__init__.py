# SPDX-License-Identifier: CC0-1.0
"""A seeded procedural street in pure Python and NumPy.

    from street import generate
    street = generate(seed=1, detail=2, length_m=240.0, traffic=1.0)

World: x along the street, y left, z up, road at z = 0, right-hand traffic.
"""
from .layout import generate
from .scene import DETAIL_LEVELS, Instance, Mover, Part, Street, ego_gap

__all__ = ["generate", "DETAIL_LEVELS", "Street", "Part", "Instance", "Mover", "ego_gap"]
