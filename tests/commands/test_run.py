"""The command run.py, as its users call it."""

import json
import math
import re
import subprocess
import sys
import tomllib
from dataclasses import fields

import numpy as np
import pytest

from softdyn.controllers import Gains
from softdyn.validation import Log, paper, simulate
from tests.support import PATIENCE, ROOT, SCRIPTS
from tests.support.command import command, of_itself
from tests.support.forked import forked
from tests.support.robots import finger

KEYS = {
    "record",
    "robot", "controller", "kind", "final_error_cm", "mse_cm2", "failed", "reason", "steps",
    "step_us", "not_solved", "fallbacks", "max_bound_violation", "verdict", "reached",
    "tolerance_cm", "steady_error_cm", "settling_time_s", "overshoot", "input_activity",
    "share_at_bound", "input_effort", "missed_deadlines", "start",
}  # fmt: skip
OWN = """
import math
from dataclasses import dataclass
from types import SimpleNamespace
from neighbour import FORCE

@dataclass
class Table:
    values: dict

class Push:
    def __init__(self, model, gains=None):
        self.u = [(gains or {}).get("force", FORCE)] * model.nu
    def __call__(self, state, reference):
        return SimpleNamespace(u=self.u)

class Nan(Push):
    def __call__(self, state, reference):
        return SimpleNamespace(u=[math.nan] * len(self.u))

class Unbuildable:
    def __init__(self, model):
        raise KeyError("nothing")
"""


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A user's folder as the working directory."""
    (tmp_path / "own.py").write_text(OWN)
    (tmp_path / "neighbour.py").write_text("FORCE = 0.25\n")
    (tmp_path / "arm.urdf").write_text(finger())
    (tmp_path / "point.urdf").write_text(finger(tip="0 0 0"))
    monkeypatch.chdir(tmp_path)
    for name in ("own", "neighbour"):
        monkeypatch.delitem(sys.modules, name, raising=False)
    return tmp_path


@pytest.fixture
def call(folder):
    """Exit code, stdout, stderr."""

    def call(*arguments):
        return command("run", *arguments)

    return call


def script(name, *arguments, cwd=None):
    command = [sys.executable, str(SCRIPTS / name), *arguments]
    return subprocess.run(command, cwd=cwd, capture_output=True, text=True, timeout=PATIENCE)


def figures(text):
    def refuse(constant):
        raise AssertionError(f"{constant} is not JSON")

    return json.loads(text, parse_constant=refuse)


# --- as a process -------------------------------------------------------------------------------


def test_one_loop_from_a_shell(folder):
    done = script(
        "run.py", "finger", "soft-id-clf-qp", "--theta", "0.5", "--duration", "2", "--json", "-",
        "--log", "run.npz", cwd=folder,
    )  # fmt: skip
    assert done.returncode == 0
    assert of_itself(done.stderr) == ""  # no progress bar where there is no terminal
    report = figures(done.stdout)
    assert set(report) == KEYS
    assert set(report["step_us"]) == {"median", "p99", "p999", "max"}
    assert (report["robot"], report["controller"]) == ("finger", "soft-id-clf-qp")
    assert (report["kind"], report["steps"]) == ("set_point", 400)
    assert (report["failed"], report["reason"]) == (False, None)
    assert 0 < report["step_us"]["median"] <= report["step_us"]["max"]
    log = Log.load(folder / "run.npz")
    assert (log.theta, log.duration, log.period) == (0.5, 2.0, 0.005)
    assert log.gains["eps"] == 0.03
    assert report["final_error_cm"] == log.final_error_cm
    assert report["mse_cm2"] == log.mse_cm2
    assert sorted(path.suffix for path in folder.iterdir() if path.is_file()) == [
        ".npz", ".py", ".py", ".urdf", ".urdf",
    ]  # fmt: skip


def test_the_run_is_single_threaded(folder):
    (folder / "own.py").write_text(
        "import os\nclass Look:\n"
        "    def __init__(self, model): raise ValueError(os.environ['OMP_NUM_THREADS'])\n"
    )
    process = forked(
        "run", "finger", "own.py:Look", "--theta", "0",
        env={"OMP_NUM_THREADS": "2"}, cwd=folder, stderr=subprocess.PIPE,
    )  # fmt: skip
    assert "ValueError in line 3: 1" in process.communicate()[1]


