"""The log of a run: its file, figures and text."""

import csv
import io
import json
import math
import os
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import softdyn
from softdyn import FormatError, SetPoint
from softdyn.controllers import Impedance, Mpc, SoftIdClfQp
from softdyn.description.robot import input_unit
from softdyn.identification.data import read_csv
from softdyn.tasks import AxisTask, PointTask, References
from softdyn.tasks.marks import marks_of
from softdyn.validation import Log, Rig, paper, simulate
from tests.support import robots
from tests.support.cart import TARGET, steer
from tests.support.command import command
from tests.support.logs import assert_same, channel, make_log
from tests.support.refused import refused


@pytest.fixture
def log(cart):
    experiment = replace(paper.set_point("finger", 0.5), duration=0.03, period=0.0075)
    return simulate(cart, steer, experiment)


@pytest.mark.parametrize("file", ["run.npz", "run.csv"])
def test_a_saved_log_comes_back_exactly(log, tmp_path, file):
    """From NPZ and from CSV."""
    if file.endswith(".csv"):
        log.to_csv(tmp_path / file)
        again = Log.from_csv(tmp_path / file)
    else:
        log.save(tmp_path / file)
        again = Log.load(tmp_path / file)
    assert_same(log, again)
    assert again.versions["mujoco"]
    beside = ["run.csv.json"] if file.endswith(".csv") else []  # the record
    written = sorted(path.name for path in tmp_path.iterdir() if path.suffix != ".urdf")
    assert written == [file, *beside]


ANY = st.floats(allow_nan=False, allow_infinity=False)


@given(data=st.data(), steps=st.integers(1, 4))
@settings(max_examples=15, deadline=None, derandomize=True,
          suppress_health_check=[HealthCheck.function_scoped_fixture])  # fmt: skip
@pytest.mark.parametrize("file", ["run.npz", "run.csv"])
def test_any_numbers_come_back_exactly(tmp_path, file, data, steps):
    """Also the smallest and the largest ones, and a zero with a sign."""

    def drawn(*shape: int) -> np.ndarray:
        size = int(np.prod(shape))
        return np.array(data.draw(st.lists(ANY, min_size=size, max_size=size))).reshape(shape)

    t = 0.1 * np.arange(steps + 1)
    far = np.array([np.finfo(float).max])
    log = make_log(t, drawn(steps + 1, 3), q=drawn(steps + 1, 2), v=drawn(steps + 1, 2),
                   u=drawn(steps, 1), V=drawn(steps), u_min=-far, u_max=far)  # fmt: skip
    path = tmp_path / file
    if file.endswith(".csv"):
        log.to_csv(path)
    else:
        log.save(path)
    assert_same(log, Log.from_csv(path) if file.endswith(".csv") else Log.load(path))


def test_a_csv_that_is_no_log_is_refused(log, tmp_path):
    log.to_csv(tmp_path / "run.csv")
    rows = [line.split(",") for line in (tmp_path / "run.csv").read_text().splitlines()]
    (tmp_path / "own.csv").write_text("\n".join(",".join(row[:4]) for row in rows))
    with refused("own.csv: header", "neither"):
        Log.from_csv(tmp_path / "own.csv")
    for old, new in (("softdyn-log-5", "softdyn-log-6"), ("0.03", "zero"), ("{", "")):
        text = (tmp_path / "run.csv").read_text().replace(old, new)
        (tmp_path / "bad.csv").write_text(text)
        with refused("bad.csv"):
            Log.from_csv(tmp_path / "bad.csv")


