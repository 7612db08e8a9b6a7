"""The readings of a robot's sensors without errors, and their Jacobians: `SoftModel.measure`.

- `sensors`: a model's sensors, ready for evaluation;
- `measurement`: their readings at one state.

Noise, bias, latency, rate and resolution belong to the rig. The model does not add them.
"""

from softdyn.description.readings import ReadingLayout, SampledSensor
from softdyn.description.rig import Sensor, SensorKind
from softdyn.sensing.measurement import Components, Measurement
from softdyn.sensing.sensors import Sensors, measure

__all__ = [
    "Components",
    "Measurement",
    "ReadingLayout",
    "SampledSensor",
    "Sensor",
    "SensorKind",
    "Sensors",
    "measure",
]