# --- in this process ----------------------------------------------------------------------------


def test_tracking(call):
    goal = ("--omega", 0.5, "--duration", 0.1, "--json", "-")
    code, out, _ = call("finger", "own.py:Push", *goal)
    report = figures(out)
    assert (code, report["reached"]) == (1, False)
    assert call("finger", "own.py:Push", *goal, "--no-verdict")[0] == report["failed"]
    assert (report["kind"], report["steps"]) == ("tracking", 20)
    assert report["controller"] == "own.py:Push"


def test_a_summary_has_the_papers_numbers(call):
    short = ("finger", "soft-id-clf-qp", "--theta", 0.5, "--duration", 0.5)
    assert call(*short)[0] == 1
    code, out, _ = call(*short, "--no-verdict")
    assert code == 0
    assert "finger, soft-id-clf-qp, set point at 0.5 pi" in out
    assert "0.08 ± 0.09 cm" in out
    assert "not reached: |e| fell from 17.00" in out
    _, out, _ = call("finger", "soft-id-clf-qp", "--omega", 0.5, "--duration", 0.5)
    assert "0.53 ± 0.26 cm²" in out


@pytest.mark.parametrize("edited", [False, True])
def test_the_papers_numbers_belong_to_the_content_of_a_file(call, folder, edited):
    text = (ROOT / "urdf" / "finger.urdf").read_text()
    if edited:
        text = re.sub(r'damping="[^"]+"', 'damping="0.1234"', text, count=1)
    (folder / "finger.urdf").write_text(text)
    (folder / "gains.toml").write_text("Kp = 500\neps = 0.03\n")
    _, out, err = call("finger.urdf", "soft-id-clf-qp", "--theta", 0.5, "--duration", 0.02,
                       "--gains", "gains.toml")  # fmt: skip
    assert err == ""
    assert ("paper" in out) is not edited


def test_out_of_reach_is_said_with_the_nearest_rest(call):
    away = ("finger", "ic", "--target", 0.3, 0, -0.3)
    code, out, _ = call(*away, "--json", "-", "--duration", 1)
    report = figures(out)
    assert (code, report["verdict"], report["reached"]) == (1, report["verdict"], False)
    # the straight finger points at a target in its plane, 0.24 m long
    assert report["nearest_rest_cm"] == pytest.approx(100 * (math.hypot(0.3, 0.3) - 0.24), abs=0.5)


def test_a_tolerance_decides(call):
    code, out, _ = call("finger", "soft-id-clf-qp", "--theta", 0.5, "--duration", 0.5,
                        "--tolerance", 0.2)  # fmt: skip
    assert code == 0
    assert "reached: |e| fell" in out
    assert "tolerance 20 cm" in out


def test_a_failed_run_exits_with_1_and_keeps_its_log(call, folder):
    code, out, _ = call("finger", "own.py:Nan", "--theta", 0, "--json", "-", "--log", "run.npz")
    report = figures(out)
    assert code == 1
    assert report["failed"]
    assert report["reason"].startswith("the controller failed at t = 0 s: u: expected finite")
    assert (report["final_error_cm"], report["mse_cm2"], report["steps"]) == (None, None, 0)
    assert report["step_us"] == dict.fromkeys(("median", "p99", "p999", "max"))
    assert Log.load(folder / "run.npz").reason == report["reason"]
    code, out, _ = call("finger", "own.py:Nan", "--theta", 0)
    assert code == 1
    assert "failed: the controller failed" in out


def test_an_own_controller_and_its_gains(call, folder):
    (folder / "gains.toml").write_text("force = 0.5\n")
    goal = ("--theta", 0, "--duration", 0.05, "--log", "run.npz")
    call("finger", "own.py:Push", *goal)
    assert Log.load("run.npz").u.tolist() == [[0.25, 0.25]] * 10
    call("finger", folder / "own.py:Push", *goal, "--gains", "gains.toml")
    assert Log.load("run.npz").u.tolist() == [[0.5, 0.5]] * 10


