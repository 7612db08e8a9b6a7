"""Tables, figures and pages of what the studies found.

- `plots`: all figures of a benchmark, as files
- `plot_style`: how every figure looks: sizes, colours and dashes, legends
- `plot_data`: what the figures show of each run, thinned
- `figures`: the paper's figures: Lyapunov functions, paths, errors
- `time_figures`: inputs over time; errors and inputs of a few saved runs
- `step_figures`: step times and how they grow
- `statics_figure`: where a robot's tip can rest
- `replay`: logs as a page that plays them
- `identification_page`: a fit to measurements, its residuals and intervals
- `pair_page`: two files of one robot as a page, each a `drawing`
- `index`, `thumbnail`: a benchmark's whole result on one page, with a picture of each pair
"""
