"""Kinds of unknown numbers.

- `kinds`: each kind's columns in the equations of motion, and how the robot gets other values;
- `friction`: dry friction of joints, which the controllers' model lacks;
- `relaxation`: shares and times of the Maxwell branches of springs that creep;
- `sensor_errors`: biases and latencies of the file's sensors.
"""
