"""A plant and a controller that change while they run, without clock and page."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

import softdyn
from softdyn import InputError, SetPoint, statics
from softdyn.commands import play
from softdyn.estimation import Ekf
from softdyn.tasks import AxisTask, JointTask, PoseTask
from softdyn.tasks.targets import exp3
from softdyn.validation import Rig, Twin, simulate
from softdyn.validation.live.menu import menu_of
from softdyn.validation.live.playing import drive, figure_of, period_note
from softdyn.validation.live.session import Session
from softdyn.validation.live.watching import watch
from softdyn.validation.loop.closed_loop import ClosedLoop
from softdyn.validation.loop.settings import RunOptions
from softdyn.validation.twin.plant_errors import PlantErrors
from softdyn.view.live import messages as m
from softdyn.view.live.frames import Columns
from softdyn.view.live.messages import OPEN_LOOP
from softdyn.view.live.pacing import Clock, ClockStatistics
from tests.support import robots
from tests.support.refused import refused
from tests.support.rigs import sensed


@pytest.fixture(scope="module")
def model():
    return softdyn.load("finger")


def make(model, law=OPEN_LOOP, own=None):
    return Session(model, menu_of(model, own), law)


def run(session, seconds):
    for _ in range(round(seconds / session.period)):
        session.step()


def part(session, name):
    return session.frame()[session.columns.places[name]].astype(float)


def test_the_tip_follows_the_target(model):
    session = make(model, "best")
    goal = softdyn.validation.paper.set_point("finger", 0.5).reference.y
    session.apply(m.SetTarget(goal))
    run(session, 3.0)
    assert np.linalg.norm(part(session, "y") - goal) < 1e-3  # docs/beyond.md: 0.02 cm
    np.testing.assert_allclose(part(session, "y_ref"), goal, atol=1e-7)
    assert session.t == pytest.approx(3.0)
    assert not session.shown.paused


def test_a_push_deflects_the_tip_by_its_compliance_and_it_returns(model):
    session = make(model)
    run(session, 1.0)
    before = part(session, "y")
    here = statics.settle(model, np.zeros(2), session.plant.state()[0])
    np.testing.assert_allclose(here.y, before, atol=1e-6)
    to = before + np.array([0.004, 0.0, 0.001])
    session.apply(m.Push(model.robot.task, np.zeros(3), to))
    run(session, 4.0)
    force, moved = part(session, "force"), part(session, "y") - before
    assert np.linalg.norm(moved) > 1e-3
    # to first order in a move of 2 % of the finger's length
    assert np.linalg.norm(here.tip_compliance @ force - moved) < 0.1 * np.linalg.norm(moved)
    np.testing.assert_allclose(part(session, "point"), part(session, "y"), atol=1e-5)
    session.apply(m.Release())
    run(session, 4.0)
    assert np.linalg.norm(part(session, "y") - before) < 2e-4
    assert np.isnan(part(session, "force")).all()


def test_the_model_beside_the_plant_stays_with_it_until_they_differ(model):
    session = make(model)
    session.apply(m.ShowGhost(True))
    session.apply(m.SetInputs(np.array([0.3, -0.2])))
    run(session, 0.5)
    assert part(session, "gap") < 1e-9
    np.testing.assert_allclose(part(session, "ghost"), part(session, "q"), atol=1e-7)
    session.apply(m.Mismatch(mass=1.3))
    run(session, 0.5)
    assert part(session, "gap") > 1e-4


def test_the_ghost_of_an_observer_is_its_estimate():
    model = sensed("finger", rate=60.0, latency=0.03)
    session = Session(model, menu_of(model), "best", rig="file", observer=Ekf(model))
    goal = softdyn.validation.paper.set_point("finger", 0.5).reference.y
    session.apply(m.SetTarget(goal))
    assert np.isnan(part(session, "gap")).all()
    run(session, 2.0)
    assert np.linalg.norm(part(session, "y") - goal) < 2e-3
    assert 0.0 < part(session, "gap") < 2e-3
    assert 1e-7 < np.abs(part(session, "ghost") - part(session, "q")).max() < 0.1
    session.apply(m.ShowGhost(False))
    assert np.isnan(part(session, "ghost")).all()
    session.apply(m.ShowGhost(True))
    assert np.isfinite(part(session, "ghost")).all()
    with refused("observer", "one that alters q and v"):
        session.apply(m.Mismatch(noise=1e-3))
    session.apply(m.Mismatch(mass=1.3))
    session.apply(m.Reset())
    assert np.isnan(part(session, "gap")).all()
    run(session, 0.5)
    assert not session.shown.paused
    assert part(session, "gap") < 0.02


def test_controllers_keep_clear_of_obstacles(model, tmp_path):
    file = tmp_path / "scene.toml"
    lid = 'links = "tip"\nname = "lid"\ncontact = false\n'
    file.write_text(f"[[half_space]]\nnormal = [0, 0, -1]\noffset = 0.12\n{lid}")
    words = ["finger", "mpc", "--target", "0.2", "0", "-0.05"]
    free, safe = (
        play.make_session(play.parser.parse_args([*words, *more]))
        for more in ([], ["--obstacles", str(file)])
    )
    lid = safe.surroundings
    for law in ("mpc", "soft-id-clf-qp"):
        least = []
        for session in (free, safe):
            session.apply(m.Reset())
            session.apply(m.SetController(law))
            reserves = []
            for _ in range(120):
                session.step()
                reserves.append(lid.reserve(session.loop.state)[0])
            assert not session.shown.paused, session.shown.notice
            least.append(min(reserves))
        assert least[0] < -0.02
        assert least[1] > -1e-4
    assert safe.plant.twin.obstacles == lid.obstacles
    assert [len(figure_of(session).scenery) for session in (free, safe)] == [0, 1]


def test_targets_of_tasks_are_set_and_a_plain_target_is_refused(model):
    tasks = [PoseTask("tip", name="hand"), AxisTask("link2", [1, 0, 0], weight=0.01)]
    session = Session(model, menu_of(model), "soft-id-clf-qp", tasks=tasks, target=[0.2, 0, -0.05])
    poses, row = model.link_poses(session._rest), part(session, "targets")
    np.testing.assert_allclose(row[:3], [0.2, 0, -0.05], atol=1e-7)
    np.testing.assert_allclose(exp3(row[3:6].astype(float)), poses["tip"][:3, :3], atol=1e-6)
    np.testing.assert_allclose(row[6:], poses["link2"][:3, 0], atol=1e-6)
    with refused("do", "target"):
        session.apply(m.SetTarget(np.zeros(3)))
    said = np.array([0.18, 0.0, -0.1, 0.0, 1.0, 0.0, 0.6, 0.0, -0.8])
    session.apply(m.SetTargets(said))
    np.testing.assert_allclose(part(session, "targets"), said, atol=1e-7)
    np.testing.assert_allclose(part(session, "y_ref"), said[:3], atol=1e-7)
    before = part(session, "y")
    run(session, 0.3)
    assert np.linalg.norm(part(session, "y") - said[:3]) < np.linalg.norm(before - said[:3])
    session.apply(m.Reset())
    session.apply(m.SetController("mpc"))
    run(session, 0.1)
    assert not session.shown.paused, session.shown.notice
    with refused("do", "targets"):
        make(model, "ic").apply(m.SetTargets(np.zeros(0)))
    with refused("tasks", "[JointTask(name='joints'…"):
        Session(model, menu_of(model), "mpc", tasks=[JointTask(["joint1"])])
    with refused("targets", "link2.axis"):
        Session(model, menu_of(model), "mpc", tasks=tasks[1:])


def test_a_controller_that_plans_says_so_on_the_page(model):
    session = make(model, "ic")
    session.changed = False
    session.loop.controller.planning = True
    run(session, session.period)
    assert session.shown.planning
    assert session.changed
    session.changed, session.loop.controller.planning = False, np.ones(2)
    run(session, session.period)
    assert session.shown.planning is False
    assert session.changed


def test_law_and_plant_change_while_it_moves(model):
    session = make(model, "ic")
    session.apply(m.SetTarget(part(session, "y") + np.array([0.02, 0.0, 0.03])))
    run(session, 0.2)
    q, v = session.plant.state()
    session.apply(m.Mismatch(stiffness=1.2, delay=2 * session.period, noise=1e-4, contacts=True))
    for kept, now in zip((q, v), session.plant.state(), strict=True):
        np.testing.assert_array_equal(kept, now)
    assert session.t == pytest.approx(0.2)
    session.apply(m.SetController("soft-id-clf-qp"))
    run(session, 0.5)
    assert session.shown.law == "soft-id-clf-qp"
    assert session.shown.mismatch["stiffness"] == 1.2
    assert not session.shown.paused
    session.apply(m.Reset())
    assert session.t == 0.0
    assert session.shown.mismatch["stiffness"] == 1.2


class Bad:
    def __init__(self, model):
        self.answers = [np.zeros(2), np.full(2, np.nan)]

    def __call__(self, state, reference):
        return self.answers.pop(0)


def test_a_law_that_breaks_pauses_and_says_why(model):
    session = make(model, "bad", {"bad": Bad})
    run(session, 2 * session.period)
    assert session.shown.paused
    assert "bad: InputError: u: expected finite numbers" in session.shown.notice
    assert session.t == pytest.approx(session.period)  # it was not moved by no input
    run(session, session.period)
    assert "IndexError" in session.shown.notice
    begin, place, *_, end = session.trace.splitlines()
    assert (begin, end) == ("Traceback (most recent call last):", "IndexError: pop from empty list")
    assert f'File "{__file__}"' in place
    session.apply(m.SetController(OPEN_LOOP))
    session.apply(m.Pause(False))
    run(session, 0.1)
    assert not session.shown.paused
    assert session.shown.notice == ""


def test_what_cannot_be_done_changes_nothing(model):
    def broken(_model):
        raise InputError("gains", "some", "none")

    session = make(model, OPEN_LOOP, {"broken": broken})
    before = session.frame()
    with pytest.raises(InputError):
        session.apply(m.SetController("broken"))
    with refused("push.link", "world"):
        session.apply(m.Push(model.robot.root, np.zeros(3), np.zeros(3)))
    with pytest.raises(InputError):
        session.apply(m.FindReach())
    np.testing.assert_array_equal(session.frame(), before)
    assert session.shown.law == OPEN_LOOP


class Stubborn:
    """A controller whose reset fails."""

    def __init__(self, model):
        self.u = np.ones(2)

    def __call__(self, state, reference):
        return self.u

    def reset(self, period):
        raise ValueError("not today")


def test_a_law_that_cannot_be_begun_changes_nothing(model):
    session = make(model, OPEN_LOOP, {"stubborn": Stubborn})
    session.apply(m.SetInputs(np.array([0.1, 0.0])))
    with pytest.raises(ValueError, match="not today"):
        session.apply(m.SetController("stubborn"))
    session.step()
    assert session.shown.law == OPEN_LOOP
    np.testing.assert_allclose(part(session, "u"), [0.1, 0.0], rtol=1e-6)


def test_what_pages_show_is_said_again_only_when_it_has_changed(model):
    session = make(model)
    session.changed = False
    session.apply(m.SetTarget(np.array([0.1, 0.0, -0.1])))
    assert not session.changed
    session.apply(m.SetSpeed(0.5))
    assert session.changed


class Told:
    """A channel without pages, which keeps what it is told."""

    def __init__(self, *messages):
        self.said, self.shown, self.errors = messages, (), ()

    def check(self):
        pass

    def messages(self):
        said, self.said = self.said, ()
        return iter(said)

    def state(self, shown):
        self.shown = (*self.shown, shown)

    def error(self, text):
        self.errors = (*self.errors, text)

    def frame(self, row):
        pass


def test_an_error_in_own_code_is_traced_once(model):
    session, said, turns = make(model, "bad", {"bad": Bad}), [], iter(range(20))
    for _ in range(3):  # the third answer is missing
        session.apply(m.SingleStep())
    drive(session, Told(), Clock(session.period), lambda: next(turns, None) is None, said.append)
    (text,) = said
    assert text.endswith("IndexError: pop from empty list\n")


def test_a_law_that_is_chosen_late_says_so_and_costs_no_period(model):
    """Its kernels are compiled before its first step, and the page shows a notice meanwhile."""
    session = make(model, OPEN_LOOP, {"stubborn": Stubborn})
    channel = Told(m.SetController("ic"), m.SetController("stubborn"))
    clock = Clock(session.period)
    drive(session, channel, clock, lambda: clock.periods > 2)
    busy = [(one["law"], one["busy"].partition(":")[0]) for one in channel.shown]
    assert busy == [(OPEN_LOOP, "starting ic"), ("ic", "starting stubborn"), ("ic", "")]
    assert channel.errors == ("ValueError: not today",)


class Listens:
    """Answers with the first input as often as it was asked, and keeps what it saw."""

    def __init__(self, model):
        self.seen, self.u_max = [], model.u_max

    def __call__(self, state, reference):
        self.seen.append(state.y)
        return self.u_max * [len(self.seen) / 100, 0.0]


@pytest.mark.parametrize("chosen", ["before", "after"])
def test_a_mismatch_delays_the_inputs_and_blurs_the_tip(model, chosen):
    """It holds for the running controller and for one chosen later; a reset restarts both."""
    own = Listens(model)
    session = make(model, "own" if chosen == "before" else OPEN_LOOP, {"own": lambda _model: own})
    session.apply(m.Mismatch(delay=3 * session.period, noise=1e-4))
    session.apply(m.SetController("own")) if chosen == "after" else None
    for _ in range(2):
        acted, tips = [], []
        own.seen.clear()
        for _ in range(40):
            tips.append(model.state(*session.plant.state()).y)
            session.step()
            acted.append(round(100 * session.plant.acting[0] / model.u_max[0]))
        assert acted == [0, 0, 0, *range(1, 38)]
        blur = np.linalg.norm(np.array(own.seen) - tips, axis=1)
        assert 0.7e-4 < np.sqrt(np.mean(blur**2)) < 1.3e-4
        session.apply(m.Reset())


@pytest.mark.parametrize(
    ("pace", "step", "expected"),
    [
        (1.0, 0.5e-3, ""),
        # 3 ms of control and 1 ms of plant in 2 ms: in 8 ms there are 3 and 4
        (
            0.5,
            3e-3,
            "0.50 of real time at a control period of 2 ms: this machine holds --period 0.008",
        ),
        (0.5, 0.5e-3, "no longer period helps, a second of the plant alone takes 1.75 s"),
    ],
)
def test_a_period_that_the_machine_does_not_hold_is_told(pace, step, expected):
    note = period_note(2e-3, ClockStatistics(500, 400, {}, {"median": 1e6 * step}, pace))
    assert (note == "") == (expected == "")
    assert expected in note


@pytest.mark.parametrize(
    ("task", "names"), [("pose", ["tip.pose"]), ("axis", ["tip", "tip.axis"]), ("file", ["tip"])]
)
def test_play_drags_tasks_of_the_command_line(task, names):
    words = ["finger", "open loop", "--task", task, "--target", "0.1", "0", "-0.1"]
    session = play.make_session(play.parser.parse_args(words))
    assert [mark.name for mark in session.limits.marks] == names
    np.testing.assert_allclose(part(session, "y_ref"), [0.1, 0, -0.1], atol=1e-7)


def test_play_takes_gains(tmp_path, monkeypatch):
    """For the first controller, or for each by its name."""
    monkeypatch.chdir(tmp_path)
    words = ["finger", "soft-id-clf-qp", "ic", "--gains", "g.toml"]
    for text, expected in (("Kp = 7.0", (7, 500)), ("[ic]\nKp = 8.0", (500, 8))):
        (tmp_path / "g.toml").write_text(text)
        arguments = play.parser.parse_args(words)
        menu = play.controllers_of(arguments, "soft-id-clf-qp")
        assert tuple(menu[n](softdyn.load("finger")).gains.Kp for n in words[1:3]) == expected
    (tmp_path / "g.toml").write_text("Kq = 7.0\n")
    made = play.controllers_of(play.parser.parse_args(words), "soft-id-clf-qp")
    with refused("g.toml: gains: Kq", "'Kq'"):
        made["soft-id-clf-qp"](softdyn.load("finger"))


@pytest.fixture(scope="module")
def arm(tmp_path_factory):
    return robots.load(tmp_path_factory.mktemp("arm"), robots.WINCHED)


def law(state, reference):
    return np.array([8.0 + 5.0 * state.v[0], 6.0 - 20.0 * state.q[1]])


def rigged_session(arm, rig):
    session = Session(arm, {"law": lambda _model: law}, "law", period=0.004, rig=rig)
    session.apply(m.SetTarget(arm.state(arm.q0, np.zeros(2)).y))
    return session


@pytest.mark.parametrize("rig", ["file", Rig(latency=0.008, noise=1e-4, seed=4, delay=0.002)])
def test_play_behind_a_rig_is_the_run_behind_it(arm, rig):
    """Winch, lag, delay, latency and noise: the same states to the bit, and the acting inputs."""
    session = rigged_session(arm, rig)
    rest = statics.rest(arm).q
    reference = SetPoint(arm.state(arm.q0, np.zeros(2)).y)
    log = simulate(arm, law, reference, duration=0.2, period=0.004, q0=rest, rig=rig)
    for k in range(50):
        np.testing.assert_array_equal(session.plant.state()[0], log.q[k])
        session.step()
    assert np.abs(log.acting - np.vstack([log.u, log.u[-1:]])).max() > 1.0
    shown = part(session, "u")
    session.plant.sample()  # a frame has them one plant step late
    np.testing.assert_allclose(session.plant.acting, log.acting[-1], atol=1e-12)
    assert np.abs(shown - log.acting[-1]).max() < 1.0


def test_the_page_s_differences_change_the_rig(arm):
    """Sliders multiply the rig's plant, replace its delay and noise, and keep what acts."""
    session = rigged_session(arm, Rig(plant=PlantErrors(mass=2.0)))
    run(session, 0.4)
    before, acting = session.plant.state(), session.plant.acting
    session.apply(m.Mismatch(mass=1.5, delay=0.05, noise=1e-3))
    np.testing.assert_array_equal(session.plant.state(), before)
    assert session.t == pytest.approx(0.4)
    assert session.plant.twin.model.body_mass.sum() == pytest.approx(
        3.0 * Twin(arm).model.body_mass.sum()
    )
    assert session.plant.twin.robot.actuators[0].delay == 0.05
    np.testing.assert_allclose(session.plant.acting, acting, atol=4.0)
    session.step()
    assert 0 < np.abs(session.loop.seen.q - before[0]).max() < 0.1  # noise
    session.apply(m.Reset())
    run(session, 0.048)
    held = session.plant.acting
    assert held[1] == 0.0  # the delay after a reset to zero input
    session.apply(m.SetController(OPEN_LOOP))
    session.apply(m.SetInputs(np.array([0.0, 7.0])))
    run(session, 0.3)
    assert session.plant.acting[1] == pytest.approx(7.0, abs=1e-6)


