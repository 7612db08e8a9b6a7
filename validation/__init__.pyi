from . import paper
from .bench.drive import drive
from .crosschecks.crosscheck import crosscheck
from .live.playing import play
from .loop.certificate import certified
from .loop.log import Log
from .mjcf.comparison.comparison import compare
from .mjcf.scene import Scene
from .rollouts.rollout import rollout, rollouts
from .simulate import simulate
from .studies.side_by_side import benchmark
from .twin.rig import Rig
from .twin.settings import Integrator
from .twin.state_map import StateMap
from .twin.twin import Twin

__all__ = [
    "Integrator",
    "Log",
    "Rig",
    "Scene",
    "StateMap",
    "Twin",
    "benchmark",
    "certified",
    "compare",
    "crosscheck",
    "drive",
    "paper",
    "play",
    "rollout",
    "rollouts",
    "simulate",
]
