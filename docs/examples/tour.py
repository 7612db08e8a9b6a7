# ---
# jupyter:
#   jupytext:
#     text_representation:
#       extension: .py
#       format_name: percent
# ---

# %% [markdown]
# # softdyn in five cells
# Load a robot, look at it, run a controller, look at the run, plot it. `python tour.py` runs it as
# a script; `jupytext --to notebook tour.py` makes a notebook of it, whose pages then show below
# their cells.

# %% Load
import numpy as np

import softdyn
from softdyn.controllers import ImpedanceQp, SoftIdClfQp
from softdyn.validation import paper, simulate

model = softdyn.load("finger")  # or a path to your own annotated URDF
state = model.state(model.q0, np.zeros(model.nv))
print(f"{model.name}: {model.nv} degrees of freedom, {model.nu} inputs, tip at {state.y} m")
print(f"rank of B: {np.linalg.matrix_rank(state.B)} of {model.nv}, so it is underactuated")

# %% Look: at rest, then what each input does
from softdyn.view.rest_sweep import rest_page

rest_page(model)

# %% Run two controllers on the paper's ellipse; the plant is MuJoCo's
experiment = paper.tracking("finger", omega=0.5)
logs = [simulate(model, kind(model), experiment) for kind in (SoftIdClfQp, ImpedanceQp)]
for log in logs:
    print(f"{log.controller}: mean squared error {log.mse_cm2:.2f} cm²")

# %% Look: both runs in one scene
from softdyn.validation.report.replay import comparison

page = comparison(logs, [model, model])
page

# %% Plot the error
import matplotlib.pyplot as plt

figure, axes = plt.subplots(figsize=(6, 2.6), layout="constrained")
for log in logs:
    axes.semilogy(log.t, 100 * np.linalg.norm(log.error, axis=1), label=log.controller)
axes.set(xlabel="Time (s)", ylabel="Tip error (cm)")
axes.legend()
plt.show()
