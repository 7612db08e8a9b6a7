"""The robot's state, slow disturbances and forces, from its sensors.

    from softdyn.estimation import Ekf

    observer = Ekf(model, sensors="file", disturbances=("tip_force",))
    estimate = observer.step(t, measurements, u)  # q, v, covariance, disturbances

- `ekf`, `parameters`: the extended Kalman filter, and the deviations that it assumes;
- `estimate`: what it returns, and what an observer of a closed loop is;
- `timeline`, `filter`: commands and readings in the order of their times; the estimate and its
  covariance, which they change;
- `covariance`, `drift`: prediction and updates of the covariance, corrections that end within the
  joint limits, disturbances that change;
- `arrivals`: rates and latencies of sensors, late readings, readings of a poorly known state;
- `creeping`: torques of Maxwell branches, with their known dynamics;
- `rubbing`: the errors of disturbances that friction of cables makes;
- `observability`: how well and how fast sensors show the state at an equilibrium;
- `recorded`: the filter over recorded data, with residuals by sensor;
- `consistency`: normalised errors, and their bounds.
"""

from softdyn.dynamics.balance import Disturbance
from softdyn.estimation.consistency import chi_squared_bounds, nees
from softdyn.estimation.ekf import Ekf
from softdyn.estimation.estimate import Observer
from softdyn.estimation.estimate import StateEstimate as Estimate
from softdyn.estimation.observability import Observability, observe, observe_run
from softdyn.estimation.parameters import EkfCounts, EkfParameters
from softdyn.estimation.recorded import ObservedData, observe_data

__all__ = [
    "Disturbance", "Ekf", "EkfCounts", "EkfParameters", "Estimate", "Observability",
    "ObservedData", "Observer", "chi_squared_bounds", "nees", "observe", "observe_data",
    "observe_run",
]  # fmt: skip