def test_an_own_robot_to_a_target(call, folder):
    (folder / "gains.toml").write_text("Kp = 100\neps = 0.1\n")
    code, out, _ = call(
        "arm.urdf", "soft-id-clf-qp", "--target", 0.1, 0, "-1e-1", "--gains", "gains.toml",
        "--period", 0.004, "--duration", 0.02, "--json", "r.json", "--log", "run.npz",
    )  # fmt: skip
    log = Log.load("run.npz")
    assert log.y_ref[0].tolist() == [0.1, 0.0, -0.1]
    assert (log.period, log.length, log.steps, log.theta) == (0.004, 0.2, 5, None)
    assert log.gains["Kp"] == 100
    assert "set point at 0.1 0 -0.1 m" in out
    assert out.splitlines()[-2:] == ["wrote run.npz", "wrote r.json"]
    assert "best is" not in out
    assert figures((folder / "r.json").read_text())["kind"] == "set_point"
    assert code in (0, 1)
    (folder / "gains.toml").write_text("eps = 0.1\n")  # and no published gains to complete it
    code, _, err = call("arm.urdf", "soft-id-clf-qp", "--theta", 0, "--gains", "gains.toml")
    assert (code, "Kp" in err) == (2, True)


def test_best_says_what_it_is_for_a_robot_without_a_schedule(call):
    _, out, _ = call("arm.urdf", "best", "--theta", 0, "--duration", 0.004)
    assert out.startswith(
        "best is mpc with equilibria as its targets, because finger has no tuned gains\n"
    )


def test_an_own_robot_has_an_ellipse_of_its_size(call):
    call("arm.urdf", "own.py:Push", "--theta", 1.5, "--duration", 0.01, "--log", "run.npz")
    log = Log.load("run.npz")
    assert log.period == 0.002
    expected = 0.2 * math.sqrt(0.5)  # at full reach, 45° below the horizon
    np.testing.assert_allclose(log.y_ref[0], [expected, 0, -expected], rtol=0, atol=1e-15)


def test_a_name_brings_no_published_gains(call):
    # the file calls its robot "finger", which it is not
    code, _, err = call("arm.urdf", "soft-id-clf-qp", "--theta", 0)
    assert code == 2
    assert "arm.urdf" in err
    assert "gains" in err


def test_the_period_and_contacts_reach_the_run(call):
    call("finger", "own.py:Push", "--theta", 0, "--duration", 0.1, "--period", 0.01, "--contacts",
         "--log", "run.npz")  # fmt: skip
    log = Log.load("run.npz")
    assert (log.steps, log.period, log.contacts) == (10, 0.01, True)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["no-robot", "own.py:Push", "--theta", "0"], "robot: expected"),
        (["none.urdf", "own.py:Push", "--theta", "0"], "robot: expected an existing file"),
        (["finger", "no-controller", "--theta", "0"], "controller: expected soft-id-clf-qp"),
        (["finger", "none.py:Push", "--theta", "0"], "expected an existing Python file"),
        (["finger", "own.py:Pull", "--theta", "0"], "expected a class in own.py: Table, Push"),
        (["finger", "own.py", "--theta", "0"], "controller: expected"),
        (
            ["finger", "own.py:Unbuildable", "--theta", "0"],
            "expected a controller, got KeyError in line 23: 'nothing'",
        ),
        (["finger", "arm.urdf:Push", "--theta", "0"], "controller: expected"),
        (["finger", "own.py:Push", "--omega", "1e-300"], "duration: expected at most"),
        (
            ["finger", "own.py:Push", "--target", "0", "nan", "0"],
            "target: expected three finite numbers in m, within the robot's reach of 0.24 m, got",
        ),
        (
            ["finger", "own.py:Push", "--target", "12", "0", "-13"],
            "within the robot's reach of 0.24 m, got one 17.7 m from the base: in cm?",
        ),
        (["finger", "own.py:Push", "--target", "120", "0", "-130"], "177 m from the base: in mm?"),
        (["finger", "own.py:Push", "--target", "1e6", "0", "0"], "got one 1e+06 m from the base"),
        (
            ["finger", "own.py:Push", "--theta", "0", "--duration", "0.01", "--period", "0.02"],
            "period: expected at most the run's 0.01 s, got 0.02 s",
        ),
        (["finger", "own.py:Push", "--theta", "0", "--gains", "none"], "none: expected a readable"),
        (["finger", "own.py:Push", "--theta", "0", "--gains", "own.py"], "expected a TOML file"),
        (["finger", "own.py:Push", "--theta", "0", "--log", "no/folder/f"], "a writable file"),
        (["finger", "own.py:Push", "--theta", "0", "--log", "."], "expected a file, got a folder"),
        (["finger", "own.py:Push", "--theta", "0", "--json", "no/f.json"], "a writable file"),
        (["point.urdf", "own.py:Push", "--theta", "0"], "expected a robot with a length"),
        (["own.py", "own.py:Push", "--theta", "0"], "well-formed XML"),
    ],
)
def test_bad_input(call, folder, arguments, message):
    before = sorted(folder.iterdir())
    code, out, err = call(*arguments)
    assert code == 2
    assert out == ""
    assert err.startswith("error: ")
    assert err.count("\n") == 1
    assert message in err
    assert [path for path in sorted(folder.iterdir()) if path.name != "__pycache__"] == before


