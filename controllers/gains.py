"""Gains of the paper's controllers.

The published values (the paper's table, tab:controller_params) stand in each controller's class.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Collection, Mapping
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from softdyn import InputError, SoftModel
from softdyn.dynamics.model import check_model
from softdyn.exceptions import one_line
from softdyn.toml_table import TomlTable


@dataclass(frozen=True)
class Gains:
    """Parameters of the task-space controllers; a controller ignores those that it does not use.

    Attributes
    ----------
    Kp : float
        Stiffness of the task error (1/s²); the damping is K_d = 2 √K_p (1/s).
    eps : float
        ε of the Lyapunov function (s).
    w1, w2, w3, w4 : float
        Weights on ‖μ - μ_ref‖², ‖q̈‖², ‖u‖² and ‖q̈_null - q̈_null_ref‖².
    rho : float
        Weight on the slack, ρ δ².
    null_damping : float
        D of q̈_null_ref = -D N q̇ (1/s); 50 in the reference code, not in the paper.
    """

    Kp: float
    eps: float = 0.05
    w1: float = 1.0
    w2: float = 0.2
    w3: float = 0.2
    w4: float = 0.1
    rho: float = 1000.0
    null_damping: float = 50.0

    def __post_init__(self) -> None:
        check_fields(self, "gains", positive=("Kp", "eps", "rho"))

    @property
    def Kd(self) -> float:
        """Critical damping 2 √K_p (1/s)."""
        return 2.0 * math.sqrt(self.Kp)


def check_fields(table: Any, name: str, positive: Collection[str]) -> None:
    """Raise `InputError` for a field that is not finite or negative, or 0 and in `positive`."""
    for key, value in vars(table).items():
        number = isinstance(value, int | float) and not isinstance(value, bool)
        above = key in positive
        if not (
            number and abs(value) <= sys.float_info.max and (value > 0 if above else value >= 0)
        ):
            kind = "a positive number" if above else "a number >= 0"
            raise InputError(f"{name}.{key}", kind, repr(value))


def no_actuator(model: SoftModel) -> InputError:
    """The error to raise about a robot without inputs."""
    expected = f"an <actuator> in {model.robot.path}, or in a file given with --annotations"
    return InputError("model", expected, "none")


def from_table(
    model: SoftModel,
    published: Mapping[str, Gains],
    table: Mapping[str, Any],
    options: Collection[str] = (),
) -> Gains:
    """Gains from a table; for a bundled robot, missing fields take the published values.

    Parameters
    ----------
    model : SoftModel
        The robot.
    published : mapping
        The controller's published gains, by bundled robot.
    table : mapping
        Fields of `Gains`.
    options : collection of str
        Further parameters of the controller, for the message.

    Raises
    ------
    InputError
        For an unknown field, a number out of range, or a missing `Kp` that is not published.
    """
    names = [field.name for field in fields(Gains)]
    table = TomlTable(table, "gains").rest([*names, *options])
    found = published.get(model.bundled or "")
    if found is not None:
        return replace(found, **table)
    if "Kp" not in table:
        robot = f"{model.robot.path}, which has no published gains"
        expected = f"a value of Kp (--gains FILE; softdyn check --gains proposes one) for {robot}"
        raise InputError("gains", expected, ", ".join(table) or "nothing")
    return Gains(**table)


def resolve(model: SoftModel, published: Mapping[str, Gains], gains: Gains | None) -> Gains:
    """`gains`, or those of a bundled robot in a controller's published ones.

    Published gains belong to the bundled file, never to a robot that shares its name.

    Raises
    ------
    InputError
        For a robot without inputs or with crossed bounds, and if neither given nor published gains
        exist.
    """
    if check_model(model).nu == 0:
        raise no_actuator(model)
    if not (np.isfinite(model.u_max - model.u_min) & (model.u_min <= model.u_max)).all():
        bounds = f"u_min {model.u_min}, u_max {model.u_max}"
        raise InputError("model", "finite input bounds, lower <= upper", bounds)
    if gains is None:
        found = published.get(model.bundled or "")
        if found is None:
            file = one_line(model.robot.path, 1000)
            raise InputError(
                "gains", f"Gains(Kp=…) for {file}", None,
                f"This controller needs gains for {file}: pass --gains FILE, which `softdyn check "
                f"{file} --gains > FILE` writes (in Python Gains(Kp=…)), or use best, which needs "
                "none.",
            )  # fmt: skip
        return found
    if not isinstance(gains, Gains):
        raise InputError("gains", "softdyn.controllers.Gains(Kp=…, …)", gains)
    return gains
