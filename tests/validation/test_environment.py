"""The loop as a Gymnasium environment: its API, and the same numbers as a run of `simulate`."""

from pathlib import Path

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import softdyn
from softdyn import InputError, SetPoint
from softdyn.controllers import PolicyController, PolicyNetwork
from softdyn.description.rig import Sensor, SensorKind
from softdyn.validation import simulate
from softdyn.validation.environment import NAME, ReachEnv
from softdyn.validation.studies.sweep_file import sweep_of
from softdyn.validation.twin.rig import Rig
from tests.support import robots

WORDS = f"softdyn.validation.environment:{NAME}"
ERRORS = {
    "plant": {"mass": {"uniform": [0.8, 1.2]}, "stiffness": {"each": {"uniform": [0.7, 1.3]}}},
    "changes": {
        "late {}": {"rig": {"delay": [0.005, 0.01]}},
        "loaded": {"plant": {"payload": 0.01}},
    },
    "samples": {"count": 5, "seed": 3},
}
CAMERA = Sensor(
    "camera",
    SensorKind.POSITION,
    link=softdyn.load("finger").robot.task,
    noise=(1e-3,),
    latency=0.01,
)


def actions(env, seed=0, steps=None):
    rng = np.random.default_rng(seed)
    size = (env.grid.steps if steps is None else steps, env.model.nu)
    return rng.uniform(-0.4, 0.4, size)


def rolled(env, seed, rows):
    """The observations, and all other answers, of an episode."""
    seen, answers = [env.reset(seed=seed)[0]], []
    for row in rows:
        observation, *answer = env.step(row)
        seen.append(observation)
        answers.append(answer)
    return np.array(seen), answers


@pytest.fixture(scope="module")
def finger():
    return softdyn.load("finger")


@pytest.mark.filterwarnings("ignore:.*Box observation space:UserWarning")
@pytest.mark.parametrize("options", [
    {}, {"rig": "file", "observation": ("q", "input"), "randomised": ERRORS},
])  # fmt: skip
def test_gymnasium_accepts_it(options):
    env = gymnasium.make(WORDS, robot="finger", horizon=0.1, targets=[[0.1, 0, -0.15]], **options)
    check_env(env.unwrapped)


def test_wrappers_and_copies_in_other_processes_give_the_same_episodes(finger):
    options = {"robot": "finger", "horizon": 0.05, "targets": {"theta": {"uniform": [0, 2]}}}
    single = ReachEnv(**options)
    rows = actions(single)
    batch = gymnasium.make_vec(WORDS, 2, vectorization_mode="async", **options)
    try:
        seen, _ = batch.reset(seed=[7, 8])
        found = [seen]
        for row in rows[:-1]:  # the last one resets
            found.append(batch.step(np.tile(row, (2, 1)).astype(np.float32))[0])
    finally:
        batch.close()
    for k, seed in enumerate((7, 8)):
        alone, _ = rolled(single, seed, rows[:-1].astype(np.float32))
        np.testing.assert_array_equal(np.array(found)[:, k], alone)
    wrapped = gymnasium.wrappers.RecordEpisodeStatistics(
        gymnasium.wrappers.RescaleAction(ReachEnv(**options), np.float32(0), np.float32(1))
    )
    _, answers = rolled(wrapped, 7, (rows + 1) / 2)
    _, rewards = rolled(single, 7, rows)
    assert answers[-1][-1]["episode"]["l"] == len(rows)
    assert answers[-1][-1]["episode"]["r"] == pytest.approx(sum(r for r, *_ in rewards), abs=1e-4)


@pytest.mark.parametrize("options", [
    {},
    {"contacts": True, "friction": True, "plant": {"mass": 1.2, "payload": 0.02}},
    {"rig": Rig(delay=0.01, lag=0.02, noise=1e-3, latency=0.01), "randomised": ERRORS},
    {"rig": {"sensors": (CAMERA,)}, "observation": "sensors"},
    {"rig": {"sensors": (CAMERA,)}, "observer": "tip_force", "observation": ("q", "sensors")},
], ids=["ideal", "errors", "rig", "sensors", "observer"])  # fmt: skip
def test_an_episode_is_the_run_that_simulate_makes_of_its_inputs(finger, options):
    """Also the second episode of an environment, which may use the plant again."""
    env = ReachEnv(finger, horizon=0.1, targets=[[0.1, 0, -0.15]], **options)
    rolled(env, 1, actions(env, 5))
    seen, answers = rolled(env, 2, actions(env, 6))
    log = env.replay()
    assert log.steps == env.grid.steps
    if env.view.parts[0] == "q":  # those that a controller sees, without the last
        shown = log.q if log.q_seen is None else log.q_seen
        np.testing.assert_array_equal(seen[: len(shown), :4], shown)
    if "sensors" in env.view.parts:
        first = 0 if env.view.parts[0] == "sensors" else 4
        np.testing.assert_array_equal(seen[:, first : first + 3], log.measured)
    distances = np.linalg.norm(log.error, axis=1)
    np.testing.assert_allclose([a[-1]["distance"] for a in answers], distances[1:], atol=1e-15)
    np.testing.assert_allclose([a[0] for a in answers], -distances[1:] / 0.24, atol=1e-14)
    np.testing.assert_array_equal(env.episode.inputs, log.u)
    assert [a[2] for a in answers] == [False] * (log.steps - 1) + [True]
    assert not any(a[1] for a in answers)