def test_play_takes_a_rig_from_the_command_line(arm, tmp_path):
    file = tmp_path / "rig.toml"
    file.write_text("latency = 0.008\n[plant]\npayload = 0.02\n", encoding="utf-8")
    path = str(arm.robot.path)
    expected = (([], False, 0.0), (["--rig"], True, 0.0), (["--rig", str(file)], True, 0.02))
    for words, of_file, payload in expected:
        arguments = play.parser.parse_args([path, OPEN_LOOP, *words])
        session = play.make_session(arguments)
        wanted = session._wanted
        assert (wanted.file, wanted.plant.payload) == (of_file, payload)


def test_a_watched_run_with_a_rig_shows_its_plant_and_what_acts(arm):
    """The state that the controller sees is late and noisy; the page shows the plant's."""
    sent = []
    channel = SimpleNamespace(frame=sent.append, state=lambda _: None, dropped=0)
    reference = SetPoint(arm.state(arm.q0, np.zeros(2)).y)
    rig = Rig(latency=0.02, noise=1e-2)
    loop = ClosedLoop(arm, law, reference, RunOptions(duration=0.4, period=0.004, rig=rig))
    log, _ = watch(loop, channel, speed=10.0)
    places = Columns(arm).places
    assert sent
    for row in sent:
        k = int(np.searchsorted(log.t, row[0] - 1e-6))
        np.testing.assert_allclose(row[places["q"]], log.q[k], atol=1e-6)
        np.testing.assert_allclose(row[places["u"]], log.acting[k], rtol=1e-6, atol=1e-6)
