"""Identification: a robot's stiffness, damping, masses and gears from measurements.

    from softdyn import identification

    data = identification.read_csv("run.csv", model)
    found = identification.identify(model, data, identification.parameters(model, "stiffness"))
    print(found)

`identify` has three steps: `problem_of` finds the stretches of data away from stops, `fit` fits
them, and the residuals give the intervals.

- `data`: measurements from arrays or a CSV file, and the samples that a stop disturbs;
- `parameters`: the kinds of unknowns, their columns in the equations of motion, a model with
  other values;
- `friction`: dry friction of joints, which the controllers' model lacks;
- `trajectory`: the model's motion under the measured input, with its sensitivities;
- `linear`: a first guess by weighted least squares on smoothed joint angles;
- `problem`: simulates the stretches without a stop; `blocks`: least squares with common unknowns
  and unknowns of each stretch;
- `output_error`: the fit of the simulated outputs, intervals, parameters not identifiable;
- `result`: values and intervals; `whiteness`: whether the residuals are white;
- `rewrite`: the robot's file with the new numbers.
"""

from softdyn.csv_columns import MAX_ROWS as MAX_ROWS
from softdyn.identification.data import Measurements as Measurements
from softdyn.identification.data import read_csv as read_csv
from softdyn.identification.output_error import Fit as Fit
from softdyn.identification.output_error import fit as fit
from softdyn.identification.output_error import fit_length as fit_length
from softdyn.identification.output_error import identify as identify
from softdyn.identification.output_error import least_deviations as least_deviations
from softdyn.identification.parameters import KINDS as KINDS
from softdyn.identification.parameters import Parameter as Parameter
from softdyn.identification.parameters import member_values as member_values
from softdyn.identification.parameters import parameters as parameters
from softdyn.identification.parameters import unknowns_of as unknowns_of
from softdyn.identification.parameters import with_values as with_values
from softdyn.identification.problem import FitProblem as FitProblem
from softdyn.identification.problem import measured_outputs as measured_outputs
from softdyn.identification.problem import problem_of as problem_of
from softdyn.identification.result import Estimate as Estimate
from softdyn.identification.result import Identified as Identified
from softdyn.identification.rewrite import rewritten as rewritten
