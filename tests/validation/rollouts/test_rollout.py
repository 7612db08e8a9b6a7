"""Rollouts on a cart, against its closed form, and one path of computing against the other."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest

import softdyn
from softdyn import InputError
from softdyn.validation import Integrator, Log, Rig, rollout, rollouts
from softdyn.validation.rollouts import threads
from tests.support.cart import LENGTH, step_response, text
from tests.support.command import command
from tests.support.logs import assert_same
from tests.support.refused import refused
from tests.support.robots import load, slide


@pytest.fixture(scope="module")
def cart(tmp_path_factory):
    return load(tmp_path_factory.mktemp("cart"), text(-20, 20))


@pytest.fixture(scope="module")
def arm():
    return softdyn.load("spirob")


@pytest.mark.parametrize(("scheme", "order"), [(Integrator.IMPLICITFAST, 1), ("rk4", 4)])
def test_the_motion_is_the_closed_form_s_at_the_scheme_s_order(cart, scheme, order):
    errors = []
    for step in (0.02, 0.01):
        log = rollout(cart, [4.0], 2.0, period=0.1, timestep=step, integrator=scheme)
        errors.append(np.abs(log.q[:, 0] - step_response(log.t, 4.0)).max())
    assert errors[1] < 0.02
    assert math.log2(errors[0] / errors[1]) == pytest.approx(order, abs=0.15)
    assert np.array_equal(log.y[:, 0], log.q[:, 0] + LENGTH)


def test_the_same_inputs_in_each_form(cart):
    constant = rollout(cart, [1.5], 0.1)
    assert len(constant.t) == 51  # 2 ms
    assert_same(rollout(cart, [[1.5]] * 50, 0.1), constant)
    assert_same(rollout(cart, lambda t: [1.5], 0.1), constant)
    assert_same(rollout(cart, [[1.5]] * 9, 0.1, hold=0.02, period=0.002), constant)


def test_rows_are_held_and_the_last_is_cut(cart):
    log = rollout(cart, [[1.0], [2.0], [3.0]], 0.025, hold=0.01, period=0.005)
    assert log.u[:, 0].tolist() == [1, 1, 2, 2, 3]
    assert log.t.tolist() == pytest.approx([0, 0.005, 0.01, 0.015, 0.02, 0.025])
    moving = rollout(cart, lambda t: [100 * t], 0.025, period=0.005)
    assert moving.u[:, 0] == pytest.approx([0, 0.5, 1, 1.5, 2])


@pytest.mark.parametrize("options", [{}, {"integrator": "rk4", "timestep": 1e-4, "friction": True}])
def test_threads_and_the_loop_agree_to_the_bit(arm, options, monkeypatch):
    rng = np.random.default_rng(0)
    batch = rng.uniform(0, 5, (3, 4, arm.nu))
    start = {"q0": rng.uniform(-0.2, 0.2, arm.nq), "v0": rng.uniform(-1, 1, arm.nv)}
    found = rollouts(arm, batch, 0.2, **start, **options)
    monkeypatch.setattr(threads, "fits", lambda *_: False)
    for log, inputs in zip(found, batch, strict=True):
        assert_same(log, rollout(arm, inputs, 0.2, **start, **options))


@pytest.mark.parametrize("options", [{}, {"rig": Rig(lag=0.02)}])
def test_each_run_has_its_own_start(arm, options):
    """In threads and in processes; the record repeats the run."""
    rng = np.random.default_rng(2)
    batch = rng.uniform(0, 5, (3, arm.nu))
    q0, v0 = rng.uniform(-0.2, 0.2, (3, arm.nq)), rng.uniform(-1, 1, (3, arm.nv))
    found = rollouts(arm, batch[:, None], 0.05, q0=q0, v0=v0, **options)
    for k, log in enumerate(found):
        alone = rollout(arm, batch[k], 0.05, q0=q0[k], v0=v0[k], **options)
        assert_same(log, alone)
        assert log.record["settings"] == alone.record["settings"]
    moving = rollouts(arm, batch, 0.01, v0=v0, **options)
    np.testing.assert_allclose([log.v[0] for log in moving], v0, rtol=1e-12)


def test_a_batch_in_parts_is_the_same(arm, monkeypatch):
    batch = np.random.default_rng(1).uniform(0, 5, (5, 3, arm.nu))
    whole = rollouts(arm, batch, 0.05)
    monkeypatch.setattr(threads, "MOST", 16 * 110 * (1 + 2 * arm.nv + 2 * arm.nu))
    for one, other in zip(whole, rollouts(arm, batch, 0.05), strict=True):
        assert_same(one, other)


@pytest.mark.parametrize(
    ("name", "start"),
    [
        ("q0", {"q0": np.zeros((3, 27))}), ("q0", {"q0": np.zeros((2, 3))}),
        ("v0", {"v0": np.full((2, 27), np.nan)}), ("q0", {"q0": [[0.0] * 27, [9.0] * 27]}),
    ],
)  # fmt: skip
def test_starts_that_do_not_fit_are_refused(arm, name, start):
    with pytest.raises(InputError) as caught:
        rollouts(arm, np.zeros((2, arm.nu)), 0.01, **start)
    assert caught.value.name == name


def test_runs_behind_a_rig_are_in_processes_and_the_same(arm, monkeypatch):
    monkeypatch.setenv("LOKY_MAX_CPU_COUNT", "2")
    rig, batch = Rig(lag=0.02, delay=0.003), [np.full(arm.nu, u) for u in (0.5, 2.0)]
    found = rollouts(arm, batch, 0.04, rig=rig)
    for log, u in zip(found, batch, strict=True):
        assert_same(log, rollout(arm, u, 0.04, rig=rig))
        assert log.acting[-1] == pytest.approx(u * (1 - math.exp(-(0.04 - 0.003) / 0.02)), rel=0.02)


def test_a_run_that_diverges_ends_alone_and_says_why(cart):
    options = {"period": 3.0, "timestep": 3.0, "integrator": "rk4"}  # stable up to 2.8 / ω = 0.7 s
    still, gone = rollouts(cart, [[0.0], [9.0]], 30.0, **options)
    assert still.complete
    assert not still.failed
    assert gone.failed
    assert not gone.complete
    assert "diverged at t = " in gone.reason


def test_a_rollout_is_a_log(cart, tmp_path):
    log = rollout(cart, [[1.0], [-1.0]], 0.04)
    log.save(tmp_path / "run.npz")
    read = Log.load(tmp_path / "run.npz")
    assert_same(read, log)
    assert "rollout" in str(read)
    assert "nan" not in str(read)
    assert [track.aims for run in log.show().runs for track in run.tracks] == [False]
    log.plot(tmp_path / "run.png")
    log.to_csv(tmp_path / "run.csv")
    assert "target" not in (tmp_path / "run.csv").read_text().splitlines()[0]
    done = command(
        "rollout",
        cart.robot.path,
        "--inputs",
        tmp_path / "run.csv",
        "--log",
        tmp_path / "again.npz",
    )
    assert done.code == 0, done.err
    again = Log.load(tmp_path / "again.npz")
    assert_same(replace(again, robot=log.robot), log)


def test_the_command(cart):
    done = command("rollout", cart.robot.path, "--u", "2", "--seconds", "0.1", "--json", "-")
    assert done.code == 0, done.err
    told = json.loads(done.out)
    assert told["final_tip"] == rollout(cart, [2.0], 0.1).y[-1].tolist()
    assert told["wall_s"] > 0
    still = command("rollout", cart.robot.path, "--seconds", "0.1")
    assert "tip at the end 0.4 0 0 m" in still.out


def test_several_files_at_once(cart, tmp_path):
    import json

    files = [tmp_path / f"{name}.csv" for name in ("weak", "strong", "slow")]
    for file, force, step, rows in zip(
        files, (1, 3, 2), (0.01, 0.01, 0.02), (30, 20, 9), strict=True
    ):
        lines = [f"{step * k:.2f},{force}" for k in range(rows + 1)]
        file.write_text("\n".join(["t,u.u", *lines]) + "\n")
    base = ["rollout", cart.robot.path, "--inputs"]
    page, plot, out = tmp_path / "all.html", tmp_path / "all.png", tmp_path / "out"
    done = command(
        *base, *files[:2], "--out", out, "--html", page, "--plot", plot, "--json", "-"
    )  # fmt: skip
    assert done.code == 0, done.err
    told = json.loads(done.out)
    assert told["seconds"] == 0.2
    for name, force in (("weak", 1.0), ("strong", 3.0)):
        alone = rollout(cart, [[force]] * 20, 0.2)
        assert told["runs"][name]["final_tip"] == alone.y[-1].tolist()
        assert np.array_equal(Log.load(out / f"{name}.npz").q, alone.q)
    assert all(name in page.read_text() for name in ("weak", "strong"))
    assert plot.stat().st_size > 10_000
    for arguments, said in (
        ([files[0], files[2]], "slow.csv: expected rows 0.01 s apart, as in"),
        ([files[0], files[0]], "--inputs: expected files with different names, got weak, weak"),
        ([*files[:2], "--log", "run.npz"], "--log: expected --out FOLDER with several --inputs"),
    ):
        refused = command(*base, *arguments)
        assert refused.code == 2
        assert said in refused.err


NAN = math.nan


@pytest.mark.parametrize(
    ("inputs", "options", "said"),
    [
        ([1.0, 2.0], {}, "inputs: expected numbers of shape (1,), got shape (2,)"),
        ([[1.0, 2.0]] * 3, {}, "inputs: expected numbers of shape (3, 1), got shape (3, 2)"),
        ([NAN], {}, "input 'u' at t = 0 s: expected -20 to 20, its bounds, got nan"),
        (
            lambda t: [NAN if t > 0.05 else 0.0],
            {},
            "input 'u' at t = 0.052 s: expected -20 to 20, its bounds, got nan",
        ),
        (lambda t: [0.0, 0.0], {}, "inputs(t): expected numbers of shape (1,), got shape (2,)"),
        ("rest", {}, "expected (1,), (steps, 1) or a function t -> (1,), got 'rest'"),
        (np.zeros((2, 2, 1)), {}, "inputs: expected numbers of shape (2, 1)"),
        ([[0.0], [0.0, 1.0]], {}, "inputs: expected numbers of shape (2, 1)"),
        (np.zeros((0, 1)), {}, "inputs: expected numbers of shape (1,), got shape (0, 1)"),
        ([[0.0], [21.0]], {}, "input 'u' at t = 0.05 s: expected -20 to 20, its bounds, got 21"),
        (lambda t: [-400 * t], {}, "input 'u' at t = 0.052 s: expected -20 to 20"),
        ([[0.0]] * 3, {"hold": 0.01}, "expected rows for 0.1 s, held 0.01 s each, got 3 rows"),
        ([0.0], {"hold": 0.01}, "hold: expected none where the inputs are no rows"),
        ([[0.0]] * 10, {"period": 0.004}, "period: expected an integer part of a row's 0.01 s"),
        ([0.0], {"timestep": 0.0015}, "timestep: expected an integer part of the period"),
        ([0.0], {"integrator": "verlet"}, "integrator: expected implicitfast or implicit or euler"),
        ([0.0], {"q0": [0.0, 0.0]}, "q0: expected finite numbers of shape (1,)"),
        ([0.0], {"rig": "none"}, "rig: expected None"),
    ],
)
def test_wrong_inputs(cart, inputs, options, said):
    with pytest.raises(InputError) as error:
        rollout(cart, inputs, 0.1, **options)
    assert said in str(error.value)


def test_a_batch_has_one_period(cart):
    with refused("batch[1]", "0.001 s"):
        rollouts(cart, [[0.0], [[0.0]] * 100], 0.1)
    for batch in ([], 3.0):
        with refused("batch"):
            rollouts(cart, batch, 0.1)


ROWS = "t,u.u\n0,1\n0.01,2\n0.02,3\n0.03,0\n"


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (ROWS.replace("u.u", "u.v"), "header: expected t, u.u, got 'u.v'; did you mean 'u.u'?"),
        (ROWS.replace("u.u", "q.x"), "expected one column u.u, got 0 of them"),
        (ROWS.replace("0.02,3", "0.02,nan"), ":4: column u.u: expected a finite number, got 'nan'"),
        (ROWS.replace("0.02,3", "0.02"), ":4: expected 2 cells, got 1"),
        (ROWS.replace("0.02", "0.015"), ":4: column t: expected times from 0 in even steps"),
        (ROWS.replace("0.02", "0.005"), ":4: column t: expected times from 0 in even steps"),
        (ROWS.replace("0,1\n", "0.005,1\n", 1), ":2: column t: expected times from 0"),
        ("t,u.u\n0,1\n", "expected two rows or more, got 1"),
        (ROWS.replace("t,", "t (ms),"), "header: expected t in s, got 't (ms)'"),
        (ROWS.replace(",3", ",30"), "input 'u' at t = 0.02 s: expected -20 to 20"),
    ],
)
def test_wrong_files_are_one_line(cart, text, said, tmp_path):
    (tmp_path / "inputs.csv").write_text(text)
    done = command("rollout", cart.robot.path, "--inputs", tmp_path / "inputs.csv")
    assert done.code == 2
    assert done.err.count("\n") == 1
    assert said in done.err


def test_a_file_is_held_row_by_row(cart, tmp_path):
    (tmp_path / "inputs.csv").write_text(ROWS)
    log = tmp_path / "run.npz"
    assert (
        command("rollout", cart.robot.path, "--inputs", tmp_path / "inputs.csv", "--log", log).code
        == 0
    )
    assert Log.load(log).u[::5, 0].tolist() == [1, 2, 3]
    late = command(
        "rollout", cart.robot.path, "--inputs", tmp_path / "inputs.csv", "--seconds", "1"
    )
    assert "expected rows for 1 s" in late.err


# a cable pulls a cart round a corner of 90 degrees; a spring holds what friction leaves of it
ROPE = slide(
    0.1, 1e-4, at="0.3 0 0", limit=(-0.15, 0.15), damping=8, stiffness=200,
    pull=(0, 20), gear=-1, path=("base 0 0 0.2", "base 0 0 0", "block 0 0 0"),
    tendon={"friction": 0.2, "driven": "first"},
)  # fmt: skip


def test_friction_is_that_of_cables_too(tmp_path):
    (tmp_path / "rope.urdf").write_text(ROPE)
    file = str(tmp_path / "rope.urdf")
    ends = []
    for words in ((), ("--friction",), ("--rig",)):
        done = command("rollout", file, "--u", "10", "--seconds", "2", *words, "--json", "-")
        ends.append(json.loads(done.out)["final_tip"][0])
    assert ends[0] == pytest.approx(0.3 - 10 / 200)
    assert ends[1] == ends[2]
    # it sticks within the band that friction leaves, near the end where it came from
    assert ends[1] == pytest.approx(0.3 - 10 * np.exp(-0.2 * np.pi / 2) / 200, abs=2e-4)


def test_options_without_use_say_so(cart):
    file = str(cart.robot.path)
    for option in ("--friction", "--rig"):
        with pytest.warns(UserWarning, match=f"{option} changes nothing"):
            done = command("rollout", file, "--u", "0", "--seconds", "0.01", option)
        assert done.code == 0


# -- commands of motors instead of forces ----------------------------------------------------------

STRETCH = 0.2 * 9.81 / 500


def hoist(folder, motor):
    winch = {"stiffness": 500, "damping": 5, "length_lower": 0.1, "length_upper": 1}
    drive = {"command": motor, **winch} if motor != "force" else {}
    return load(folder, slide(
        0.2, 1e-5, axis="0 0 -1", at="0 0 -0.3", limit=(-0.2, 0.4), damping=3, pull=(0, 30),
        gear=-1, path=("base 0 0 0", "block 0 0 0"), drive={"name": "winch", **drive},
    ))  # fmt: skip


def test_free_lengths_in_open_loop(tmp_path):
    """A load hangs on its stretched cable, then rests on its stop with the cable slack."""
    model = hoist(tmp_path, "length")
    rows = [f"{0.1 * k:.1f},{0.5 if k < 15 else 1.0}" for k in range(31)]
    (tmp_path / "lengths.csv").write_text("\n".join(["t,command.winch (m)", *rows]) + "\n")
    words = ("--inputs", tmp_path / "lengths.csv", "--rig", "--log", tmp_path / "run.npz")
    done = command("rollout", model.robot.path, *words)
    assert done.code == 0, done.err
    log = Log.load(tmp_path / "run.npz")
    hanging, slack = np.searchsorted(log.t, (1.498, 2.998))
    assert log.y[hanging, 2] == pytest.approx(-0.5 - STRETCH, abs=1e-6)
    assert log.acting[hanging] == pytest.approx([0.2 * 9.81], abs=1e-4)
    assert log.u[hanging] == pytest.approx([0.2 * 9.81], abs=1e-4)
    assert log.acting[slack] == log.u[slack] == 0
    assert log.y[slack, 2] == pytest.approx(-0.7, abs=1e-5)
    assert set(log.command[:, 0]) == {0.5, 1.0}


def test_a_log_of_a_rig_is_driven_again(tmp_path):
    """Its CSV has forces and commands: the commands count with a rig, the forces without one."""
    model = hoist(tmp_path, "length")
    log = rollout(model, lambda t: [0.5 if t < 0.3 else 0.4], 0.6, rig="file", commands=["winch"])
    log.to_csv(tmp_path / "run.csv")
    for words, column in ((["--rig"], "command"), ([], "u")):
        done = command("rollout", model.robot.path, "--inputs", tmp_path / "run.csv", *words,
                       "--log", tmp_path / "again.npz")  # fmt: skip
        assert done.code == 0, done.err
        again = Log.load(tmp_path / "again.npz")
        given, first = getattr(log, column), getattr(again, column)
        np.testing.assert_allclose(first[: len(given)], given[: len(first)], atol=1e-9)


def test_velocities_and_forces_in_open_loop(tmp_path):
    model = hoist(tmp_path, "velocity")
    driven = {"rig": "file", "commands": ["winch"]}
    log = rollout(model, lambda t: [0.1 if t < 1 else 0.0], 2.0, **driven)
    assert log.y[-1, 2] == pytest.approx(-0.4 - STRETCH, abs=1e-3)
    assert log.u[-1] == pytest.approx([0.2 * 9.81], abs=1e-3)
    model = hoist(tmp_path, "force")
    rig = Rig(lag=0.02)
    assert_same(
        rollout(model, [2.0], 0.1, rig=rig, commands=["winch"]), rollout(model, [2.0], 0.1, rig=rig)
    )


def test_commands_of_several_runs(tmp_path):
    model = hoist(tmp_path, "length")
    batch = [[0.3], [0.4]]
    several = rollouts(model, batch, 0.1, rig="file", commands=["winch"])
    for inputs, log in zip(batch, several, strict=True):
        assert_same(log, rollout(model, inputs, 0.1, rig="file", commands=["winch"]))


@pytest.mark.parametrize(
    ("header", "cells", "words", "said"),
    [
        ("command.winch", "0.3", (), "expected u.winch, or --rig, with which motors take commands"),
        ("command.winch (mm)", "300", ("--rig",), "command.winch in m, got 'command.winch (mm)'"),
        ("command.which", "0.3", ("--rig",), "did you mean 'command.winch'?"),
        ("command.winch", "1.5", ("--rig",), "command of 'winch' at t = 0 s: expected 0.1 to 1"),
        ("u.winch", "31", ("--rig",), "input 'winch' at t = 0 s: expected 0 to 30"),
    ],
)
def test_wrong_commands_are_one_line(tmp_path, header, cells, words, said):
    model = hoist(tmp_path, "length")
    (tmp_path / "inputs.csv").write_text(f"t,{header}\n0,{cells}\n0.1,{cells}\n")
    done = command("rollout", model.robot.path, "--inputs", tmp_path / "inputs.csv", *words)
    assert (done.code, done.out, done.err.count("\n")) == (2, "", 1)
    assert said in done.err


def test_wrong_names_of_commands(tmp_path):
    model = hoist(tmp_path, "length")
    for names, rig, said in (
        (["winch"], None, ("commands", "winch")),
        (["which"], "file", ("commands", "'which'; did you mean 'winch'?")),
        ("winch", "file", ("commands", "'winch'")),
    ):
        with refused(*said):
            rollout(model, [0.3], 0.1, rig=rig, commands=names)
    for name, kind in (("one", "u"), ("two", "command")):
        (tmp_path / f"{name}.csv").write_text(f"t,{kind}.winch\n0,0.3\n0.1,0.3\n")
    files = (tmp_path / "one.csv", tmp_path / "two.csv")
    done = command("rollout", model.robot.path, "--rig", "--inputs", *files)
    assert done.code == 2
    assert "two.csv: expected commands of no motor, as in" in done.err
