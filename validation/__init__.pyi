from . import paper
from .bench.drive import drive
from .bench.driver import Driver
from .channels import LogChannel
from .crosschecks.crosscheck import crosscheck
from .environment import Episode, ReachEnv
from .live.playing import play
from .loop.certificate import certified, certify
from .loop.experiment import Experiment
from .loop.log import Log
from .loop.pictures.replay import show_runs
from .loop.plants import Plant
from .loop.settings import RunOptions
from .mjcf.comparison.comparison import compare
from .mjcf.scene import Scene
from .rollouts.rollout import rollout, rollouts
from .simulate import simulate
from .studies.side_by_side import benchmark
from .twin.integrators import Integrator
from .twin.plant_errors import PlantErrors
from .twin.rig import Rig
from .twin.state_map import StateMap
from .twin.twin import Twin

__all__ = [
    "Driver",
    "Episode",
    "Experiment",
    "Integrator",
    "Log",
    "LogChannel",
    "Plant",
    "PlantErrors",
    "ReachEnv",
    "Rig",
    "RunOptions",
    "Scene",
    "StateMap",
    "Twin",
    "benchmark",
    "certified",
    "certify",
    "compare",
    "crosscheck",
    "drive",
    "paper",
    "play",
    "rollout",
    "rollouts",
    "show_runs",
    "simulate",
]
