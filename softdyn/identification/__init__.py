"""From measurements to parameters: stiffness, damping, masses and gears of a robot from its data.

    from softdyn import identification

    data = identification.read_csv("run.csv", model)
    found = identification.identify(model, data, identification.parameters(model, "stiffness"))
    print(found)

- `data`: measurements, from arrays or a CSV file, and what a stop spoils in them;
- `parameters`: what may be unknown, its column in the equations of motion, a model with other
  values;
- `friction`: of dry joints, which the model has not;
- `trajectory`: the model's motion under the measured input, with its sensitivities;
- `linear`: a first guess by weighted least squares on smoothed joint angles;
- `problem`: the stretches without a stop, simulated; `blocks`: least squares with unknowns of each;
- `fit`: the fit of the simulated outputs, intervals, and what cannot be identified;
- `result`: what was found; `whiteness`: whether the residuals are white;
- `rewrite`: the robot's file with the new numbers.
"""

from softdyn.identification.data import Measurements as Measurements
from softdyn.identification.data import read_csv as read_csv
from softdyn.identification.fit import identify as identify
from softdyn.identification.parameters import KINDS as KINDS
from softdyn.identification.parameters import parameters as parameters
from softdyn.identification.result import Identified as Identified
from softdyn.identification.rewrite import rewritten as rewritten