def test_the_errors_of_an_episode_are_those_of_a_sweep(finger):
    """Sample and change of an episode give the settings of the sweep's case."""
    table = {"robots": "finger", "controllers": "ic", "rows": ["change", "sample"],
             "targets": {"theta": 0.5}, **ERRORS}  # fmt: skip
    expanded = sweep_of(table, Path("sweep.toml")).expanded
    cases = {(change, case.sample): case.options for case, change in expanded}
    env = ReachEnv(finger, horizon=0.05, targets=[[0.1, 0, -0.15]], randomised=ERRORS)
    met = set()
    for seed in range(12):
        _, info = env.reset(seed=seed)
        met.add(info["change"])
        options, case = env.episode.options, cases[info["change"], info["sample"]]
        assert options["plant"] == case["plant"]
        rig = {key: value for key, value in options.get("rig", {}).items() if key != "seed"}
        assert rig == case.get("rig", {})
        assert float(info["values"]["plant.mass"]) == case["plant"]["mass"]
    assert met == {"none", "late 0.005", "late 0.01", "loaded"}


def test_a_tip_too_far_away_ends_the_run_and_costs_the_rest_of_it(finger):
    tip = finger.state(finger.q0, np.zeros(finger.nv)).y
    env = ReachEnv(finger, horizon=0.1, targets=[-1.9 * tip])
    env.reset(seed=0)
    _, reward, terminated, truncated, info = env.step(np.zeros(2))
    assert (terminated, truncated) == (True, False)
    assert reward == pytest.approx(-info["distance"] / 0.24 * env.grid.steps)
    assert env.episode.ended
    with pytest.raises(InputError):
        env.step(np.zeros(2))


def test_an_action_beyond_its_range_is_clipped_and_counted_and_nan_is_refused(finger):
    env = ReachEnv(finger, horizon=0.1, targets=[[0.1, 0, -0.15]])
    env.reset(seed=0)
    assert env.step(np.array([3.0, -0.5]))[-1]["clipped"] == 1
    np.testing.assert_array_equal(env.episode.inputs[0], [finger.u_max[0], finger.u_min[1] / 2])
    for bad in ([np.nan, 0.0], [0.0], ["a", "b"]):
        with pytest.raises(InputError) as error:
            env.step(np.array(bad))
        assert error.value.name == "action"


def test_a_policy_acts_in_a_run_as_in_the_environment(finger):
    """The same observations and the same inputs, to the last bit, behind a rig too."""
    rng, parts = np.random.default_rng(0), ("q", "v", "error", "input")
    layers = [(0.3 * rng.normal(size=(8, 13)), 0.1 * rng.normal(size=8)),
              (0.3 * rng.normal(size=(2, 8)), np.zeros(2))]  # fmt: skip
    network, rig = PolicyNetwork(layers, parts), Rig(noise=1e-3, latency=0.01, lag=0.01)
    env = ReachEnv(finger, horizon=0.2, targets=[[0.1, 0, -0.15]], observation=parts, rig=rig)
    seen, _ = env.reset(seed=4)
    over = False
    while not over:
        seen, _, _, over, _ = env.step(network(seen))
    settings = {**env.episode.options, "period": env.grid.period}
    log = simulate(finger, PolicyController(finger, network), SetPoint(env.target), **settings)
    np.testing.assert_array_equal(log.u, env.episode.inputs)
    assert np.ptp(log.u, axis=0).min() > 0


@pytest.mark.parametrize(("options", "name"), [
    ({"observation": ("q", "speed")}, "observation"),
    ({"observation": "sensors"}, "observation"),
    ({"observation": ()}, "observation"),
    ({"targets": [[10, 0, 0]]}, "targets"),
    ({"targets": [[np.nan, 0, 0]]}, "targets"),
    ({"targets": np.zeros((0, 3))}, "targets"),
    ({"targets": {"omega": 0.1}}, "targets"),
    ({"reward": 3}, "reward"),
    ({"horizon": 0}, "duration"),
    ({"render_mode": "human"}, "render_mode"),
    ({"name": "me"}, "options"),
    ({"rigs": "file"}, "options"),
    ({"seed": -1}, "seed"),
    ({"randomised": {"plants": {}}}, "randomised"),
    ({"randomised": {"run": {"duration": [1, 2]}}}, "randomised"),
    ({"randomised": {"plant": {"mass": -1}}}, "randomised: plant.mass"),
])  # fmt: skip
def test_what_it_refuses(finger, options, name):
    with pytest.raises(InputError) as error:
        ReachEnv(finger, **{"targets": [[0.1, 0, -0.15]], **options})
    assert error.value.name.startswith(name)


def test_a_robot_without_inputs_is_refused(tmp_path):
    file = robots.write(tmp_path, '<robot name="bare"><link name="a"/></robot>')
    with pytest.raises(softdyn.SoftdynError):
        ReachEnv(file)