@pytest.mark.parametrize(
    ("toml", "message"),
    [
        ("Kp = -1\n", "gains.toml: gains.Kp: expected"),
        ("Kp = nan\n", "gains.toml: gains.Kp: expected"),
        ("Kp = 'a'\n", "gains.toml: gains.Kp: expected"),
        ("Kp = 1\nspeed = 2\n", "speed"),
        ("Kp = \n", "expected a TOML file"),
    ],
)
def test_bad_gains(call, folder, toml, message):
    (folder / "gains.toml").write_text(toml)
    code, _, err = call("finger", "soft-id-clf-qp", "--theta", 0, "--gains", "gains.toml")
    assert code == 2
    assert err.startswith("error: gains.toml")
    assert err.count("\n") == 1
    assert message in err


def test_a_robot_without_length_takes_a_target(call):
    code, out, _ = call("point.urdf", "own.py:Push", "--target", 0, 0, 0, "--duration", 0.01)
    assert code == 0  # its tip is the joint itself, so it is already there
    assert "reached: |e| fell from 0.000 to 0.000 cm" in out


def test_the_script_and_the_library_agree(call):
    import softdyn
    from softdyn.controllers import SoftIdClfQp

    model = softdyn.load("finger")
    log = simulate(model, SoftIdClfQp(model), paper.set_point("finger", 1.0), duration=0.2)
    _, out, _ = call("finger", "soft-id-clf-qp", "--theta", 1, "--duration", 0.2, "--json", "-")
    assert figures(out)["final_error_cm"] == log.final_error_cm


HOSTILE = """
import sys
from types import SimpleNamespace
import numpy as np

class Still:
    def __init__(self, model):
        self.nu = model.nu
    def u(self):
        return np.zeros(self.nu)
    def __call__(self, state, reference):
        return SimpleNamespace(u=self.u())

class Unbuildable(Still):
    def __init__(self, model):
        sys.exit(0)

class ResetTakesNothing(Still):
    def reset(self):
        pass

class CallTakesNothing(Still):
    def __call__(self):
        pass

class Text(Still):
    not_solved = "many"

class Changes(Still):
    def __call__(self, state, reference):
        setattr(self, *self.change)
        return super().__call__(state, reference)

class TextLater(Changes):
    not_solved, change = 0, ("not_solved", "many")

class NanLater(Changes):
    change = "fallbacks", float("nan")

class Huge(Changes):
    change = "fallbacks", 10**5000

class Violation(Still):
    max_bound_violation = float("nan")

class Masked(Still):
    def __call__(self, state, reference):
        return SimpleNamespace(u=np.ma.masked_array(self.u(), np.arange(self.nu) < 1))

class Array(Still):
    def __call__(self, state, reference):
        return self.u()

class Short(Still):
    def __call__(self, state, reference):
        return np.zeros(self.nu + 1)

class Name(Still):
    name = np.zeros(3)

class Words(Still):
    gains = {"a": 10**6000, "b": float("nan")}
    def __call__(self, state, reference):
        return SimpleNamespace(u=self.u(), V=10**5000, status="x" * 100_000)
"""


