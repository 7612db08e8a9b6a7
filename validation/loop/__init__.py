"""The closed loop of a controller and a plant; it does not know the paper.

- `closed_loop`: `ClosedLoop`, which can be stepped, and `simulate`, which runs one
- `arguments`: what a loop is given, checked
- `experiment`: what a loop is asked to do: a reference, how long, how often
- `time_grid`: how a run is divided into control periods and plant steps
- `record`: what a loop writes down while it runs
- `verdict`: when a run ends early, when it counts as failed, whether it reached its reference
- `log`: the record of a run: its arrays, its figures of merit, its summary, its file
- `logged_robot`: the robot of a log, as its file was when it ran
- `log_checks`: what such a file must be
- `metrics`: the means behind figures of merit
"""
