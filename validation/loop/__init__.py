"""The loop of a controller and a plant, independent of the paper's experiments.

- `loop`: `ControlLoop`, one control period at a time; every run steps it
- `plants`: the contract of what a loop moves, and the simulated plants
- `closed_loop`: `ClosedLoop`, a loop with a reference, a planned time and a record
- `settings`: `RunOptions`, the settings of a run, declared once
- `arguments`: checks of a run's model, controller, reference and start
- `experiment`: a loop's task: its reference, duration and control period
- `trajectories`: trajectories of one's own, from a CSV file or a class
- `setups`: the properties of a robot that its experiments depend on, and its ellipse
- `observation`: an observer between the sensors and the controller
- `time_grid`: the division of a run into control periods and plant steps
- `record`: a log's arrays while the loop fills them, the controller's counts
- `certificate`: the true rate of V along a run, beside the rate that its QP assumed
- `kept_problems`: files of the problems behind a run's fallbacks
- `log`: the record of a run, with its verdict, its files and its pictures
- `log_data`: its channels, its settings, its figures of merit
- `verdict`: early ends of a run, failures, whether the run reached its reference
- `log_text`: its summary, and its figures for JSON
- `pictures`: how a log looks, in figures and on a page
- `log_files`, `mcap_file`: its NPZ and CSV files, and MCAP for viewers
- `provenance`: the files, versions, processor and git commit of a run
- `recipe`: settings, controller and reference as plain data, and made again of it
- `repeat`: the record of a run, its repetition, and what differs
- `recorded`: a recorded run from a file
- `logged_robot`: the robot of a log, from the text of its file at the time of the run
- `log_checks`: checks of a log's file
- `labels`: names of robots, controllers and experiments in tables, figures and pages
- `metrics`: the means behind figures of merit
"""
