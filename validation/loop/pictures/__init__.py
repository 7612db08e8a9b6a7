"""How a log looks: `Log.plot` and `Log.show`.

- `plot_style`: the style of all figures: sizes, colours and dashes, legends
- `time_figures`: errors and inputs of a few runs over time
- `replay`: a page that replays logs
"""
