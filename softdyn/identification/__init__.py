"""Identification: a robot's stiffness, damping, masses and gears from measurements.

    from softdyn import identification

    data = identification.read_csv("run.csv", model)
    found = identification.identify(model, data, identification.parameters(model, "stiffness"))
    print(found)

`identify` has three steps: `make_problem` finds the stretches of data away from stops, `fit` fits
them, and the residuals give the intervals.

- `data`: measurements from arrays or a CSV file, and the samples that a stop disturbs;
- `rest_rows`: rows at rest in data over time;
- `markers`: points that a camera measures;
- `acquisition`: the names of the markers, the camera, errors in the data;
- `unknowns`: kinds of unknowns, their columns in the equations of motion;
- `parameters`: the unknowns of a fit, a model with other values; `design`: unknown numbers of an
  arm's TOML file;
- `trajectory`: the model's motion under the measured input, with its sensitivities; `rests`: its
  equilibria;
- `linear`: a first guess by weighted least squares on smoothed joint angles;
- `outputs`: what sensors would read of a motion;
- `problem`: simulates and compares with the data; `static_fit`, `dynamic_fit`: rows at rest, and
  stretches of motion without a stop; `blocks`: least squares with common unknowns and unknowns of
  each stretch;
- `output_error`: the fit of the simulated outputs; `intervals`: intervals, parameters not
  identifiable, whether the residuals are white;
- `result`: values and intervals; `rewrite`: the robot's file with the new numbers;
- `hints`: where the residuals are, and extensions of the model with their gain on unseen data.
"""

from softdyn.csv_table import MAX_ROWS as MAX_ROWS
from softdyn.identification.acquisition import doubts as doubts
from softdyn.identification.acquisition import prepared as prepared
from softdyn.identification.data import Measurements as Measurements
from softdyn.identification.data import output_names as output_names
from softdyn.identification.data import read_csv as read_csv
from softdyn.identification.design import DesignFile as DesignFile
from softdyn.identification.intervals import fit_length as fit_length
from softdyn.identification.markers.camera import MarkerView as MarkerView
from softdyn.identification.markers.points import Marker as Marker
from softdyn.identification.markers.points import marked as marked
from softdyn.identification.markers.points import read_points as read_points
from softdyn.identification.output_error import fit as fit
from softdyn.identification.output_error import identify as identify
from softdyn.identification.output_error import least_deviations as least_deviations
from softdyn.identification.output_error import make_problem as make_problem
from softdyn.identification.output_error import tested as tested
from softdyn.identification.outputs import compute_outputs as compute_outputs
from softdyn.identification.parameters import Parameter as Parameter
from softdyn.identification.parameters import apply_values as apply_values
from softdyn.identification.parameters import camera_unknowns as camera_unknowns
from softdyn.identification.parameters import choose_unknowns as choose_unknowns
from softdyn.identification.parameters import member_values as member_values
from softdyn.identification.parameters import motion_columns as motion_columns
from softdyn.identification.parameters import parameters as parameters
from softdyn.identification.problem import Acquisition as Acquisition
from softdyn.identification.problem import Fit as Fit
from softdyn.identification.problem import FitProblem as FitProblem
from softdyn.identification.rest_rows import rest_rows as rest_rows
from softdyn.identification.result import Estimate as Estimate
from softdyn.identification.result import Identified as Identified
from softdyn.identification.rewrite import rewrite_urdf as rewrite_urdf
from softdyn.identification.unknowns.kinds import KINDS as KINDS
