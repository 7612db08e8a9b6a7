"""Tables, figures and pages of the studies' results.

- `plots`: all figures of a benchmark, as files
- `plot_data`: the thinned data of each run that the figures show
- `figures`: the paper's figures: Lyapunov functions, paths, errors, inputs
- `sweep_figure`: the figure of merit of a sweep's cases over each parameter that varies
- `statics_figure`: the stable equilibria of a robot's tip
- `uncertainty_figure`: an arm coloured by what sensors leave open
- `identification_page`: a fit to measurements, its residuals and intervals
- `pair_page`: two files of one robot as a page, each a `drawing`
- `document_page`: the shell of the pages to read: style, tables, figures
- `index`, `thumbnail`: the page of a benchmark, with a picture of each robot and controller
"""
