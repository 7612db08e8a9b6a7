"""Distances between a robot's links and the obstacles around it, as barriers b(q) ≥ 0.

- `solids`: the links' shapes and the obstacles as convex bodies;
- `nearest`: the distance of two convex bodies, by Coal;
- `clearance`: distances of many pairs at a State, with gradient and drift;
- `obstacles`: half-spaces, balls, boxes and pairs of links as barriers;
- `surroundings`: obstacles of a TOML file.
"""

from softdyn.safety.obstacles import HalfSpace, KeepOutBox, KeepOutSphere, LinkPairs
from softdyn.safety.surroundings import Surroundings

__all__ = ["HalfSpace", "KeepOutBox", "KeepOutSphere", "LinkPairs", "Surroundings"]
