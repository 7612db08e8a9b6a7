"""Conformance of a controller: `softdyn.controllers.Controller`."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np

from softdyn import SoftdynError, SoftModel, State
from softdyn.controllers.channels import channels_of, values_of
from softdyn.controllers.controller import Command, reset_controller
from softdyn.testing import samples
from softdyn.testing.report import Checks, Conformance, Unmet, copies, expect, numbers, timed
from softdyn.validation.loop.log import check_channel_name

PERIOD = 0.005  # s, of `reset` where no period is given
CALL = "controller(state, reference)"


def check_controller(
    controller: Any,
    model: SoftModel,
    *,
    references: Sequence[Any] | None = None,
    period: float | None = None,
    count: int = 20,
    seed: int = 0,
) -> Conformance:
    """RuleResult a controller: any class with ``__call__(state, reference) -> command``.

    Parameters
    ----------
    controller : Any
        A class that is built as ``CLASS(model)``, a function that builds one, or an object.
    model : SoftModel
        The robot.
    references : sequence, optional
        References for the calls; by default motions of the tip.
    period : float, optional
        Control period (s) of `reset`; the median of a call must be shorter.
    count, seed : int
        Number of random states, and their seed.
    """
    checks = Checks(controller, model)
    if not checks.run("it is built", lambda: type(checks.make()).__name__):
        return checks.report("controller")
    states = samples.states(model, count, seed)
    given = list(samples.references(model, count, seed) if references is None else references)
    cases = [(state, given[k % len(given)]) for k, state in enumerate(states)]

    def begun() -> Any:
        made = checks.make()
        reset_controller(made, period or PERIOD)
        return made

    def sequence(one: Any, some: Sequence[tuple[State, Any]] = cases) -> list[np.ndarray]:
        return [_input(one(*case), model, CALL) for case in some]

    def declared() -> str:
        one = begun()
        channels = channels_of(one)
        for channel in channels:
            check_channel_name(channel.name, own=True)
        for state, reference in cases:
            answer = one(state, reference)
            known = isinstance(answer, Command) or channels
            found = values_of(channels, answer) if known else {}
            for channel in channels:
                value = found.get(channel.name)
                there = value is not None and (channel.text or bool(np.isfinite(value).all()))
                expected = "text" if channel.text else "finite numbers, or a channel with gaps=True"
                expect(there or channel.gaps, f"{CALL}.values[{channel.name!r}]", expected, value)
        return ", ".join(channel.name for channel in channels) or "it declares none"

    def same_answers() -> None:
        _equal(sequence(begun()), sequence(begun()), "two new objects, the same calls")

    def kept() -> None:
        one = begun()
        held = one(*cases[0]).u
        before = np.array(held)
        one(*cases[-1])
        expect(np.array_equal(before, held), "u after the next call", f"{before}", held)

    def starts_again() -> str:
        one = begun()
        first = sequence(one)
        reset_controller(one, period or PERIOD)
        without = "" if hasattr(one, "reset") else "it has none, so it may keep no memory"
        what = "after reset(period)" if not without else "the same calls again, without a reset"
        _equal(first, sequence(one), what)
        return without

    def copied() -> None:
        half, original = len(cases) // 2, begun()
        sequence(original, cases[:half])
        for name, twin in copies(original).items():
            _equal(
                sequence(begun(), cases)[half:],
                sequence(twin, cases[half:]),
                f"{name}(controller) after {half} calls",
            )
        after = sequence(original, cases[half:])
        _equal(sequence(begun(), cases)[half:], after, "the original, after its copies were called")

    def hostile() -> str:
        one, (state, reference), raised = begun(), cases[-1], 0
        every = [(name, bad, reference) for name, bad in samples.hostile_states(state)]
        if references is None:
            every += [(name, state, bad) for name, bad in samples.hostile_references()]
        for name, bad, goal in every:
            with np.errstate(all="ignore"), warnings.catch_warnings():
                warnings.simplefilter("ignore")
                try:
                    command = one(bad, goal)
                except SoftdynError:
                    raised += 1
                    continue
            _input(command, model, f"{name}: {CALL}")
        _input(one(state, reference), model, f"{CALL} after hostile numbers")
        return f"{len(every)} calls, {raised} of them refused"

    def quick() -> str:
        one = begun()
        return timed([partial(one, *case) for case in cases], period, CALL)

    rules: dict[str, Callable[[], str | None]] = {
        "inputs are finite and within the bounds": lambda: _none(sequence(begun())),
        "declared channels have values": declared,
        "equal calls give equal answers": same_answers,
        "an answer does not change later": kept,
        "reset begins anew": starts_again,
        "copies and pickles go on alike": copied,
        "hostile numbers give bounded inputs": hostile,
        "a call is shorter than the period": quick,
    }
    for name, rule in rules.items():
        checks.run(name, rule)
    return checks.report("controller")


def _input(command: Any, model: SoftModel, call: str) -> np.ndarray:
    """The input of a command, checked, as a copy."""
    if not hasattr(command, "u"):
        raise Unmet(f"{call}: expected a Command, or an object with u, got {command!r:.80}")
    u = numbers(f"{call}.u", command.u, (model.nu,)).copy()
    low, high = model.u_min, model.u_max
    within = bool(((low <= u) & (u <= high)).all())
    expect(within, f"{call}.u", f"inputs in [{low}, {high}]", u)
    return u


def _none(_: Any) -> None:
    """No detail."""


def _equal(one: list[np.ndarray], other: list[np.ndarray], call: str) -> None:
    for k, (first, second) in enumerate(zip(one, other, strict=True)):
        expect(np.array_equal(first, second), f"{call}, call {k}: u", f"{first}", second)
