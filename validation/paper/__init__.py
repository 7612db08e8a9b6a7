"""The paper: its experiments, its QPs as printed, its reference implementation.

- `paper_qps`: CLF-QP, ID-CLF-QP, Soft ID-CLF-QP, IC-QP, IC, UIC as the paper prints them;
- `solvers`: quadprog, SCS through cvxpy; the least-norm minimiser;
- `reference_laws`: these controllers with the deviations of the reference implementation;
- `altered_states`: states as the reference implementation computes them;
- `reproduction`: how the reference implementation differs from the paper, change by change;
- `one_step`: errors of that emulation against recorded runs, one step at a time;
- `certificates`: V along the paper's runs, and the zero dynamics.

The public names of the experiments, `studies.experiments`, are here.
"""

from softdyn.validation.studies.experiments import CYCLES as CYCLES
from softdyn.validation.studies.experiments import OMEGAS as OMEGAS
from softdyn.validation.studies.experiments import ROBOTS as ROBOTS
from softdyn.validation.studies.experiments import TABLE as TABLE
from softdyn.validation.studies.experiments import THETAS as THETAS
from softdyn.validation.studies.experiments import Published as Published
from softdyn.validation.studies.experiments import Setup as Setup
from softdyn.validation.studies.experiments import beside as beside
from softdyn.validation.studies.experiments import check_reach as check_reach
from softdyn.validation.studies.experiments import ellipse_points as ellipse_points
from softdyn.validation.studies.experiments import experiment as experiment
from softdyn.validation.studies.experiments import published as published
from softdyn.validation.studies.experiments import second_cycle_mse_cm2 as second_cycle_mse_cm2
from softdyn.validation.studies.experiments import set_point as set_point
from softdyn.validation.studies.experiments import setup as setup
from softdyn.validation.studies.experiments import setup_of as setup_of
from softdyn.validation.studies.experiments import spread as spread
from softdyn.validation.studies.experiments import tracking as tracking
