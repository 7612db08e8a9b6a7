"""MuJoCo as the judge: the twin, cross-checks, closed loops and their figures."""

from validation import paper
from validation.closed_loop import simulate
from validation.crosscheck import crosscheck
from validation.log import Log
from validation.state_map import StateMap
from validation.twin import Twin

__all__ = ["Log", "StateMap", "Twin", "crosscheck", "paper", "simulate"]
