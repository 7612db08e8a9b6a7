"""A learned policy as a controller: a network in a NumPy file, or any callable.

A policy maps an observation to an action with components in [-1, 1]. `PolicyView` makes the
observation, `InputScale` the input of the action. `softdyn.validation.environment` uses both, so
that a policy sees the same numbers when it learns and when it runs.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from softdyn import InputError, Reference, SetPoint, SoftModel, State
from softdyn.arrays import read_npz
from softdyn.checks import array, did_you_mean
from softdyn.controllers.controller import Command, GuardedController, InputGuard, KnownRig
from softdyn.dynamics.model import check_model
from softdyn.files import atomic
from softdyn.formats import KEY, POLICY, check_format

SENSORS = "sensors"
OBSERVED = ("q", "v", "y", "ydot", "error", "target", "input", SENSORS)
"""The parts of an observation, see `PolicyView`."""
USUAL = ("q", "v", "error")
Policy = Callable[[np.ndarray], Any]
"""Observation (n,) → action (nu,)."""


class InputScale:
    """The map between actions in [-1, 1] and inputs: -1 is the lower bound, 1 the upper one.

    Parameters
    ----------
    model : SoftModel
        The robot.

    Raises
    ------
    InputError
        The robot has no inputs, or one without finite bounds.
    """

    def __init__(self, model: SoftModel) -> None:
        if not model.nu:
            raise InputError("robot", "one with inputs", f"{model.name!r} without any")
        if not np.isfinite(model.u_max - model.u_min).all():
            raise InputError("robot", "inputs with finite bounds", f"{model.name!r} without")
        self._middle, self._half = (model.u_max + model.u_min) / 2, (model.u_max - model.u_min) / 2
        self._per = np.where(self._half > 0, 1 / np.where(self._half > 0, self._half, 1.0), 0.0)

    def input(self, action: np.ndarray) -> np.ndarray:
        """The input (nu,) of an action (nu,), which may lie beyond [-1, 1]."""
        return self._middle + self._half * action

    def action(self, u: np.ndarray) -> np.ndarray:
        """The action (nu,) of an input (nu,); 0 where both bounds are one number."""
        found: np.ndarray = (u - self._middle) * self._per
        return found


class PolicyView:
    """The observation of a policy: its named parts, one after the other.

    ========  ===========================================================================
    part      numbers
    ========  ===========================================================================
    q, v      joint positions (nq,) and velocities (nv,) (rad, m, rad/s, m/s)
    y, ydot   position and velocity of the tip (3,) (m, m/s)
    error     from the tip to the target (3,) (m)
    target    the target (3,) (m)
    input     the last input (nu,), as an action in [-1, 1]
    sensors   the rig's readings (k,) in their units; only `ReachEnv` has them
    ========  ===========================================================================

    Parameters
    ----------
    model : SoftModel
        The robot.
    parts : sequence of str
        The names of the parts, in their order.
    readings : int
        Number of the rig's readings.

    Attributes
    ----------
    parts : tuple of str
        As above.
    size : int
        Length of an observation.

    Raises
    ------
    InputError
        No part, an unknown one, one twice, or ``sensors`` without readings.
    """

    def __init__(self, model: SoftModel, parts: Sequence[str], readings: int = 0) -> None:
        self.parts = (parts,) if isinstance(parts, str) else tuple(parts)
        for part in self.parts:
            if part not in OBSERVED:
                expected = f"some of {', '.join(OBSERVED)}"
                raise InputError("observation", expected, did_you_mean(str(part), OBSERVED))
        if not self.parts or len({*self.parts}) < len(self.parts):
            raise InputError("observation", "at least one part, each once", self.parts)
        if SENSORS in self.parts and not readings:
            raise InputError("observation", 'readings, such as those of rig="file"', "none")
        self._scale = InputScale(model)
        sizes = {"q": model.nq, "v": model.nv, "input": model.nu, SENSORS: readings}
        self.size = sum(sizes.get(part, 3) for part in self.parts)

    def __call__(
        self,
        state: State,
        target: np.ndarray,
        u: np.ndarray,
        readings: np.ndarray | None = None,
    ) -> np.ndarray:
        """The observation (size,).

        Parameters
        ----------
        state : State
            The state that a controller sees.
        target : ndarray, (3,)
            The desired tip (m).
        u : ndarray, (nu,)
            The last input.
        readings : ndarray, (k,), optional
            The rig's readings.
        """
        found: list[Any] = []
        for part in self.parts:
            if part == "error":
                found.append(target - state.y)
            elif part == "target":
                found.append(target)
            elif part == "input":
                found.append(self._scale.action(u))
            elif part == SENSORS:
                found.append(readings)
            else:
                found.append(getattr(state, part))
        return np.concatenate(found)


class PolicyNetwork:
    """A linear policy, or a small network with tanh between its layers.

    The action is W_n tanh(… tanh(W_1 o + b_1) …) + b_n at the observation o. One layer is a linear
    policy.

    Parameters
    ----------
    layers : sequence of (array_like, array_like)
        Weights (outputs, inputs) and biases (outputs,) of each layer.
    observation : sequence of str
        The parts of the observation, see `PolicyView`.

    Raises
    ------
    InputError
        No layer, numbers that are not finite, layers that do not fit together.
    """

    def __init__(
        self, layers: Sequence[tuple[Any, Any]], observation: Sequence[str] = USUAL
    ) -> None:
        found: list[tuple[np.ndarray, np.ndarray]] = []
        for k, (weights, biases) in enumerate(layers):
            W = np.asarray(weights)
            size = found[-1][1].shape[0] if found else None
            if W.ndim != 2 or size not in (None, W.shape[1]):
                given = "inputs" if size is None else size
                raise InputError(f"W{k}", f"shape (outputs, {given})", W.shape)
            found.append((array(f"W{k}", W, W.shape), array(f"b{k}", biases, W.shape[:1])))
        if not found:
            raise InputError("layers", "at least one", "none")
        self.layers, self.observation = tuple(found), tuple(observation)

    @property
    def shape(self) -> tuple[int, int]:
        """The length of an action, and of an observation."""
        return len(self.layers[-1][1]), self.layers[0][0].shape[1]

    def __call__(self, observation: np.ndarray) -> np.ndarray:
        """The action (nu,), which may lie beyond [-1, 1]."""
        for weights, biases in self.layers[:-1]:
            observation = np.tanh(weights @ observation + biases)
        weights, biases = self.layers[-1]
        found: np.ndarray = weights @ observation + biases
        return found

    def save(self, path: str | Path) -> None:
        """Write an NPZ file; it appears complete or not at all.

        Its entries are ``observation``, the names of the parts, ``W0``, ``b0``, ``W1``, … and
        ``format``.

        Raises
        ------
        InputError
            When nothing can be written there.
        """
        entries = {KEY: np.array(POLICY), "observation": np.array(self.observation)}
        for k, (weights, biases) in enumerate(self.layers):
            entries |= {f"W{k}": weights, f"b{k}": biases}
        with atomic(path) as file:
            np.savez(file, **entries)  # type: ignore[arg-type]

    @classmethod
    def load(cls, path: str | Path) -> PolicyNetwork:
        """Read a network; the file may lack ``format``.

        Raises
        ------
        InputError
            The file cannot be read, an entry is missing or unknown, or the layers do not fit.
        """
        entries = read_npz(path, "an NPZ file with observation, W0, b0, W1, …", "policy")
        check_format(str(entries.pop(KEY, POLICY)), POLICY, str(path), "a policy")
        parts = np.atleast_1d(entries.pop("observation", np.array(USUAL)))
        layers: list[tuple[np.ndarray, np.ndarray]] = []
        while f"W{len(layers)}" in entries:
            k = len(layers)
            if f"b{k}" not in entries:
                raise InputError(str(path), f"an entry b{k}", "none")
            layers.append((entries.pop(f"W{k}"), entries.pop(f"b{k}")))
        if entries or not layers:
            expected = "entries observation, W0, b0, W1, …"
            raise InputError(str(path), expected, ", ".join(entries) or "none of them")
        try:
            return cls(layers, [str(part) for part in parts])
        except InputError as error:
            raise error.about(f"{path}: {error.name}") from None


class PolicyController(GuardedController):
    """A controller that asks a policy.

    An action beyond [-1, 1] gives the input at the bound. One that is not finite counts as a
    fallback, and the last good input acts on.

    Parameters
    ----------
    model : SoftModel
        The robot.
    policy : str or Path or PolicyNetwork or Callable[[ndarray], array_like]
        The NPZ file of a `PolicyNetwork`, such a network, or any function of an observation (n,)
        that returns an action (nu,). If it has a method `reset`, each run begins with a call of it.
    observation : sequence of str, optional
        The parts of the observation, see `PolicyView`; by default the network's own, or q, v and
        the error.

    Attributes
    ----------
    policy : Callable
        The network or the function.
    view : PolicyView
        It makes the observations.
    parameters : dict of str to Any
        The observation, and the file with its SHA-256, as a log has them.

    Raises
    ------
    InputError
        A file that cannot be read, an observation of other parts than a controller sees, a network
        of another robot's size.
    """

    name = "policy"

    def __init__(
        self,
        model: SoftModel,
        policy: str | Path | Policy,
        observation: Sequence[str] | None = None,
    ) -> None:
        file = Path(policy) if isinstance(policy, str | Path) else None
        self.policy: Any = policy if file is None else PolicyNetwork.load(file)
        if not callable(self.policy) or isinstance(self.policy, type):
            raise InputError("policy", "an NPZ file, or a callable observation -> action", policy)
        parts = getattr(self.policy, "observation", USUAL) if observation is None else observation
        self.view = PolicyView(check_model(model), parts, 1 if SENSORS in parts else 0)
        if SENSORS in self.view.parts:
            got = "sensors, which a controller does not get"
            raise InputError("observation", f"some of {', '.join(OBSERVED[:-1])}", got)
        expected = model.nu, self.view.size
        if isinstance(self.policy, PolicyNetwork) and self.policy.shape != expected:
            place = "policy" if file is None else str(file)
            raise InputError(place, f"{expected} actions and observations", self.policy.shape)
        self.parameters: dict[str, Any] = {"observation": list(self.view.parts)}
        if file is not None:
            digest = hashlib.sha256(file.read_bytes()).hexdigest()
            self.parameters |= {"file": file.name, "sha256": digest}
        self._scale = InputScale(model)
        self.guard = InputGuard(model.u_min, model.u_max, model.robot)

    def reset(self, period: float, rig: KnownRig | None = None) -> None:
        """Begin a run."""
        self.guard.reset()
        if hasattr(self.policy, "reset"):
            self.policy.reset()

    def _command(self, state: State, reference: Reference | SetPoint) -> Command:
        action = self.policy(self.view(state, reference.y, self.guard.held))
        u = self._scale.input(np.asarray(action, dtype=float))
        return self.guard.accept(u, np.nan, np.nan, clamped=True)
