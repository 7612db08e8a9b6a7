"""Many closed loops: each study is a list of cases and a table, run by one engine.

- `engine`: `Case` → run → `Store`; see there.
- `experiments`: the paper's experiments, control periods and published results.
- `benchmark`, `benchmark_table`: the paper's grid, and its table in Markdown, LaTeX and text.
- `sweep`, `sweep_file`, `sweep_report`: a grid or random samples from a TOML file.
- `robustness`: other plants, targets, a delay of 5 ms, noise of 1 mm on the tip.
- `beyond`: every cell of the paper at several control periods.
- `hold`: the soft law over several horizons.
- `side_by_side`: `benchmark` from Python, with a user's own controller classes.
- `tuning`, `tuning_targets`: a schedule for `best` on a user's robot, and what it is tried on.
- `paper_tuning`: the schedules of the bundled robots, on the paper's ellipse.
- `schedule_search`: CMA-ES on one stage of a schedule, which both tunings share.
- `obstacle`: the tip meets a ball, with and without barriers.
- `study_targets`: the paper's targets for its robots, sampled equilibria for any other.
"""
