"""Logs made by hand."""

from dataclasses import fields, replace

import numpy as np

from softdyn.controllers.channels import LogChannel
from softdyn.validation import Log
from softdyn.validation.loop.logged_robot import LoggedRobot
from softdyn.validation.loop.provenance import exchanged

# without a text, because nothing is drawn
NOBODY = LoggedRobot("robot.urdf", "", "", False, None, "")


def make_log(t, error, *more, **changes):
    """A log with these samples and `more` channels; its other fields do not matter."""
    t, error = np.array(t, float), np.array(error, float)
    steps = len(t) - 1
    about = {
        "u_min": -np.ones(1), "u_max": np.ones(1), "u_unit": "N", "robot": "r", "controller": "c",
        "kind": None, "theta": None, "omega": None, "duration": float(t[-1]), "period": 0.1,
        "timestep": 0.1, "length": None, "contacts": False, "complete": True, "failed": False,
        "reason": None, "not_solved": 0, "fallbacks": 0, "max_bound_violation": 0.0, "gains": None,
        "versions": {}, "source": NOBODY,
    }  # fmt: skip
    arrays = {
        "t": t, "q": np.zeros((steps + 1, 1)), "v": np.zeros((steps + 1, 1)), "y": error,
        "y_ref": np.zeros_like(error), "error": error, "u": np.zeros((steps, 1)),
        "V": np.zeros(steps), "delta": np.zeros(steps), "status": np.full(steps, "ok"),
        "step_us": np.arange(1.0, steps + 1),
    }  # fmt: skip
    arrays |= {name: changes.pop(name) for name in arrays.keys() & changes}
    channels = {
        name: channel(name, values, len(values) == steps) for name, values in arrays.items()
    }
    return Log(channels | {one.name: one for one in more}, **{**about, **changes})


def channel(name, values, held=False, columns=None):
    """A channel of these values; columns are (name, unit), numbered by default."""
    values = np.asarray(values)
    if values.ndim == 1:
        return LogChannel(name, held=held, text=values.dtype.kind == "U", values=values)
    named = columns or [(str(k), "") for k in range(values.shape[1])]
    return LogChannel.of(name, named, held=held).filled(values)


def placeless(record):
    """A record without the places of its files."""
    return exchanged(record, lambda file: {"sha256": file["sha256"]})


def assert_same(log, again):
    """Equal to the bit, in every channel and every other field."""
    assert [*log.channels] == [*again.channels]
    every = [*(field.name for field in fields(Log) if field.name != "channels"), *log.channels]
    for name in every:
        saved, loaded = getattr(log, name), getattr(again, name)
        assert type(saved) is type(loaded), name
        if isinstance(saved, np.ndarray):
            assert saved.dtype == loaded.dtype, name
            assert saved.tobytes() == loaded.tobytes(), name
            assert not loaded.flags.writeable
        elif name == "record":  # a file outside the record's folder loses its path
            assert placeless(saved) == placeless(loaded)
        elif name == "source":
            assert replace(saved, path="") == replace(loaded, path="")
        else:
            assert saved == loaded, name
    for name, one in log.channels.items():
        assert again.channels[name].titles == one.titles
