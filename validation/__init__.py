"""MuJoCo as the judge: the twin, cross-checks, closed loops and their figures."""

from softdyn.validation.crosschecks.crosscheck import crosscheck
from softdyn.validation.loop.closed_loop import simulate
from softdyn.validation.loop.log import Log
from softdyn.validation.studies import paper
from softdyn.validation.twin.state_map import StateMap
from softdyn.validation.twin.twin import Twin

__all__ = ["Log", "StateMap", "Twin", "crosscheck", "paper", "simulate"]
