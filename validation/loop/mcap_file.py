"""A log as an MCAP file, which the field's viewers open.

Messages are JSON. Their time is the run's, from 0 s on, or from a date on, so that they line up
with other recordings.

    /tf                  foxglove.FrameTransforms      poses of all links in the frame "world"
    /joint_states        sensor_msgs/msg/JointState    positions and velocities of the joints
    /robot_description   std_msgs/msg/String           the robot's URDF
    /NAME                softdyn.NAME                  each channel of the log, e.g. /measured

A channel of one's own whose topic is one of the first three is in /channels/NAME.
A message of a channel has a number for each column, null where there is none. Its schema states
the units.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from softdyn import InputError, SoftModel
from softdyn.controllers.channels import LogChannel
from softdyn.dynamics.model import check_model
from softdyn.validation.files import atomic, to_json
from softdyn.validation.loop.log import Log
from softdyn.validation.loop.provenance import name_shown
from softdyn.validation.loop.repeat import record_for, whole_record

NANO = 1_000_000_000
LATEST = 530 * 366 * 86_400 * NANO  # ns; a message's time has 64 bits
WORLD = "world"
NUMBER, TEXT = {"type": "number"}, {"type": "string"}
TIME = {"type": "object", "properties": {"sec": {"type": "integer"}, "nsec": {"type": "integer"}}}
NUMBERS = {"type": "array", "items": NUMBER}


def _object(**properties: Any) -> dict[str, Any]:
    return {"type": "object", "properties": properties}


TRANSFORM = _object(
    timestamp=TIME, parent_frame_id=TEXT, child_frame_id=TEXT,
    translation=_object(x=NUMBER, y=NUMBER, z=NUMBER),
    rotation=_object(x=NUMBER, y=NUMBER, z=NUMBER, w=NUMBER),
)  # fmt: skip
KNOWN = {
    "/tf": (
        "foxglove.FrameTransforms", _object(transforms={"type": "array", "items": TRANSFORM}),
    ),
    "/joint_states": ("sensor_msgs/msg/JointState", _object(
        header=_object(stamp=TIME, frame_id=TEXT), name={"type": "array", "items": TEXT},
        position=NUMBERS, velocity=NUMBERS, effort=NUMBERS,
    )),
    "/robot_description": ("std_msgs/msg/String", _object(data=TEXT)),
}  # fmt: skip
"""Topics with well-known messages: the name and the JSON schema of each."""


def save_mcap(
    path: str | Path, log: Log, model: SoftModel | None = None, start: str | datetime | None = None
) -> None:
    """Write the log as MCAP, complete or not at all.

    Parameters
    ----------
    path : str or Path
        The file.
    log : Log
        The run.
    model : SoftModel, optional
        The log's robot; by default it is made from the text in the log.
    start : str or datetime, optional
        The date and time at t = 0 s, with its time zone, e.g. ``2026-11-26T12:00:00Z``; by default
        the times of messages begin at 0.

    Raises
    ------
    InputError
        `start` is no date from 1970 on with a time zone, the package mcap is not installed, the
        model is of another robot, or nothing can be written there.
    """
    begin = 0 if start is None else _nanoseconds(start)
    try:
        from mcap.writer import Writer
    except ImportError:
        raise InputError("mcap", "the extra softdyn[mcap] (pip install mcap)", "none") from None
    if model is None:
        model = log.source.model()
    log.source.check(check_model(model), "model")
    with atomic(path) as file:
        writer = Writer(file)
        writer.start(profile="", library="softdyn")
        topics = {}
        for topic, (name, schema) in (KNOWN | _own(log)).items():
            data = json.dumps({"title": name, **schema}).encode()
            number = writer.register_schema(name=name, encoding="jsonschema", data=data)
            topics[topic] = writer.register_channel(
                topic=topic, message_encoding="json", schema_id=number
            )
        for t, topic, message in _messages(log, model, begin):
            data = json.dumps(message, allow_nan=False).encode()
            time = begin + round(t * NANO)
            writer.add_message(topics[topic], log_time=time, publish_time=time, data=data)
        record = record_for(whole_record(log), Path(path).parent)
        about = {
            "robot": log.robot, "controller": name_shown(log.controller),
            "reason": log.reason or "", "record": to_json(record),
        }  # fmt: skip
        writer.add_metadata("softdyn", about)
        writer.finish()


def _columns(channel: LogChannel) -> tuple[str, ...]:
    """The names of a channel's numbers in its messages."""
    return (channel.name,) if channel.columns is None else channel.columns


