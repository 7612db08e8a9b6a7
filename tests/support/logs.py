"""Logs made by hand."""

import numpy as np

from softdyn.validation import Log
from softdyn.validation.loop.logged_robot import LoggedRobot

# without a text, because nothing is drawn
NOBODY = LoggedRobot("robot.urdf", "", "", False, None, "")


def make_log(t, error, **changes):
    """A log with these samples; its other fields do not matter."""
    t, error = np.array(t, float), np.array(error, float)
    steps = len(t) - 1
    about = {
        "u_unit": "N", "robot": "r", "controller": "c", "kind": None, "theta": None, "omega": None,
        "duration": float(t[-1]), "period": 0.1, "timestep": 0.1, "length": None,
        "joint_names": ("j",), "contacts": False, "complete": True, "failed": False, "reason": None,
        "not_solved": 0, "fallbacks": 0, "max_bound_violation": 0.0, "gains": None, "versions": {},
        "source": NOBODY,
    }  # fmt: skip
    arrays = {
        "t": t, "q": np.zeros((steps + 1, 1)), "v": np.zeros((steps + 1, 1)), "y": error,
        "y_ref": np.zeros_like(error), "error": error, "u": np.zeros((steps, 1)),
        "V": np.zeros(steps), "delta": np.zeros(steps), "status": np.full(steps, "ok"),
        "step_us": np.arange(1.0, steps + 1), "u_min": -np.ones(1), "u_max": np.ones(1),
    }  # fmt: skip
    return Log(**{**arrays, **about, **changes})
