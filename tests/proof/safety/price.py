"""Run as a script in any checkout: the processor time of a step without and with barriers.

It prints the smallest time of some calls (µs) at each recorded state: of the law over its horizon
without barriers, with obstacles out of reach, and with those of the state's scene. It imports
nothing of the proof, because another checkout has another one.
"""

from __future__ import annotations

import json
import sys
import time
import warnings
from typing import Any

import numpy as np

import softdyn
from softdyn import Reference
from softdyn.controllers import SoftIdClfQp
from softdyn.controllers.gains import resolve
from softdyn.safety import HalfSpace, KeepOutSphere, Surroundings
from softdyn.validation.loop.setups import setup_of

FAR = (
    HalfSpace(np.array([0, 0, 1.0]), -9.0, links="all"),
    KeepOutSphere(np.array([9.0, 0, 0]), 0.1, links="all"),
)


def prices(robot: str, path: str, rounds: int) -> dict[str, Any]:
    """Smallest times (µs) of each kind at all states, and the inputs with barriers."""
    model, states = softdyn.load(robot), np.load(path)
    period, eps = setup_of(model).period, resolve(model, SoftIdClfQp.published, None).eps
    around = [Surroundings.of(json.loads(str(table))) for table in states["tables"]]

    def law(barriers: Any) -> SoftIdClfQp:
        made = SoftIdClfQp(model, horizon=eps, barriers=barriers)
        made.reset(period)
        return made

    plain, far, near = law(()), law(FAR), [law(one.barriers) for one in around]
    found: dict[str, Any] = {"without": [], "far": [], "scene": [], "changed": [], "u": []}
    for q, v, now, scene in zip(*(states[key] for key in ("q", "v", "now", "scene")), strict=True):
        reference, inputs = Reference(*now), {}
        for kind, one in (("without", plain), ("far", far), ("scene", near[scene])):
            least = np.inf
            for _ in range(rounds):
                began = time.process_time_ns()
                inputs[kind] = one(model.state(q, v), reference).u
                least = min(least, time.process_time_ns() - began)
            found[kind].append(least / 1e3)
        found["changed"].append(not np.array_equal(inputs["without"], inputs["scene"]))
        found["u"].append(inputs["scene"].tolist())
    return found


if __name__ == "__main__":
    warnings.simplefilter("ignore")  # of runs that start outside the safe set
    rounds, *robots = sys.argv[1:]
    pairs = (word.split("=", 1) for word in robots)
    print(json.dumps({robot: prices(robot, path, int(rounds)) for robot, path in pairs}))