@pytest.mark.parametrize(
    ("name", "code", "message"),
    [
        ("Unbuildable", 2, "expected a controller, got SystemExit in line"),
        ("ResetTakesNothing", 2, "takes 1 positional argument but 2 were given"),
        ("CallTakesNothing", 2, "takes 1 positional argument but 3 were given"),
        ("Text", 2, "the controller's not_solved: expected a finite number, got 'many'"),
        ("TextLater", 1, "the controller's not_solved: expected a finite number, got 'many'"),
        ("NanLater", 1, "the controller's fallbacks: expected a finite number, got nan"),
        ("Huge", 1, "the controller's fallbacks: expected a finite number, got a number of"),
        ("Violation", 1, "the controller's max_bound_violation: expected a finite number >= 0"),
        ("Masked", 1, "its u: expected an array, got a masked one"),
        ("Short", 1, "expected finite numbers of shape (2,), got shape (3,)"),
        ("Array", 0, "not reached: "),
        ("Name", 0, "not reached: "),
        ("Words", 0, "not reached: "),
    ],
)
def test_a_user_s_answers_fail_in_one_line(call, folder, name, code, message):
    (folder / "hostile.py").write_text(HOSTILE)
    options = ["--theta", "0.5", "--duration", "0.02", "--log", "run.npz", "--no-verdict"]
    ended, out, err = call("finger", f"hostile.py:{name}", *options)
    assert ended == code, err
    assert message in out + err
    assert "Traceback" not in out + err
    if code == 2:
        assert len(err.splitlines()) == 1
        assert not (folder / "run.npz").exists()
    else:
        log = Log.load(folder / "run.npz")
        assert log.failed == (code == 1)
        assert log.controller == f"hostile.py:{name}"


RAISING = """
import os, signal, sys
import numpy as np
import softdyn

class Still:
    def __init__(self, model):
        self.model, self.calls = model, 0
    def step(self, t, measurements, u):
        return self(None, None)
    def __call__(self, state, reference):
        self.calls += 1
        if self.calls > 3:
            self.fail()
        return np.zeros(self.model.nu)

class Divides(Still):
    def fail(self):
        return 1 / 0

class Exits(Still):
    def fail(self):
        sys.exit(0)

class Misuses(Still):
    def fail(self):
        self.model.state(np.zeros(1), np.zeros(1))

class Stops(Still):
    def fail(self):
        raise type("Stop", (BaseException,), {})

class Presses(Still):
    def fail(self):
        os.kill(os.getpid(), signal.SIGINT)

class Resets(Still):
    def reset(self, period):
        self.fail()
    def fail(self):
        raise KeyError("reset")

class Table(Still):
    @property
    def gains(self):
        raise KeyError("gains")
"""


@pytest.mark.parametrize("file", ["run.npz", "run.csv"])
@pytest.mark.parametrize(
    ("name", "last"),
    [
        ("Divides", "ZeroDivisionError: division by zero"),
        ("Exits", "SystemExit: 0"),
        ("Misuses", "softdyn.exceptions.InputError: q: expected finite numbers"),
        ("Stops", "hostile.Stop"),
    ],
)
def test_an_error_in_own_code_keeps_the_run_and_is_traced(call, folder, name, last, file):
    (folder / "hostile.py").write_text(RAISING)
    code, out, err = call("finger", f"hostile.py:{name}", "--theta", "0.5", "--log", file)
    assert (code, out) == (1, "")
    written, begin, place, *_, end = err.splitlines()
    assert written == f"wrote {file}: the run up to t = 0.015 s"
    assert begin == "Traceback (most recent call last):"
    assert place == f'  File "{folder}/hostile.py", line 14, in __call__'
    assert end.startswith(last)
    if file.endswith("csv"):
        times = [row.partition(",")[0] for row in (folder / file).read_text().splitlines()]
        assert [float(t) for t in times[1:]] == [0, 0.005, 0.01, 0.015]
        return
    log = Log.load(folder / file)
    assert (log.steps, log.complete, log.failed) == (3, False, True)
    assert log.reason.startswith(f"the run ended at t = 0.015 s: {last.rpartition('.')[2]}")


@pytest.mark.parametrize(("name", "last"), [("Resets", "reset"), ("Table", "gains")])
def test_an_error_outside_the_steps_of_own_code_is_traced(call, folder, name, last):
    (folder / "hostile.py").write_text(RAISING.replace("self.calls > 3", "False"))
    goal = ("--theta", "0.5", "--duration", "0.05")
    code, out, err = call("finger", f"hostile.py:{name}", *goal, "--log", "run.npz")
    assert (code, out) == (1, "")
    begin, place, *_, end = err.splitlines()
    assert begin == "Traceback (most recent call last):"
    assert f'File "{folder}/hostile.py"' in place
    assert end == f"KeyError: '{last}'"