def _topic(name: str) -> str:
    """The topic of a channel."""
    return f"/channels/{name}" if f"/{name}" in KNOWN else f"/{name}"


def _own(log: Log) -> dict[str, tuple[str, dict[str, Any]]]:
    """Topic, name and schema of each channel but the time."""
    found = {}
    for name, channel in log.channels.items():
        if name == "t":
            continue
        units = channel.units or ("",) * len(_columns(channel))
        kind = TEXT if channel.text else NUMBER
        properties = {
            column: kind | ({"description": unit} if unit else {})
            for column, unit in zip(_columns(channel), units, strict=True)
        }
        found[_topic(name)] = f"softdyn.{name}", _object(**properties)
    return found


def _nanoseconds(start: str | datetime) -> int:
    """Nanoseconds from 1970 to a date and time."""
    expected = "a date and time with its zone, such as 2026-11-26T12:00:00Z"
    try:
        date = datetime.fromisoformat(start) if isinstance(start, str) else start
        since = date - datetime(1970, 1, 1, tzinfo=UTC)
    except (TypeError, ValueError):  # no date, or one without a zone
        raise InputError("start", expected, repr(start)) from None
    found = (since.days * 86_400 + since.seconds) * NANO + since.microseconds * 1000
    if not 0 <= found < LATEST:
        raise InputError("start", f"{expected}, from 1970 to 2500", repr(start))
    return found


def _messages(
    log: Log, model: SoftModel, begin: int
) -> Iterator[tuple[float, str, dict[str, Any]]]:
    """Time (s), topic and content of every message, in the order of time.

    The stamps in the contents count from `begin` (ns) on.
    """
    robot = model.robot
    joints = {joint.name for joint in robot.moving_joints}
    names = [name for name in model.joint_names if name in joints]
    first = len(model.joint_names) - len(names)  # a floating base is in the transforms
    yield 0.0, "/robot_description", {"data": robot.text}
    for k, t in enumerate(log.t.tolist()):
        stamp = _stamp(t, begin)
        transforms = [
            {
                "timestamp": stamp, "parent_frame_id": WORLD, "child_frame_id": link,
                "translation": dict(zip("xyz", pose[:3, 3].tolist(), strict=True)),
                "rotation": dict(zip("xyzw", _quaternion(pose), strict=True)),
            }
            for link, pose in model.link_poses(log.q[k]).items()
            if link != WORLD
        ]  # fmt: skip
        yield t, "/tf", {"transforms": transforms}
        yield t, "/joint_states", {
            "header": {"stamp": stamp, "frame_id": ""}, "name": names,
            "position": _numbers(model.coordinates(log.q[k])[first:]),
            "velocity": _numbers(log.v[k][first:]), "effort": [],
        }  # fmt: skip
        for name, channel in log.channels.items():
            if name != "t" and k < len(channel.values):
                row = np.atleast_1d(channel.values[k])
                values = [str(x) for x in row] if channel.text else _numbers(row)
                yield t, _topic(name), dict(zip(_columns(channel), values, strict=True))


def _stamp(t: float, begin: int = 0) -> dict[str, int]:
    """A time (s) after `begin` (ns) as seconds and nanoseconds."""
    seconds, rest = divmod(begin + round(t * NANO), NANO)
    return {"sec": seconds, "nsec": rest}


def _numbers(row: np.ndarray) -> list[float | None]:
    """The numbers of a row; None for those that are not finite, which JSON lacks."""
    return [x if math.isfinite(x) else None for x in row.tolist()]


def _quaternion(pose: np.ndarray) -> list[float]:
    """The quaternion (x, y, z, w) of a pose (4, 4)."""
    found: list[float] = Rotation.from_matrix(pose[:3, :3]).as_quat().tolist()
    return found
