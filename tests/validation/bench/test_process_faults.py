"""Faults of whole processes. The period is long, so that a stall of a busy machine is no fault."""

from __future__ import annotations

import pytest

from tests.support.forked import forked
from tests.support.rig_processes import fault

SLOW = ("--period", "1", "--ramp", "0", "--missed", "100", "--stale", "60", "--lost", "1000")


@pytest.mark.parametrize(
    ("kind", "code", "said"),
    [
        ("SIGINT", 130, "stopped by Ctrl-C"),
        ("SIGHUP", 1, "stopped by SIGHUP"),
        ("kill loop", 1, "stopped by the watchdog: the loop's process ended"),
        ("freeze loop", 1, "stopped by the watchdog: no heartbeat for 2000 ms"),
        ("kill watchdog", 1, "stopped by watchdog"),
        ("kill rig", 1, "stopped by driver"),
        ("kill command", -9, "stopped by SIGHUP: the process of softdyn drive has ended"),
    ],
)
def test_the_rig_is_relaxed_and_the_log_is_readable(tmp_path, kind, code, said):
    outcome = fault(tmp_path, kind, *SLOW, after=1.5, start=forked)  # a period and a half
    assert said in outcome.err
    assert outcome.code == code
    assert outcome.log.steps >= 1
