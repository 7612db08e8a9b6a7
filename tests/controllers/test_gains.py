"""Gains: the paper's table, and invalid gains."""

from __future__ import annotations

import math
import re
from dataclasses import FrozenInstanceError, fields

import pytest

import softdyn
from softdyn import SoftdynError
from softdyn.controllers import CONTROLLERS, Gains, Mpc, SoftIdClfQp
from softdyn.controllers.gains import from_table, resolve
from softdyn.controllers.staged import best
from tests.support import ROOT, robots
from tests.support.control_cases import BUNDLED, GAINS, robot
from tests.support.refused import refused

# tab:controller_params, retyped: K_p, ε, w1, w2, w3, w4, ρ; None where the table has a dash
TABLE = {
    ("finger", "clf-qp"): (500, 0.05, 1, None, None, None, 1000),
    ("finger", "soft-id-clf-qp"): (500, 0.03, 1, 0.2, 0.2, 0.1, 1000),
    ("finger", "ic"): (500, 0.03, None, None, None, None, None),
    ("finger", "uic"): (500, 0.03, None, None, None, None, None),
    ("finger", "ic-qp"): (1500, 0.03, 1, 0.02, 0.2, None, None),
    ("helix", "clf-qp"): (500, 0.05, 1, None, None, None, 1000),
    ("helix", "soft-id-clf-qp"): (500, 0.05, 1, 0.1, 0.2, 0.1, 1000),
    ("helix", "ic"): (2000, 0.05, None, None, None, None, None),
    ("helix", "uic"): (1000, 0.05, None, None, None, None, None),
    ("helix", "ic-qp"): (500, 0.05, 1, 0.1, 0.2, None, None),
    ("spirob", "clf-qp"): (500, 0.01, 1, None, None, None, 1000),
    ("spirob", "soft-id-clf-qp"): (500, 0.01, 1, 0.2, 0.5, 0.1, 1000),
    ("spirob", "ic"): (500, 0.01, None, None, None, None, None),
    ("spirob", "uic"): (500, 0.01, None, None, None, None, None),
    ("spirob", "ic-qp"): (2000, 0.01, 1, 0.2, 0.5, None, None),
}
FIELDS = [field.name for field in fields(Gains)]
POSITIVE = ("Kp", "eps", "rho")


@pytest.mark.parametrize("row", TABLE)
def test_published(row: tuple[str, str]) -> None:
    gains = CONTROLLERS[row[1]].published[row[0]]
    values = (gains.Kp, gains.eps, gains.w1, gains.w2, gains.w3, gains.w4, gains.rho)
    for value, expected in zip(values, TABLE[row], strict=True):
        assert expected is None or value == expected


def test_every_bundled_robot_has_gains_for_every_controller() -> None:
    for name in {name for _, name in TABLE} | {"id-clf-qp"}:
        law = CONTROLLERS[name]
        assert set(law.published) == set(BUNDLED)
        for gains in law.published.values():
            assert gains.null_damping == 50
            assert gains.rho == 1000


def test_the_hard_id_clf_qp_has_the_gains_of_the_soft_one() -> None:
    assert CONTROLLERS["id-clf-qp"].published == SoftIdClfQp.published


def test_damping_is_critical() -> None:
    assert Gains(Kp=500).Kd == pytest.approx(2 * math.sqrt(500), rel=1e-15)


@pytest.mark.parametrize("field", FIELDS)
@pytest.mark.parametrize(
    "value",
    [-1, -1e-300, math.nan, math.inf, -math.inf, "1", None, True, 1j, [1.0], b"1"],
    ids=repr,
)
def test_refused(field: str, value: object) -> None:
    with refused(f"gains.{field}"):
        Gains(**{"Kp": 1.0, field: value})


@pytest.mark.parametrize("field", FIELDS)
def test_zero_is_a_weight_but_no_rate(field: str) -> None:
    arguments = {"Kp": 1.0, field: 0.0}
    if field in POSITIVE:
        with refused(f"gains.{field}", 0.0):
            Gains(**arguments)
    else:
        assert getattr(Gains(**arguments), field) == 0


def test_a_message_is_one_line() -> None:
    with pytest.raises(SoftdynError) as error:
        Gains(Kp="a\nb" * 500)
    assert "\n" not in str(error.value)
    assert len(str(error.value)) < 250


def test_frozen() -> None:
    with pytest.raises(FrozenInstanceError):
        Gains(Kp=1.0).Kp = 2.0


def test_resolve() -> None:
    bundled, micro = robot("finger"), robot("planar")
    published = CONTROLLERS["ic"].published
    assert resolve(bundled, published, None) is published["finger"]
    assert resolve(bundled, published, GAINS) is GAINS
    assert resolve(micro, published, GAINS) is GAINS
    with refused("gains", None):
        resolve(micro, published, None)
    with refused("gains"):
        resolve(bundled, {}, None)


@pytest.mark.parametrize(
    ("key", "said"),
    [
        ("kp", "'kp'; did you mean 'Kp'?"),
        ("horizons", "'horizons'; did you mean 'horizon'?"),
        ("zzz", "'zzz'"),
    ],
)
def test_a_name_that_is_no_gain_is_told_the_nearest(key: str, said: str) -> None:
    with refused(f"gains: {key}", said):
        from_table(robot("finger"), {}, {key: 1.0}, ("horizon",))


def test_what_a_robot_without_gains_or_inputs_is_told(tmp_path):
    text = (ROOT / "urdf" / "finger.urdf").read_text()
    (tmp_path / "own.urdf").write_text(text)
    with refused("gains", None):
        SoftIdClfQp(softdyn.load(tmp_path / "own.urdf"))
    model = robots.load(tmp_path, re.sub(r"<softdyn.*</softdyn>", "", text, flags=re.S))
    for law in (SoftIdClfQp, Mpc, best):
        with refused("model", "none"):
            law(model)
