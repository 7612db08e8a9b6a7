"""The paper's experiments: the public names of `studies.experiments`."""

from softdyn.validation.loop.setups import CYCLES as CYCLES
from softdyn.validation.loop.setups import ROBOTS as ROBOTS
from softdyn.validation.loop.setups import Setup as Setup
from softdyn.validation.loop.setups import ellipse_points as ellipse_points
from softdyn.validation.loop.setups import setup as setup
from softdyn.validation.loop.setups import setup_of as setup_of
from softdyn.validation.studies.experiments import OMEGAS as OMEGAS
from softdyn.validation.studies.experiments import TABLE as TABLE
from softdyn.validation.studies.experiments import THETAS as THETAS
from softdyn.validation.studies.experiments import Published as Published
from softdyn.validation.studies.experiments import beside as beside
from softdyn.validation.studies.experiments import check_reach as check_reach
from softdyn.validation.studies.experiments import experiment as experiment
from softdyn.validation.studies.experiments import published as published
from softdyn.validation.studies.experiments import second_cycle_mse_cm2 as second_cycle_mse_cm2
from softdyn.validation.studies.experiments import set_point as set_point
from softdyn.validation.studies.experiments import spread as spread
from softdyn.validation.studies.experiments import tracking as tracking
from softdyn.validation.studies.experiments import trajectory as trajectory
