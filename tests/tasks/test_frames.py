"""Several tasks of frames in one stack, against one task at a time."""

from __future__ import annotations

import pickle

import numpy as np
import pytest

import softdyn
from softdyn import Reference, SetPoint
from softdyn.tasks import (
    AxisTask,
    OrientationTask,
    PointTask,
    PoseTask,
    StackedReference,
    Target,
    Task,
)
from softdyn.tasks.frames import FrameStack
from softdyn.tasks.targets import exp3
from tests.support.named_models import named_model
from tests.support.refused import refused


@pytest.fixture(params=["helix", "mimic", "walker"], ids=str)
def model(request, tmp_path):
    return named_model(request.param, tmp_path)


def targets(seed: int) -> StackedReference:
    rng = np.random.default_rng(seed)
    turn, (v, a) = exp3(rng.normal(size=3)), rng.normal(size=(2, 3))
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = turn, rng.normal(size=3)
    return StackedReference(
        {
            "p": Reference(rng.normal(size=3), v, a),
            "o": Target(turn, v, a),
            "pose": Target(pose, np.append(v, a), np.append(a, v)),
            "axis": Target(turn[0], np.cross(v, turn[0]), a),
        }
    )


def test_rows_are_those_of_each_task(model):
    tip = model.robot.task
    tasks: list[Task] = [
        PoseTask(tip, (0.01, 0, 0.02), name="pose", axes=(5, 0, 1)),
        PointTask(tip, (0, 0.03, 0), name="p"),
        AxisTask(tip, [0.6, 0, -0.8], name="axis"),
        OrientationTask(tip, name="o", axes=(2,)),
    ]
    parts = [slice(4, 7), slice(0, 3), slice(7, 10), slice(3, 4)]
    rows = [(0, 5, 4), (0, 0, 5), (0, 1, 6), *((1, i, i) for i in range(3))]
    rows += [*((2, i, 7 + i) for i in range(3)), (3, 2, 3)]
    stack, rng = FrameStack(tasks, rows), np.random.default_rng(0)
    for k, filled in enumerate((stack, stack, pickle.loads(pickle.dumps(stack)))):
        # the second time the point's target alone has changed
        reference = targets(k // 2)
        if k == 1:
            reference = StackedReference({**reference.targets, "p": targets(9).targets["p"]})
        q = model.integrate(model.q0, 0.3 * rng.normal(size=model.nv))
        state = model.state(q, rng.normal(size=model.nv))
        values, jacobian = np.full((3, 11), np.nan), np.full((11, model.nv), np.nan)
        filled.take_from(reference)
        filled.fill(state, values, jacobian)
        assert np.isnan(values[:, 10]).all()
        assert np.isnan(jacobian[10]).all()
        for task, part in zip(tasks, parts, strict=True):
            found = task(state, reference)
            got = (*values[:2, part], jacobian[part], values[2, part])
            for ours, own in zip(got, found, strict=True):
                np.testing.assert_allclose(ours, own, rtol=1e-12, atol=1e-12)


def test_plain_references_and_own_targets():
    finger = softdyn.load("finger")
    tasks = [PointTask("tip"), AxisTask("tip", [0, 0, 1])]
    stack = FrameStack(tasks, [(k, i, 3 * k + i) for k in range(2) for i in range(3)])
    state = finger.state([0.1] * 4, [0] * 4)
    own = Target([0.0, 1.0, 0.0])
    values, jacobian = np.zeros((3, 6)), np.zeros((6, 4))
    for reference in (
        SetPoint([0.1, 0, 0]), SetPoint([0.2, 0, 0]), StackedReference({"tip": SetPoint(state.y)}),
        StackedReference({"tip": SetPoint(state.y), "tip.axis": own}), SetPoint([0.2, 0, 0]),
    ):  # fmt: skip
        stack.take_from(reference)
        stack.fill(state, values, jacobian)
        for task, part in zip(tasks, (slice(0, 3), slice(3, 6)), strict=True):
            np.testing.assert_allclose(values[0, part], task(state, reference).error, atol=1e-15)
    wrong = StackedReference({"tip": SetPoint(state.y), "tip.axis": Target([0, 2.0, 0])})
    with refused("target of 'tip.axis'", "[0.0, 2.0, 0.0]"):
        stack.take_from(wrong)
    with refused("tip: axes", 3):
        PointTask("tip", axes=(1, 3))
