"""Studies of many closed loops: each is a list of cases and a table, run by one engine.

- `engine`: `Case` → run → `Store`.
- `experiments`: the paper's experiments, control periods and published results.
- `sweep`: a grid, random samples or one change at a time; `sweep_file` and `axes` read it from a
  TOML file, `sweep_report` writes its tables, `paper_table` one for a paper. ``sweeps/`` has the
  shipped files.
- `drawn_runs`: the random values and the changes of a sweep, one draw at a time.
- `benchmark`, `benchmark_table`: the paper's grid as a sweep, and its table in Markdown, LaTeX and
  text.
- `side_by_side`: `benchmark` from Python, with a user's own controller classes.
- `study_targets`: the paper's targets for its robots, sampled equilibria for any other.
"""