def test_an_error_in_an_own_observer_keeps_the_run_and_is_traced(call, folder):
    text = (ROOT / "urdf/finger.urdf").read_text("utf-8")
    sensor = '<sensor name="tip" type="position" link="tip" noise="0.001"/></softdyn>'
    (folder / "sensed.urdf").write_text(text.replace("</softdyn>", sensor), "utf-8")
    estimate = "return self.model.state(*[np.zeros(4)] * 2)"
    text = RAISING.replace("return np.zeros(self.model.nu)", estimate)
    (folder / "hostile.py").write_text(text)
    given = ("sensed.urdf", "own.py:Push", "--target", 0.2, 0, 0, "--rig", "--log", "run.npz")
    code, out, err = call(*given, "--observer", "hostile.py:Divides")
    assert (code, out) == (1, "")
    assert f'File "{folder}/hostile.py", line 10, in step' in err.splitlines()[2]
    log = Log.load("run.npz")
    assert (log.steps, len(log.q_seen)) == (3, 3)
    assert np.isfinite(log.measured[:3]).all()
    code, _, err = call(*given, "--observer", "own.py:Unbuildable")
    assert (code, err) == (
        2, "error: own.py:Unbuildable: expected an observer, got KeyError in line 23: 'nothing'\n"
    )  # fmt: skip


def test_ctrl_c_keeps_the_run(call, folder):
    (folder / "hostile.py").write_text(RAISING)
    given = ("finger", "hostile.py:Presses", "--theta", "0.5")
    code, _, err = call(*given, "--log", "run.npz")
    # it may compile first
    said = ["wrote run.npz: the run up to t = 0.015 s", "error: interrupted"]
    assert (code, err.splitlines()[-2:]) == (130, said)
    log = Log.load(folder / "run.npz")
    assert (log.steps, log.reason) == (3, "the run ended at t = 0.015 s: interrupted")
    code, _, err = call(*given)
    assert (code, err.splitlines()) == (130, ["error: interrupted"])


WAY = '<task frame="tip"/><task frame="tip" name="way" kind="axis" direction="1 0 0"/>'
TURN = '<task frame="tip"/><task frame="tip" name="turn" kind="orientation"/>'
TIP, FINE = "t,tip.x,tip.y,tip.z", ["0.1,0,-0.1", "0.1,0,-0.1"]


def table(header, *cells):
    """A CSV of two rows, with a place of the tip in each."""
    rows = [f"{k},{FINE[k]},{cell}" for k, cell in enumerate(cells)]
    return "\n".join([f"{TIP},{header}", *rows])


@pytest.mark.parametrize(("tasks", "text", "expected"), [
    (WAY, table("wya.dx,wya.dy,wya.dz", "1,0,0", "1,0,0"),
     "paths.csv: wya: expected one of the tasks tip, way, got 'wya'; did you mean 'way'?"),
    (WAY, table("way.x,way.y,way.z", "1,0,0", "1,0,0"),
     "paths.csv: way: expected columns way.dx, way.dy, way.dz, got position"),
    (WAY, f"{TIP.replace('tip.', 'tip.r')}\n0,0,0,0\n1,0,1,0",
     "paths.csv: tip: expected columns tip.x, tip.y, tip.z, got orientation"),
    (TURN, f"{TIP}\n0,{FINE[0]}\n1,{FINE[1]}", "paths.csv: expected columns of task 'turn'"),
    (WAY, "t,way.dx,way.dy,way.dz\n0,1,0,0\n1,1,0,0", "paths.csv: expected columns of task 'tip'"),
    (WAY, f"{TIP}\n0,0.1,0,-0.1\n1,120,0,-130",
     "paths.csv: tip at 1 s: target: expected three finite numbers in m, within the robot's reach"),
    (WAY, f"{TIP}\n0,0.1,0,-0.1\n1,1e300,0,0", "paths.csv: tip: numbers: expected within ±1e+06"),
    (WAY, f"{TIP}\n-3,0.1,0,-0.1\n-1,0.1,0,0", "paths.csv: t: expected times from 0 on"),
    (WAY, table("way.dx,way.dy,way.dz", "0,0,0", "1,0,0"),
     "paths.csv: way: values: expected directions that are not zero"),
    (WAY, table("way.dx,way.dy,way.dz", "1,0,0", "-1,0,0"),
     "paths.csv: way: values: expected directions that are not zero, nor opposite"),
    (TURN, table("turn.rx,turn.ry,turn.rz", "90,0,0", "0,0,0"),
     "paths.csv: turn: rotation: expected a rotation vector in rad, at most a full turn"),
    (TURN, table("turn.rx,turn.ry,turn.rz", "1e300,0,0", "0,0,0"),
     "paths.csv: turn: numbers: expected within ±1e+06, got 1e+300"),
    ('<task frame="tip"/><task frame="tip" name="low" level="1"/>',
     table("low.x,low.y,low.z", *FINE), "two.urdf: tasks: expected weighted tasks of one level"),
    (WAY.replace('frame="tip" name', 'frame="base" name'), "",
     '<softdyn><task name="way">: expected a link that a joint moves, got \'base\''),
])  # fmt: skip
def test_misuses_of_tasks_are_one_line_and_leave_nothing(tmp_path, tasks, text, expected):
    urdf = (ROOT / "urdf/finger.urdf").read_text("utf-8")
    (tmp_path / "two.urdf").write_text(urdf.replace('<task frame="tip"/>', tasks), "utf-8")
    (tmp_path / "paths.csv").write_text(text, "utf-8")
    given = [str(tmp_path / "two.urdf"), "mpc", "--targets", str(tmp_path / "paths.csv")]
    code, out, error = command("run", *given, "--log", str(tmp_path / "run.npz"))
    assert (code, out) == (2, "")
    assert expected in error
    assert of_itself(error).count("\n") == 1
    assert {file.name for file in tmp_path.iterdir()} == {"two.urdf", "paths.csv"}


