"""Errors to which a program reacts have a class of their own, and keep it on their way."""

import pickle

import numpy as np
import pytest

import softdyn
from softdyn import FormatError, InputError, NotIdentifiable, OutOfReach, SoftdynError, statics
from softdyn.exceptions import errors_in
from softdyn.files import read_toml
from softdyn.identification import Measurements, choose_unknowns, identify
from softdyn.statics import NoEquilibrium, StaticsError
from softdyn.validation import Log, paper
from softdyn.validation.files import read_json
from tests.support.command import command


def test_a_target_far_away_is_out_of_reach():
    model = softdyn.load("finger")
    with pytest.raises(OutOfReach):
        paper.experiment(model, target=[0.0, 0.0, 9.0])
    with pytest.raises(InputError) as refused:
        paper.experiment(model, target=[0.0, 0.0, np.nan])
    assert not isinstance(refused.value, OutOfReach)


def test_a_shape_that_no_input_holds_is_no_equilibrium():
    """Without gravity's balance: far from all equilibria Newton ends at no zero of the forces."""
    model = softdyn.load("spirob")
    rng = np.random.default_rng(0)
    raised = []
    for _ in range(30):
        q = rng.uniform(model.lower, model.upper)
        try:
            statics.balance(model, rng.uniform(model.u_min, model.u_max), q)
        except StaticsError as error:
            raised.append(type(error))
    assert set(raised) == {NoEquilibrium}


def test_data_that_show_nothing_are_not_identifiable():
    """At rest no damper moves, so that these data show none."""
    model = softdyn.load("finger")
    u = np.linspace(-0.05, 0.05, 6)[:, None] * [1.0, 1.0]
    q = np.array([statics.settle(model, each).q for each in u])
    names = tuple(f"q.{name}" for name in model.joint_names)
    data = Measurements(60.0 * np.arange(6), u, names, q)
    with pytest.raises(NotIdentifiable):
        identify(model, data, choose_unknowns(model, shared=("damping",)), step=10.0, hold_out=0.0,
                 acquisition=softdyn.identification.problem.Acquisition(static=True))  # fmt: skip


@pytest.mark.parametrize(("name", "text", "read"), [
    ("a.toml", "= 1", read_toml),
    ("a.toml", 'format = "softdyn-toml-99"', read_toml),
    ("a.json", "[1]", lambda path: read_json(path, "an object")),
    ("a.csv", "t,q.x\n0\n", lambda path: Log.from_csv(path)),
    ("a.npz", "no archive", Log.load),
])  # fmt: skip
def test_a_file_of_another_format(name, text, read, tmp_path):
    (tmp_path / name).write_text(text)
    with pytest.raises(FormatError) as refused:
        read(tmp_path / name)
    assert name in refused.value.name
    with pytest.raises(InputError) as lost:
        read(tmp_path / f"none-{name}")
    assert not isinstance(lost.value, FormatError)


@pytest.mark.parametrize("kind", [OutOfReach, NotIdentifiable, FormatError, InputError])
def test_the_class_survives_a_process_and_a_place(kind):
    error = kind("target", "a near one", "a far one")
    again = pickle.loads(pickle.dumps(error))
    assert (type(again), str(again)) == (kind, str(error))
    with pytest.raises(kind) as placed, errors_in("file.toml"):
        raise error
    assert type(placed.value) is kind
    assert str(placed.value).startswith("file.toml: target: ")


def test_a_command_still_says_one_line_and_exits_with_2(tmp_path):
    (tmp_path / "bad.toml").write_text("= 1")
    done = command(
        "run", "finger", "ic", "--theta", "0", "--gains", "bad.toml", "--duration", "0.01",
        cwd=tmp_path,
    )  # fmt: skip
    assert done.code == 2
    assert done.err.count("\n") == 1
    assert issubclass(FormatError, SoftdynError)