def test_a_recording_is_a_log_of_the_robot_that_is_given(tmp_path):
    """Only times, joints and readings, from a clock that does not begin at 0, with a gap."""
    model = softdyn.load("finger")
    log = simulate(model, Impedance(model), paper.set_point("finger", 0.5), duration=0.1)
    titles = ["t", *(f"q.{name}" for name in model.joint_names), "measured.ruler"]
    rows = [
        [7.0 + t, *q, "" if k == 3 else k]
        for k, (t, q) in enumerate(zip(log.t, log.q, strict=True))
    ]
    path = tmp_path / "bench.csv"
    path.write_text("\n".join(",".join(map(str, row)) for row in (titles, *rows)))
    found = Log.from_csv(path, model)
    np.testing.assert_array_equal(found.q, log.q)
    np.testing.assert_allclose(found.y, log.y, atol=1e-12)
    np.testing.assert_allclose(found.t, log.t, atol=1e-12)
    moved = 0.5 * np.diff(found.t) @ (found.v[1:] + found.v[:-1])
    np.testing.assert_allclose(moved, log.q[-1] - log.q[0], atol=0.02)
    assert np.flatnonzero(np.isnan(found.measured[:, 0])).tolist() == [3]
    assert found.controller == "bench.csv"
    assert np.isnan(found.error).all()
    found.save(tmp_path / "bench.npz")
    assert_same(found, Log.load(tmp_path / "bench.npz"))
    page = tmp_path / "page.html"
    assert command("replay", path, "--robot", "finger", "--html", page).code == 0
    assert page.stat().st_size > 10_000
    log.to_csv(tmp_path / "run.csv")
    assert command("replay", tmp_path / "run.csv", "--html", tmp_path / "run.html").code == 0
    path.write_text(path.read_text().replace("q.joint2", "q.joint9"))
    refused = command("replay", path, "--robot", "finger", "--html", page)
    assert refused.code == 2
    assert "one column q.joint2" in refused.err


def test_a_log_of_a_large_robot_fits_in_the_cells_of_a_csv(log, tmp_path):
    long = replace(log, source=replace(log.source, text=log.source.text + " " * 200_000))
    long.to_csv(tmp_path / "run.csv")
    assert Log.from_csv(tmp_path / "run.csv").source == long.source


def test_a_log_of_no_steps_comes_back(cart, tmp_path):
    log = simulate(cart, lambda state, reference: None, TARGET)
    log.save(str(tmp_path / "no suffix added"))
    assert Log.load(tmp_path / "no suffix added").reason == log.reason


def test_arrays_of_a_log_are_read_only(log):
    with pytest.raises(ValueError, match="read-only"):
        log.error[0] = 0.0


def test_a_failed_write_leaves_the_old_file(log, tmp_path, monkeypatch):
    path = tmp_path / "run.npz"
    log.save(path)
    before = path.read_bytes()

    def no_space(*arguments, **named):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(np, "savez_compressed", no_space)
    with refused("run.npz", "No space left on device"):
        log.save(path)
    assert path.read_bytes() == before
    assert sorted(p.name for p in tmp_path.iterdir()) == ["robot.urdf", "run.npz"]


@pytest.mark.parametrize(
    ("where", "got"),
    [("no/such/folder/run.npz", "No such file or directory"), (".", "Is a directory")],
)
def test_a_log_cannot_be_written_there(log, tmp_path, where, got):
    with refused(str(tmp_path / where), got):
        log.save(tmp_path / where)


