"""A log as MCAP, read back by the package's own reader."""

from __future__ import annotations

import json
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from scipy.spatial.transform import Rotation

import softdyn
from softdyn import InputError, SetPoint
from softdyn.controllers import ImpedanceQp
from softdyn.validation import Log, rollout, simulate
from softdyn.validation.bench.drive import Drive
from softdyn.validation.loop import mcap_file
from softdyn.validation.loop.mcap_file import save_mcap
from tests.support.bench import NearDriver, bench_arm, tower
from tests.support.command import command
from tests.support.refused import refused
from tests.support.robots import cable, joint, link, load, motor, robot

WHEEL = robot(
    "wheel", link("body", 1, None, 1), link("rim", 1, None, 1),
    joint("spin", "body", "rim", kind="continuous", at="0 0 0.5"),
    block=(cable("t", "spin 1"), motor("t", -9, 9)),
)  # fmt: skip


def driven() -> Log:
    """A run on a rig, with readings that are late, and periods that are left out."""
    model = bench_arm()
    rig = tower(model)
    run = Drive(
        model, lambda state, reference: np.array([2.0, 1.0]), SetPoint(np.zeros(3)),
        NearDriver(model), period=0.005, duration=0.1, watchdog=False, source=rig.hands.source,
    )  # fmt: skip
    return run.run(on_step=lambda step: rig.hands.pass_(0.012 * (0.03 < step.t < 0.034))).log


def controlled() -> Log:
    model = softdyn.load("finger")
    return simulate(model, ImpedanceQp(model), SetPoint([0.1, 0.0, -0.1]), duration=0.1)


def floating(tmp_path: Path) -> Log:
    """A body that turns, with a wheel that passes 180 degrees."""
    model = load(tmp_path, WHEEL, floating=True)
    v = np.array([0.1, 0.2, 0.3, 0.5, 0.0, 0.4, 40.0])
    return rollout(model, np.array([5.0]), duration=0.1, v0=v)


@pytest.fixture(params=["driven", "controlled", "floating"])
def log(request, tmp_path) -> Log:
    if request.param == "floating":
        return floating(tmp_path)
    return {"driven": driven, "controlled": controlled}[request.param]()


def read(path: Path):
    """The messages by topic, as (time in s, content), and the schemas by topic."""
    found: dict[str, list] = {}
    schemas: dict[str, object] = {}
    with path.open("rb") as file:
        for schema, channel, message in make_reader(file, validate_crcs=True).iter_messages():
            assert channel.message_encoding == "json"
            assert message.log_time == message.publish_time
            rows = found.setdefault(channel.topic, [])
            rows.append((message.log_time / 1e9, json.loads(message.data)))
            schemas[channel.topic] = schema
    return found, schemas


def test_every_number_comes_back_at_its_time_and_in_its_unit(log, tmp_path):
    save_mcap(tmp_path / "run.mcap", log)
    found, schemas = read(tmp_path / "run.mcap")
    for name, channel in log.channels.items():
        if name == "t":
            continue
        rows = found[f"/{name}"]
        np.testing.assert_allclose([t for t, _ in rows], log.t[: len(rows)], atol=1e-9)
        assert len(rows) == len(log.t) - channel.held
        columns = channel.columns or (name,)
        told = np.array([[row[column] for column in columns] for _, row in rows])
        if not channel.text:
            values = channel.values.reshape(len(rows), -1)
            np.testing.assert_allclose(told.astype(float), values, rtol=1e-7, atol=0)
        stated = json.loads(schemas[f"/{name}"].data)["properties"]
        units = channel.units or ("",) * len(columns)
        assert [stated[column].get("description", "") for column in columns] == [*units]