def test_targets_of_the_files_tasks(tmp_path):
    text = (ROOT / "urdf/finger.urdf").read_text("utf-8")
    way = '<task frame="tip"/><task frame="tip" name="way" kind="axis" direction="1 0 0"/>'
    (tmp_path / "two.urdf").write_text(text.replace('<task frame="tip"/>', way), "utf-8")
    paths = ["t,tip.x,tip.y,tip.z,way.dx,way.dy,way.dz", "0,0.13,0,-0.13,0,0,-1"]
    (tmp_path / "paths.csv").write_text("\n".join([*paths, "0.1,0.12,0,-0.13,0,0,-1"]), "utf-8")
    given = [str(tmp_path / "two.urdf"), "mpc", "--targets", str(tmp_path / "paths.csv")]
    code, out, _ = command("run", *given, "--no-verdict")
    assert code == 0
    assert re.search(r"^way +error from 90\.000 to .* degrees$", out, re.M)
    # a path from the robot's pose to a point out of reach: not failed, but missed by all equilibria
    paths = [paths[0], "0,0.24,0,0,1,0,0", "1,0.3,0,-0.3,1,0,0"]
    (tmp_path / "paths.csv").write_text("\n".join(paths), "utf-8")
    code, out, _ = command("run", *given, "--period", "0.005", "--json", "-")
    report = json.loads(out)
    assert (code, report["verdict"]) == (1, "not reached")
    nearest = report["nearest_rest"]
    assert [one["unit"] for one in nearest.values()] == ["cm", "degrees"]
    # the straight finger, 24 cm long, points at a target in its plane
    assert 18.3 < nearest["tip"]["error"] < 25
    assert 0 <= nearest["way"]["error"] < 46


def test_gains_are_proposed_and_a_run_that_misses_says_which_to_change(call, folder):
    code, out, _ = command("check", "arm.urdf", "--gains", "--period", 0.004)
    assert code == 0
    (folder / "proposed.toml").write_text(out)
    goal = ("--target", 0.12, 0, "-0.16", "--period", 0.004, "--duration", 1, "--gains")
    table = tomllib.loads(out)
    assert set(table) == {"format", *(field.name for field in fields(Gains))}
    code, _, err = call("arm.urdf", "soft-id-clf-qp", "--theta", 0)
    assert (code, "softdyn check" in err, "--gains > FILE" in err) == (2, True, True)
    (folder / "fast.toml").write_text("Kp = 90000\nw3 = 1e9\nrho = 1e-9\n")
    _, out, _ = call("arm.urdf", "soft-id-clf-qp", *goal, "fast.toml", "--tolerance", 1e-5)
    assert "gains: Kp = 90000 is too large for a period of 0.004 s; softdyn check" in out