def test_what_is_no_log_is_refused(log, tmp_path):
    path = tmp_path / "run.npz"
    log.save(path)
    content = path.read_bytes()
    pickled, array, foreign = io.BytesIO(), io.BytesIO(), io.BytesIO()
    np.savez(pickled, about=np.array({"a": 1}, dtype=object), t=np.zeros(1))
    np.save(array, np.zeros(3))
    np.savez(foreign, x=np.zeros(3))
    files = (b"", b"text", content[: len(content) // 2], content[:-30], pickled.getvalue(),
             array.getvalue(), foreign.getvalue())  # fmt: skip
    for data in files:
        path.write_bytes(data)
        with refused("run.npz"):
            Log.load(path)
    for missing in (tmp_path / "none.npz", tmp_path):
        with refused(str(missing)):
            Log.load(missing)


@pytest.mark.parametrize(
    "change",
    [
        {"t": np.zeros(3)}, {"u": np.zeros((4, 1, 1))}, {"V": np.zeros(5)}, {"t": np.array(0.0)},
        {"error": np.zeros((5, 2))}, {"status": np.zeros(4)}, {"q": np.full((5, 1), "a")},
        {"v": np.zeros((5, 2))}, {"q": np.zeros((5, 1), int)},
        {"about": np.array("{}")}, {"about": np.array("[1]")}, {"about": np.array("{")},
        {"about": np.array(json.dumps({"format": "softdyn-log-2"}))}, {"about": np.zeros(2)},
    ],
    ids=lambda c: next(iter(c)),
)  # fmt: skip
def test_an_inconsistent_log_is_refused(log, tmp_path, change):
    path = tmp_path / "run.npz"
    log.save(path)
    with np.load(path) as file:
        content = {name: file[name] for name in file.files}
    assert len(content["t"]) == 5
    np.savez(path, **{**content, **change})
    with refused("run.npz"):
        Log.load(path)


def parts(path):
    with np.load(path) as file:
        content = {name: file[name] for name in file.files}
    return json.loads(str(content.pop("about"))), content


def with_first(array, value):
    return np.concatenate(([np.full_like(array[0], value)], array[1:]))


@pytest.mark.parametrize(
    "change",
    [
        {"robot": None}, {"robot": 1}, {"controller": ["ic"]}, {"theta": "0.5"}, {"theta": True},
        {"omega": -1},
        {"duration": math.nan}, {"duration": "long"}, {"duration": 9.0}, {"period": 0.0},
        {"timestep": None}, {"length": -1.0}, {"channels": "x"}, {"channels": {}},
        {"channels": {"t": {}}}, {"u_min": [0.0, 0.0]}, {"u_min": [math.inf]}, {"contacts": 0},
        {"complete": "yes"}, {"failed": True},
        {"failed": None}, {"reason": "why"}, {"reason": 3}, {"not_solved": "many"},
        {"not_solved": 1.5}, {"not_solved": True}, {"fallbacks": 10**60}, {"versions": None},
        {"versions": {"mujoco": 3}}, {"max_bound_violation": math.nan},
        {"max_bound_violation": -1.0}, {"u_unit": None}, {"another": 1}, {"gains": ...},
    ],
    ids=str,
)  # fmt: skip
def test_what_a_log_says_of_its_run_is_checked(log, tmp_path, change):
    path = tmp_path / "run.npz"
    log.save(path)
    about, arrays = parts(path)
    about = {name: value for name, value in (about | change).items() if value is not ...}
    np.savez(path, about=np.array(json.dumps(about)), **arrays)
    with refused("run.npz") as error:
        Log.load(path)
    assert len(str(error.value).splitlines()) == 1


@pytest.mark.parametrize(
    ("name", "change"),
    [
        ("t", lambda t: with_first(t, math.nan)), ("t", lambda t: t[::-1]), ("t", np.zeros_like),
        ("t", lambda t: t + 1), ("q", lambda q: with_first(q, math.nan)),
        ("v", lambda v: with_first(v, math.inf)), ("error", lambda e: e + 1.0),
        ("y", lambda y: y + 1.0), ("u", lambda u: with_first(u, math.nan)),
        ("u", lambda u: with_first(u, 1e9)),
        ("step_us", lambda s: -1 - s), ("step_us", lambda s: with_first(s, math.inf)),
        ("t", lambda t: t.astype(">f8")), ("q", lambda q: q.astype(np.float32)),
        ("about", lambda _: np.array("[" * 10_000 + "]" * 10_000)),
        ("about", lambda _: np.array('{"format": ' + "9" * 5000 + "}")),
        ("extra", lambda _: np.zeros(2)), ("V", lambda _: None),
    ],
)  # fmt: skip
def test_arrays_that_no_run_has_are_refused(log, tmp_path, name, change):
    path = tmp_path / "run.npz"
    log.save(path)
    about, arrays = parts(path)
    arrays["about"] = np.array(json.dumps(about))
    arrays[name] = change(arrays.get(name))
    np.savez(path, **{key: array for key, array in arrays.items() if array is not None})
    with refused("run.npz") as error:
        Log.load(path)
    assert len(str(error.value).splitlines()) == 1


def test_a_log_of_an_older_version_is_named(log, tmp_path):
    np.savez(tmp_path / "old.npz", about=np.array(json.dumps({"format": "softdyn-log-1"})))
    with refused("old.npz", "softdyn-log-1, of another version of softdyn", by=FormatError):
        Log.load(tmp_path / "old.npz")


def test_a_log_has_the_bounds_and_the_unit_of_its_input(log, cart):
    np.testing.assert_array_equal(log.u_min, cart.u_min)
    np.testing.assert_array_equal(log.u_max, cart.u_max)
    (actuator,) = cart.robot.actuators
    assert log.u_unit == ("N" if actuator.gear == 1 else f"{actuator.gear:g} N")
    assert input_unit(softdyn.load("spirob").robot) == "10 N"
    assert input_unit(softdyn.load("finger").robot) == "0.1 N m"


def test_files_are_written_for_everyone_as_usual(log, tmp_path):
    mask = os.umask(0o022)
    try:
        log.save(tmp_path / "run.npz")
    finally:
        os.umask(mask)
    assert Path(tmp_path / "run.npz").stat().st_mode & 0o777 == 0o644


def test_a_report_and_a_summary_say_the_same(log):
    report = log.report()
    assert report["final_error_cm"] == log.final_error_cm
    assert report["step_us"] == log.step_times_us
    text = log.summary({"final_error_cm": "a note"})
    assert f"final error    {log.final_error_cm:.3f} cm   a note" in text
    assert f"mean |e|^2     {log.mse_cm2:.3f} cm²\n" in text
    assert "set point at 0.5 pi" in text
    assert "not reached: |e| fell from" in text
    failed = replace(log, failed=True, reason="why", theta=None).summary()
    assert failed.endswith("failed: why")
    assert "set point at 0.12" in failed


def test_a_log_as_csv_is_what_identify_reads(tmp_path):
    model = softdyn.load("finger")
    log = simulate(model, Impedance(model), paper.set_point("finger", 0.5), duration=0.1)
    log.to_csv(tmp_path / "run.csv")
    lines = (tmp_path / "run.csv").read_text().splitlines()
    header = lines[0].split(",")
    assert header[:4] == ["t (s)", "u.u1 (0.1 N m)", "u.u2 (0.1 N m)", "q.joint1 (rad)"]
    axes = [f"{kind}.{axis} (m)" for kind in ("tip", "target", "error") for axis in "xyz"]
    assert header[11:20] == axes
    assert header[-1] == "log"
    table = np.array([line.split(",")[:20] for line in lines[1:]], float)
    held = np.concatenate([log.u, log.u[-1:]])
    whole = np.column_stack([log.t, held, log.q, log.v, log.y, log.y_ref, log.error])
    np.testing.assert_array_equal(table, whole)
    read = read_csv(tmp_path / "run.csv", model)
    assert read.names == (*(f"q.{name}" for name in model.joint_names), "tip.x", "tip.y", "tip.z")
    np.testing.assert_array_equal(read.u[:-1], log.u)
    np.testing.assert_array_equal(read.outputs, np.column_stack([log.q, log.y]))


def test_a_floating_robot_s_log_as_csv(tmp_path):
    file = robots.write(tmp_path, robots.GRIPPER)
    model = softdyn.load(file, floating=True)
    log = simulate(model, lambda *_: SimpleNamespace(u=np.zeros(model.nu)), SetPoint(np.zeros(3)),
                   duration=0.01)  # fmt: skip
    log.to_csv(tmp_path / "run.csv")
    assert_same(log, Log.from_csv(tmp_path / "run.csv"))
    head = (tmp_path / "run.csv").read_text().splitlines()[0]
    assert "q.base.qw" in head
    assert head.count("q.") == model.nq


def test_a_rigged_run_as_csv_has_its_commands_and_readings(tmp_path):
    """A winch's command is in metres, and the columns are the log's arrays."""
    model = robots.load(tmp_path, robots.WINCHED)
    rig = Rig(command="velocity", stiffness=500.0, latency=0.004, noise=1e-4)
    made = simulate(model, lambda state, _: np.full(2, 3.0), SetPoint(np.zeros(3)), duration=0.02,
                    rig=rig)  # fmt: skip
    made.save(tmp_path / "run.npz")
    log = Log.load(tmp_path / "run.npz")
    log.to_csv(tmp_path / "run.csv")
    assert_same(log, Log.from_csv(tmp_path / "run.csv"))
    lines = [*csv.reader((tmp_path / "run.csv").open(encoding="utf-8"))]
    table = {name: column for name, *column in zip(*lines, strict=True)}
    for title, column in {
        "command.flexor (m/s)": log.command[:, 0],
        "acting.extensor (N)": log.acting[:, 1],
        "measured.load (N)": log.measured[:, log.sensor_names.index("load")],
        "measured.camera.rz (rad)": log.measured[:, log.sensor_names.index("camera.rz")],
        "measured.imu.y (m/s²)": log.measured[:, log.sensor_names.index("imu.y")],
        "q_seen.elbow (rad)": log.q_seen[:, 1],
        "v_seen.elbow (rad/s)": log.v_seen[:, 1],
    }.items():
        np.testing.assert_array_equal(np.array(table[title][: len(column)], float), column)
    assert np.ptp(log.command[:, 0]) > 0
    read = read_csv(tmp_path / "run.csv", model)  # identify skips the columns of the rig
    assert "tip.x" in read.names


def test_a_run_of_tasks_comes_back_and_its_csv_has_their_errors(tmp_path):
    model = softdyn.load("finger")
    tasks = [PointTask("tip"), AxisTask("tip", [1, 0, 0])]
    log = simulate(model, Mpc(model, tasks=tasks), SetPoint([0.1, 0, -0.1]), duration=0.02)
    log.save(tmp_path / "run.npz")
    again = Log.load(tmp_path / "run.npz")
    np.testing.assert_array_equal(again.tasks, log.tasks)
    assert again.columns("tasks") == (("tip", "m"), ("tip.axis", "rad"))
    goals = "goal.tip.x (m),goal.tip.y (m),goal.tip.z (m)"
    ways = "goal.tip.axis.dx,goal.tip.axis.dy,goal.tip.axis.dz"
    log.to_csv(tmp_path / "run.csv")
    titles = (tmp_path / "run.csv").read_text().splitlines()[0]
    assert titles.endswith(f",task.tip (m),task.tip.axis (rad),{goals},{ways},log")
    assert again.marks == log.marks == marks_of(tasks)
    np.testing.assert_array_equal(again.targets[-1], [0.1, 0, -0.1, 1, 0, 0])
    for place, broken in (
        ("mark", {"link": 3}),
        ("mark", {"kind": "way"}),
        ("mark: vector", {"vector": [0, np.nan, 0]}),
    ):
        path = tmp_path / "marks.npz"
        content = dict(np.load(tmp_path / "run.npz"))
        about = json.loads(content.pop("about").item())
        about["marks"][0] |= broken
        np.savez(path, about=np.array(json.dumps(about)), **content)
        with refused(f"marks.npz: {place}"):
            Log.load(path)
    assert "tip.x" in read_csv(tmp_path / "run.csv", model).names
    assert log.verdict().missed_tasks == ("tip",)
    assert log.report()["missed_tasks"] == ["tip"]
    assert log.summary().endswith("not reached: beyond their tolerance: tip")
    close = np.full_like(log.tasks, 0.9 * log.verdict().tolerance)  # m, and 0.9 % of a radian
    close[:, 1] /= log.length
    assert log.altered(tasks=close).verdict().missed_tasks == ()
    assert log.altered(tasks=close).verdict().reached  # although the tip alone does not count
    assert log.altered(tasks=close).summary().endswith("reached: all tasks within their tolerance")
    close = close * [1, 1.2]
    assert log.altered(tasks=close).verdict().missed_tasks == ("tip.axis",)


UNITS = [("mid", "m"), ("mid.axis", "rad")]


def test_a_task_counts_at_the_end_too_and_a_task_that_moves_over_the_last_half():
    t = np.linspace(0, 10, 1001)
    late = np.zeros((1001, 2))
    late[-3:, 1] = 0.05  # beyond the tolerance at the end, within it as rms of the last tenth
    log = make_log(
        t, np.full((1001, 3), 0.1), channel("tasks", late, columns=UNITS),
        channel("targets", np.zeros((1001, 6))), length=0.5,
    )  # fmt: skip
    assert not log.moving
    assert log.verdict().missed_tasks == ("mid.axis",)
    turning = np.column_stack((np.zeros((1001, 4)), np.sin(t), np.cos(t)))  # the axis alone moves
    moving = log.altered(targets=turning)
    assert moving.moving
    assert moving.verdict().reached
    half = np.where(t > 5, 0.02, 0.0)[:, None] * [0, 1]  # the first of the judged half
    half[t > 9] = 0.0
    assert moving.altered(tasks=half).verdict().missed_tasks == ("mid.axis",)
    assert log.altered(tasks=half).verdict().reached
    own = log.altered(channel("tasks", late, columns=[("mid", ""), ("mid.axis", "kg")]))
    # no unit to judge them by: the tip counts
    assert not own.verdict().by_tasks
    assert not own.verdict().reached


def test_without_the_tips_place_as_a_task_its_error_may_grow():
    model = softdyn.load("finger")
    link = model.robot.chain("tip")[3].child
    goal = SetPoint(model.link_poses(model.q0)[link][:3, 3] + [0.02, 0, 0])
    controller = SoftIdClfQp(model, tasks=[PointTask(link)])
    log = simulate(model, controller, References({link: goal}), duration=0.2)
    distance = np.linalg.norm(log.error, axis=1)  # of the tip from the other link's target
    assert distance[-1] > distance[0]
    assert not log.failed
    assert log.verdict().missed_tasks == (link,)
