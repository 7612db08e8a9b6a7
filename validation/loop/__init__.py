"""The loop of a controller and a plant, independent of the paper's experiments.

- `loop`: `ControlLoop`, one control period at a time; every run steps it
- `plants`: the contract of what a loop moves, and the simulated plants
- `closed_loop`: `ClosedLoop`, a loop with a reference, a planned time and a record
- `arguments`: `RunOptions`, all arguments of a run, and their checks
- `experiment`: a loop's task: its reference, duration and control period
- `setups`: the properties of a robot that its experiments depend on, and its ellipse
- `observation`: an observer between the sensors and the controller
- `time_grid`: the division of a run into control periods and plant steps
- `record`: a log's arrays while the loop fills them, the controller's counts, versions
- `certificate`: the true rate of V along a run, beside the rate that its QP assumed
- `verdict`: early ends of a run, failures, whether the run reached its reference
- `log`: the record of a run: its channels, its figures of merit, its summary
- `pictures`: how a log looks, in figures and on a page
- `log_files`, `mcap_file`: its NPZ and CSV files, and MCAP for viewers
- `logged_robot`: the robot of a log, from the text of its file at the time of the run
- `log_checks`: checks of a log's file
- `labels`: names of robots, controllers and experiments in tables, figures and pages
- `metrics`: the means behind figures of merit
"""
