from . import paper
from .crosschecks.crosscheck import crosscheck
from .live.playing import play
from .loop.log import Log
from .loop.simulate import simulate
from .mjcf.comparison.comparison import compare
from .studies.side_by_side import benchmark
from .twin.rig import Rig
from .twin.state_map import StateMap
from .twin.twin import Twin

__all__ = [
    "Log",
    "Rig",
    "StateMap",
    "Twin",
    "benchmark",
    "compare",
    "crosscheck",
    "paper",
    "play",
    "simulate",
]
