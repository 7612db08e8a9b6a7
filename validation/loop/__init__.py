"""The closed loop of a controller and a plant, independent of the paper's experiments.

- `simulate`: a closed loop in one call
- `closed_loop`: `ClosedLoop`, which can be stepped
- `arguments`: checks of a loop's arguments; the user's own plant
- `experiment`: a loop's task: its reference, duration and control period
- `observation`: an observer between the sensors and the controller
- `time_grid`: the division of a run into control periods and plant steps
- `record`: a log's arrays while the loop fills them, the controller's counts, versions
- `summary`: the figures of a run as text
- `certificate`: the true rate of V along a run, beside the rate that its QP assumed
- `verdict`: early ends of a run, failures, whether the run reached its reference
- `log`: the record of a run: its arrays, its figures of merit, its summary, its file
- `log_csv`: a log as CSV, with units
- `logged_robot`: the robot of a log, from the text of its file at the time of the run
- `log_checks`: checks of a log's file
- `labels`: names of robots, controllers and experiments in tables, figures and pages
- `metrics`: the means behind figures of merit
"""
