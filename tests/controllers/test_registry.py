"""Controllers by name, and one-line errors for mistakes in a user's file."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from softdyn import InputError
from softdyn.controllers import Gains, Mpc, SoftIdClfQp
from softdyn.controllers.registry import (
    CONTROLLERS,
    find_controller,
    is_own,
    make_controller,
    one_line_errors,
)
from softdyn.tasks import PointTask
from tests.support.control_cases import robot
from tests.support.refused import refused

OWN = """
import sys

class Table:
    def __init__(self, model, table=None):
        self.table = table

class Leaves:
    def __init__(self, model):
        sys.exit(3)

class Broken:
    def __init__(self, model):
        return {}["nothing"]
"""


def test_the_classes_of_a_file_are_named(own: str) -> None:
    with refused("controller", "'table'; did you mean 'Table'?"):
        find_controller(f"{own}:table")
    with refused("controller", None):
        find_controller(None)  # type: ignore[arg-type]


@pytest.fixture
def own(tmp_path: Path) -> str:
    (tmp_path / "mine.py").write_text(OWN)
    return str(tmp_path / "mine.py")


def test_with_and_without_parameters(own: str) -> None:
    model, published = robot("finger"), CONTROLLERS["ic"].published["finger"]
    assert isinstance(make_controller("soft-id-clf-qp", model), SoftIdClfQp)
    assert make_controller("ic", model, {"Kp": 70.0}).gains == replace(published, Kp=70.0)
    law = make_controller("soft-id-clf-qp", model, {"horizon": 0.02, "u_ref": [0.1, -0.2]})
    assert law.gains == CONTROLLERS["soft-id-clf-qp"].published["finger"]
    assert (law.horizon, [*law.u_ref]) == (0.02, [0.1, -0.2])
    assert make_controller("ic", model, Gains(80.0)).gains == Gains(80.0)
    assert isinstance(make_controller("mpc", model), Mpc)
    assert make_controller(f"{own}:Table", model, {"any": 1}).table == {"any": 1}
    assert make_controller(f"{own}:Table", model).table is None


def test_the_file_of_the_gains_is_not_blamed_for_the_tasks() -> None:
    model, tip = robot("finger"), PointTask("tip")
    with pytest.raises(InputError) as refused:
        make_controller("ic", model, {"Kp": 70.0}, source="gains.toml", tasks=(tip, tip))
    assert refused.value.name == "tasks"
    with pytest.raises(InputError) as refused:
        make_controller("ic", model, {"Kp": -70.0}, source="gains.toml", tasks=None)
    assert refused.value.name == "gains.toml: gains.Kp"


@pytest.mark.parametrize(
    ("name", "said"),
    [("soft-id-clf-pq", "; did you mean 'soft-id-clf-qp'?"), ("MPC", "; did you mean 'mpc'?"),
     ("tangerine", "")],
)  # fmt: skip
def test_a_misspelt_name_is_told_the_nearest(name: str, said: str) -> None:
    with refused("controller") as error:
        find_controller(name)
    assert str(error.value).endswith(f"got {name!r}{said}")


def test_what_cannot_be_built_is_one_line(own: str) -> None:
    model = robot("finger")
    with refused("gains: kp", "'kp'; did you mean 'Kp'?"):
        make_controller("ic", model, {"kp": 1.0})
    with refused("gains: horizon", "'horizon'"):
        make_controller("ic", model, {"horizon": 1.0})
    with refused("u_ref", "shape (1,)"):
        make_controller("soft-id-clf-qp", model, {"u_ref": [1.0]})
    with refused("mine.py:Leaves", "SystemExit in line 10: 3"):
        make_controller(f"{own}:Leaves", model)
    with refused("mine.py:Broken", "KeyError in line 14: 'nothing'"):
        make_controller(f"{own}:Broken", model)


def test_errors_of_running_code_pass() -> None:
    assert is_own("a/b.py:C")
    assert not is_own("best")
    with pytest.raises(ZeroDivisionError), one_line_errors("best", "a command"):
        raise ZeroDivisionError
    with pytest.raises(ZeroDivisionError), one_line_errors("mine.py:C", "a command"):
        raise ZeroDivisionError  # here is a user's own code, so its traceback is shown
