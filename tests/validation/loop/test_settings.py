"""The declaration of a run's settings, and what follows from it."""

import subprocess
import sys

import numpy as np
import pytest

from softdyn import InputError
from softdyn.commands import rollout, run
from softdyn.validation import Integrator, PlantErrors, Rig, RunOptions
from softdyn.validation.loop.settings import declarations, default_of

GIVEN = {
    "duration": ("0.5", 0.5), "period": ("0.01", 0.01), "timestep": ("inf", np.inf),
    "integrator": ("rk4", Integrator.RK4), "q0": ("0.1", [0.1]), "v0": ("-1e-3", [-0.001]),
    "contacts": (None, True), "friction": (None, True), "plant": ("scene.xml", "scene.xml"),
    "rig": ("rig.toml", "rig.toml"), "observer": ("tip_force", "tip_force"),
    "surroundings": ("walls.toml", "walls.toml"),
}  # fmt: skip
WRONG = {
    "duration": 0.0, "period": "2 ms", "timestep": -1.0, "integrator": "heun", "contacts": 1,
    "friction": None, "rig": "model", "surroundings": "walls", "name": 3,
}  # fmt: skip


@pytest.mark.parametrize("name", [n for n, declared in declarations().items() if declared.option])
def test_run_has_an_option_for_every_setting(name):
    word, value = GIVEN[name]
    flag = declarations()[name].flag or f"--{name}"
    words = [flag] if word is None else [flag, word]
    base = ["finger", "ic", "--theta", "0"]
    assert run.parser.given(run.parser.parse_args([*base, *words]))[name] == value
    assert run.parser.given(run.parser.parse_args(base)).get(name) == default_of(name)


def test_rollout_has_the_settings_of_a_run_without_a_controller():
    has = rollout.parser.given(rollout.parser.parse_args(["finger"]))
    every = set(rollout.parser.parse_args(["finger"]).__dict__) & set(declarations())
    assert every == set(GIVEN) - {"duration", "observer"}
    assert has == {"integrator": Integrator.IMPLICITFAST, "contacts": False, "friction": False}


@pytest.mark.parametrize(("name", "value"), WRONG.items())
def test_a_setting_checks_its_value(name, value):
    for make in (RunOptions, lambda **given: RunOptions.of(given)):
        with pytest.raises(InputError) as caught:
            make(**{name: value})
        assert caught.value.name.split(":")[0] == name


def test_settings_are_kept_in_their_own_kind():
    made = RunOptions(duration=1, integrator="rk4", contacts=np.bool_(True))
    assert (type(made.duration), made.integrator, made.contacts) == (float, Integrator.RK4, True)


def test_tables_of_settings_become_their_objects():
    made = RunOptions.of({
        "plant": {"payload": 0.02}, "rig": {"lag": 0.01, "seed": 3},
        "surroundings": {"sphere": [{"centre": [0, 0, 1], "radius": 0.1}]},
    })  # fmt: skip
    assert made.plant == PlantErrors(payload=0.02)
    assert made.rig == Rig(lag=0.01, seed=3)
    assert made.surroundings.names == ("sphere_1",)


def test_the_declaration_needs_no_engine():
    """A command lists its options without NumPy and MuJoCo."""
    code = "import sys, softdyn.commands.run; print({'numpy', 'mujoco'} & {*sys.modules})"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "set()\n"