def test_poses_and_joints_are_the_model_s(log, tmp_path):
    save_mcap(tmp_path / "run.mcap", log)
    found, schemas = read(tmp_path / "run.mcap")
    model = log.source.model()
    assert schemas["/tf"].name == "foxglove.FrameTransforms"
    assert schemas["/joint_states"].name == "sensor_msgs/msg/JointState"
    for k in (0, len(log.t) // 2, len(log.t) - 1):
        poses = model.link_poses(log.q[k])
        t, message = found["/tf"][k]
        assert {one["child_frame_id"] for one in message["transforms"]} == {*poses} - {"world"}
        for one in message["transforms"]:
            stamp = one["timestamp"]
            assert stamp["sec"] + 1e-9 * stamp["nsec"] == pytest.approx(t, abs=1e-9)
            pose = poses[one["child_frame_id"]]
            assert one["parent_frame_id"] == "world"
            np.testing.assert_allclose([*one["translation"].values()], pose[:3, 3], atol=1e-7)
            turn = Rotation.from_quat([one["rotation"][axis] for axis in "xyzw"]).as_matrix()
            np.testing.assert_allclose(turn, pose[:3, :3], atol=1e-7)
        _, joints = found["/joint_states"][k]
        moving = [joint.name for joint in model.robot.moving_joints]
        assert sorted(joints["name"]) == sorted(moving)
        angles = dict(zip(model.joint_names, model.coordinates(log.q[k]), strict=True))
        np.testing.assert_allclose(joints["position"], [angles[n] for n in joints["name"]])
        rates = dict(zip(model.joint_names, log.v[k], strict=True))
        np.testing.assert_allclose(joints["velocity"], [rates[n] for n in joints["name"]])
    assert found["/robot_description"][0][1]["data"] == model.robot.text


def test_a_stamp_is_the_nearest_nanosecond():
    """0.29 s is a little less in binary: 289 999 999.999 ns."""
    assert mcap_file._stamp(0.29) == {"sec": 0, "nsec": 290_000_000}
    assert mcap_file._stamp(1.9999999999) == {"sec": 2, "nsec": 0}


def test_the_command_writes_a_log_of_either_kind(tmp_path):
    log = controlled()
    log.save(tmp_path / "a.npz")
    log.to_csv(tmp_path / "a.csv")
    for name in ("a.npz", "a.csv"):
        assert command("export", str(tmp_path / name), "--mcap", str(tmp_path / "a.mcap"))[0] == 0
        assert len(read(tmp_path / "a.mcap")[0]["/tf"]) == len(log.t)


def test_another_robot_is_refused_and_nothing_written(tmp_path):
    with refused("model", "another, …"):
        save_mcap(tmp_path / "a.mcap", controlled(), softdyn.load("helix"))
    assert not (tmp_path / "a.mcap").exists()


@pytest.mark.parametrize(
    ("start", "seconds"),
    [
        ("2026-11-26T12:00:00Z", 1795694400),
        ("2026-11-26T13:00:00.25+01:00", 1795694400.25),
        (datetime(1970, 1, 1, tzinfo=UTC), 0),
    ],
)
def test_times_begin_at_a_date(start, seconds, tmp_path):
    log = controlled()
    save_mcap(tmp_path / "run.mcap", log, start=start)
    found, _ = read(tmp_path / "run.mcap")
    for topic in ("/u", "/joint_states"):
        times = [t for t, _ in found[topic]]
        np.testing.assert_allclose(np.array(times) - seconds, log.t[: len(times)], atol=1e-6)
    for t, message in found["/joint_states"]:
        stamp = message["header"]["stamp"]
        assert stamp["sec"] + 1e-9 * stamp["nsec"] == pytest.approx(t, abs=1e-6)


@pytest.mark.parametrize(
    "start", ["noon", "2026-11-26T12:00:00", "1969-12-31T23:59:59Z", "9999-01-01T00:00:00Z", 5]
)
def test_a_start_that_is_no_date_with_a_zone_is_refused(start, tmp_path):
    with pytest.raises(InputError) as refused:
        save_mcap(tmp_path / "run.mcap", controlled(), start=start)
    assert refused.value.name == "start"
    assert not (tmp_path / "run.mcap").exists()
