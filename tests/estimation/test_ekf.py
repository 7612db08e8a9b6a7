"""The filter against a dense reference, in its statistics, and under hostile data."""

from __future__ import annotations

import tracemalloc
from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import block_diag, expm
from scipy.optimize import root

import softdyn
from softdyn import InputError
from softdyn.description.rig import Sensor
from softdyn.description.rig import SensorKind as KIND
from softdyn.dynamics.balance import ForceBalance
from softdyn.dynamics.implicit_step import ImplicitStep
from softdyn.estimation import Disturbance, Ekf, EkfParameters
from softdyn.estimation.consistency import chi_squared_bounds, nees
from softdyn.estimation.covariance import symmetrised, update
from softdyn.sensing import Sensors
from tests.support.oracles import slopes
from tests.support.rigs import sensors
from tests.support.robots import WALKER, write

PERIOD = 0.005
MEMORY = EkfParameters().memory
LATE, RATE = 0.013, 125.0  # of the camera; its samples are between the steps


class Reference:
    """The joint distribution of the states at all times so far, with numerical Jacobians.

    Its last block is the present. A late reading corrects all of them through the block of its own
    time: a batch smoother, linearised where the filter is.
    """

    def __init__(self, model, P, force, tip):
        self.model, self.force, self.with_tip = model, force, tip
        n = model.nv
        self.mean = [np.zeros(2 * n + 6 * tip)]  # the force and its rate
        self.mean[0][:n] = model.q0
        self.P, self.at, self.n = P, self.mean[0].copy(), n

    def flow(self, x, u, step, push):
        model, n = self.model, self.n

        def residual(v):
            state = model.state(x[:n] + step * v, v)
            force = state.J.T @ x[2 * n : 2 * n + 3] if self.with_tip else 0.0
            return state.M @ (v - x[n : 2 * n]) / step + state.h - state.B @ u - force - push

        scale = step / np.diag(model.state(x[:n], x[n : 2 * n]).M)
        found = root(lambda v: scale * residual(v), x[n : 2 * n], tol=1e-14)
        drift = drifts(step)[0] if self.with_tip else np.zeros((0, 0))
        return np.concatenate((x[:n] + step * found.x, found.x, drift @ x[2 * n :]))

    def predict(self, u, step):
        n, x, size = self.n, self.mean[-1], len(self.mean[-1])
        none, h = np.zeros(n), 1e-4
        F = slopes(lambda dx: self.flow(x + dx, u, step, none), size, h)
        G = slopes(lambda f: self.flow(x, u, step, f), n, 1e-5)
        Q = G @ np.diag(self.force / step) @ G.T
        if self.with_tip:
            Q[2 * n :, 2 * n :] += drifts(step)[1]
        cross = F @ self.P[-size:]
        self.P = np.block([[self.P, cross.T], [cross, cross[:, -size:] @ F.T + Q]])
        self.mean.append(self.flow(x, u, step, none))

    def tip(self, x):
        return self.model.state(x[: self.n], np.zeros(self.n)).y

    def lengths(self, x):
        return self.model.tendon_lengths(x[: self.n])[:2]

    def update(self, parts):
        """Fuse readings (values, function, block, linearised at) all at once."""
        size = len(self.mean[-1])
        H, e, R = [], [], []
        for values, reading, block, about in parts:
            row = np.zeros((len(values), len(self.P)))
            row[:, block * size : (block + 1) * size] = slopes(
                lambda dx, f=reading, x=about: f(x + dx), size, 1e-4
            )
            moved = row[:, block * size : (block + 1) * size] @ (self.mean[block] - about)
            H.append(row)
            e.append(values - reading(about) - moved)
            R.append(np.full(len(values), 1e-6 if len(values) == 3 else 2.5e-7))
        H, e, R = np.vstack(H), np.concatenate(e), np.diag(np.concatenate(R))
        S = H @ self.P @ H.T + R
        gain = np.linalg.solve(S, H @ self.P).T
        change = gain @ e
        for block, mean in enumerate(self.mean):
            mean += change[block * size : (block + 1) * size]
        rest = np.eye(len(self.P)) - gain @ H
        self.P = rest @ self.P @ rest.T + gain @ R @ gain.T
        return float(e @ np.linalg.solve(S, e))


def drifts(step, memory=MEMORY, deviation=1e-3):
    """Transition and covariance of three forces with rates over a step (Van Loan 1978)."""
    A = np.array([[0, 1], [-1 / memory**2, -2 / memory]])
    W = np.diag([0, 4 * deviation**2 / memory**3])
    whole = expm(step * np.block([[-A, W], [np.zeros((2, 2)), A.T]]))
    turn = whole[2:, 2:].T
    return np.kron(turn, np.eye(3)), np.kron(turn @ whole[:2, 2:], np.eye(3))


@pytest.mark.parametrize("tip", [False, True], ids=["state", "with the force at the tip"])
def test_dense_reference_and_batch_smoother(tip):
    model = softdyn.load("finger")
    rng = np.random.default_rng(4)
    ekf = Ekf(
        model, sensors(model, rate=RATE, latency=LATE), ("tip_force",) if tip else (),
        parameters=EkfParameters(spread=2e-3, process=1e-3, tip_force=1e-3, longest=1.0),
    )  # fmt: skip
    P = np.diag(np.concatenate((ekf._filtered.first, ekf._filtered.drift.variances)))
    reference = Reference(model, P, ekf._filtered.force_noise, tip)
    truth = reference.mean[0] + rng.normal(size=len(P)) * np.sqrt(np.diag(P))
    at, samples, block_of, arrived = 0.0, {}, {}, -1
    u, compared = np.zeros(2), 0

    def sample(t):
        k = round(t * RATE)
        if abs(k / RATE - t) < 1e-9:
            samples[k] = reference.tip(truth) + 1e-3 * rng.normal(size=3)
            block_of[k] = len(reference.mean) - 1, reference.mean[-1].copy()

    for step in range(12):
        t = step * PERIOD
        stops = [k / RATE for k in range(20) if at + 1e-9 < k / RATE < t - 1e-9]
        for end in [*stops, t] if step else []:
            truth = reference.flow(truth, u, end - at, np.zeros(4))
            reference.predict(u, end - at)
            at = end
            if at < t:
                sample(at)
        lengths = reference.lengths(truth) + 5e-4 * rng.normal(size=2)
        here = reference.mean[-1].copy()
        parts = [(lengths, reference.lengths, len(reference.mean) - 1, here)]
        k = int(np.floor((t - LATE) * RATE + 1e-6))
        if k > arrived:
            parts.append((samples[k], reference.tip, *block_of[k]))
            arrived = k
        estimate = ekf.step(t, np.concatenate((lengths, samples.get(k, np.full(3, np.nan)))), u)
        nis = reference.update(parts)
        sample(t)
        size, n = len(here), 4
        mean, cov = reference.mean[-1], reference.P[-size:, -size:]
        assert np.abs(estimate.q - mean[:n]).max() < 1e-6 * np.abs(mean[:n]).max() + 1e-9
        assert np.abs(estimate.v - mean[n : 2 * n]).max() <= 1e-6 * np.abs(mean[n : 2 * n]).max()
        assert np.abs(ekf._filter.P[:size, :size] - cov).max() < 1e-6 * np.abs(cov).max()
        # small variances too, each in its own scale
        scale = np.sqrt(np.outer(np.diag(cov), np.diag(cov)))
        assert np.abs((ekf._filter.P[:size, :size] - cov) / scale).max() < 1e-5
        assert nis == pytest.approx(estimate.nis, rel=1e-5)
        assert estimate.used == 2 + 3 * (len(parts) - 1)
        compared += estimate.used
        if tip:
            force = estimate.disturbances["tip_force"]
            assert np.allclose(force, mean[2 * n : 2 * n + 3], atol=1e-7)
        u = rng.uniform(model.u_min, model.u_max)
    assert compared > 30
    assert ekf.counts.unmatched == 0


def simulated(model, ekf, steps, rng, start, u):
    """Truth and estimates with the filter's own process noise in the plant."""
    chosen, n = ekf._filtered.step, model.nv
    q, v = model.integrate(model.q0, start[:n]), start[n:]
    held, truth = np.zeros(n, int), Sensors(model, sensors(model))
    state = model.state(q, v)
    for k in range(steps):
        if k:
            found = chosen(q, v, u, np.zeros(0), PERIOD, held)
            push = rng.normal(size=n) * np.sqrt(ekf._filtered.force_noise / PERIOD)
            kick = found.by_force @ push
            q, v, held = model.integrate(found.q, PERIOD * kick), found.v + kick, found.held
            state = model.state(q, v)
        ideal = truth.measure(state, u).values
        noise = np.concatenate([np.sqrt(c.variance) for c in ekf._channels])
        yield state, ekf.step(k * PERIOD, ideal + noise * rng.normal(size=len(ideal)), u)


def test_consistency_on_the_finger():
    """NEES and NIS within bounds, starts drawn from P0 and the filter's own noise in the plant."""
    model = softdyn.load("finger")
    given = EkfParameters(spread=0.03)
    runs, steps, errors, nis, used = 16, 25, [], 0.0, 0
    for seed in range(runs):
        rng = np.random.default_rng(seed)
        ekf = Ekf(model, sensors(model), parameters=given)
        start = rng.normal(size=8) * np.sqrt(ekf._filtered.first)
        for state, estimate in simulated(model, ekf, steps, rng, start, np.array([0.3, -0.2])):
            last = nees(estimate, state)
            nis, used = nis + estimate.nis, used + estimate.used
        errors.append(last[0])
    low, high = chi_squared_bounds(8, runs, 0.999)
    assert low < np.mean(errors) < high
    low, high = chi_squared_bounds(used, 1, 0.999)
    assert low < nis < high


def test_steady_force_is_found():
    """A constant load at the tip, with its interval; without the disturbance the tip is off."""
    model = softdyn.load("finger")
    force, u = np.array([0.02, 0.0, -0.01]), np.zeros(2)
    given = EkfParameters(process=1e-3, tip_force=0.1)
    truth, found = (Ekf(model, sensors(model), ("tip_force",), parameters=given) for _ in range(2))
    q, v = model.q0, np.zeros(4)
    held = np.zeros(4, int)
    rng = np.random.default_rng(0)
    for k in range(600):
        step = truth._filtered.step(q, v, u, force, PERIOD, held)
        q, v, held = step.q, step.v, step.held
        state = model.state(q, v)
        z = np.concatenate((state.lengths[:2], state.y))
        z += np.repeat([5e-4, 1e-3], [2, 3]) * rng.normal(size=5)
        estimate = found.step(k * PERIOD, z, u)
    low, high = estimate.interval("tip_force")
    assert np.all(low <= force)
    assert np.all(force <= high)
    width = high - low
    assert abs(estimate.disturbances["tip_force"][0] - force[0]) < 0.006
    assert width[0] < 0.05
    assert width[1] > 0.3  # the finger is planar


@pytest.mark.parametrize(
    ("force", "given", "largest"),
    [
        (0.0, {}, 1e-4),
        (0.02, {}, 5e-4),
        (0.0, {"least_process": 0.4}, None),
        (0.02, {"process": 0.03}, None),
    ],
)
def test_the_process_noise_adapts(force, given, largest):
    """A right model's estimate is calm, and a force that it lacks is followed, by one default.

    A constant deviation serves one of both: 0.4 (0.17 mm, not 0.03) or 0.03 (3.6 mm, not 0.35).
    """
    model, u = softdyn.load("finger"), np.array([0.3, -0.2])
    plant = ImplicitStep(model, ForceBalance(model, (Disturbance.TIP_FORCE,)))
    q, v = model.q0, np.zeros(4)
    ekf = Ekf(model, sensors(model), parameters=EkfParameters(**given))
    truth = Sensors(model, sensors(model))
    rng, held, errors, asked = np.random.default_rng(0), np.zeros(4, int), [], []
    for k in range(400):  # the force begins after 1 s
        found = plant(q, v, u, (k >= 200) * np.array([force, 0.0, -force]), PERIOD, held)
        q, v, held = found.q, found.v, found.held
        state = model.state(q, v)
        z = truth.measure(state, u).values + np.repeat([5e-4, 1e-3], [2, 3]) * rng.normal(size=5)
        estimate = ekf.step(k * PERIOD, z, u)
        errors.append(np.linalg.norm(model.state(estimate.q, estimate.v).y - state.y))
        asked.append(ekf.process)
    error = np.sqrt(np.mean(np.square(errors[300:])))
    if largest is None:
        assert error > (1e-3 if force else 1.5e-4)
        return
    assert error < largest
    assert asked[199] < 0.05
    assert (asked[-1] > 0.1) == (force > 0)
    assert ekf.parameters.least_process <= min(asked)
    assert max(asked) <= ekf.parameters.process


def test_hostile_data_is_counted():
    """Gaps, NaN, infinities, duplicates and jumps of time; every estimate is finite."""
    model = softdyn.load("finger")
    ekf = Ekf(model, sensors(model, rate=60.0, latency=0.03))
    clean = np.concatenate((model.tendon_lengths(model.q0)[:2], model.state(model.q0, [0] * 4).y))
    rng, t = np.random.default_rng(0), 0.0
    odd = [np.nan, np.inf, -np.inf, 1e308, 3e6]
    for k in range(1500):
        t += PERIOD
        z, when, u = clean.copy(), t, rng.uniform(model.u_min, model.u_max)
        if k % 3 == 1:
            z[rng.integers(5)] = odd[k % 5]
        if k % 50 == 7:
            when = [np.nan, np.inf, t - 1.0, t - PERIOD][k // 50 % 4]
        if k % 50 == 8:
            u[0] = np.nan
        if k % 400 == 300:
            t, when = t + 1.0, t + 1.0
        if k % 400 == 350:
            z = z + 1e3  # a finite number that no robot can reach
        estimate = ekf.step(when, z, u)
        for part in (estimate.q, estimate.v, estimate.covariance):
            assert np.isfinite(part).all()
        assert np.linalg.eigvalsh(estimate.covariance)[0] > -1e-12
        assert np.all(estimate.q <= model.upper + 1e-9)
        assert np.all(estimate.q >= model.lower - 1e-9)
    counts = ekf.counts
    assert counts.refused == 30
    assert counts.held == 30
    assert counts.gaps == 3
    assert counts.skipped > 100
    assert counts.used > 2500


def at_rest(model, u):
    """The state to which constant inputs lead, and the readings there."""
    plant, q, v, held = ImplicitStep(model), model.q0, np.zeros(4), np.zeros(4, int)
    for _ in range(2000):
        found = plant(q, v, u, np.zeros(0), PERIOD, held)
        q, v, held = found.q, found.v, found.held
    return q, Sensors(model, sensors(model)).measure(model.state(q, v), u).values


def test_wrong_readings_correct_little():
    """One wrong reading hardly moves the estimate; a start that is surely wrong is left."""
    model, u = softdyn.load("finger"), np.array([0.3, -0.2])
    q, z = at_rest(model, u)
    for odd in (1e3, 0.3, -0.3):
        ekf = Ekf(model, sensors(model), start=(q, np.zeros(4)))
        for k in range(40):
            estimate = ekf.step(k * PERIOD, z + odd * (k == 20), u)
            assert np.abs(estimate.q - q).max() < 0.01, (odd, k)
        assert ekf.counts.doubted == 5
    sure = EkfParameters(spread=1e-4, lost=1e-4)
    ekf = Ekf(model, sensors(model), parameters=sure, start=(q + 0.2, np.zeros(4)))
    for k in range(200):
        estimate = ekf.step(k * PERIOD, z, u)
    assert ekf.counts.doubted > 0
    assert np.abs(estimate.q - q).max() < 0.01


def test_a_clock_that_is_set():
    """After ten refused steps the new time counts, as after a gap."""
    model, u = softdyn.load("finger"), np.array([0.3, -0.2])
    q, z = at_rest(model, u)
    for jump in (-0.1, -3600.0, 3600.0):
        ekf = Ekf(model, sensors(model, rate=60.0, latency=0.03), start=(q, np.zeros(4)))
        for k in range(80):
            once = jump > 0  # one wrong time, then the right ones; or all from now on
            t = 3600.0 + k * PERIOD + jump * (k == 40 if once else k >= 40)
            estimate = ekf.step(t, z, u)
            assert np.abs(estimate.q - q).max() < 0.01
        assert (ekf.counts.refused, ekf.counts.gaps) == (10, 1 + once)
        assert estimate.used == 2
        assert ekf.counts.used > 2 * 65 + 3 * 15


def test_duplicate_and_refused_steps_change_nothing():
    model = softdyn.load("finger")
    ekf = Ekf(model, sensors(model))
    z = np.concatenate((model.tendon_lengths(model.q0)[:2], [0.2, 0.0, -0.05]))
    before = ekf.step(0.0, z, np.zeros(2))
    for t in (0.0, -1.0, np.nan):
        again = ekf.step(t, z, np.zeros(2))
        assert np.array_equal(again.q, before.q)
        assert np.array_equal(again.covariance, before.covariance)
    assert ekf.counts.refused == 3
    assert ekf.counts.used == 5
    with pytest.raises(ValueError, match="read-only"):
        before.q[0] = 1.0


def test_a_start_that_the_first_readings_refute_is_unknown():
    """The covariance is then that of `lost`; a start within its deviations is kept."""
    model = softdyn.load("finger")
    found = {}
    for wrong in (0.0, 0.2):
        q = np.full(4, wrong)
        z = np.concatenate((model.tendon_lengths(q)[:2], model.state(q, [0] * 4).y))
        ekf, wide = (
            Ekf(model, sensors(model), parameters=given)
            for given in (EkfParameters(), EkfParameters(spread=0.1))
        )
        one, other = (each.step(0.0, z, np.zeros(2)) for each in (ekf, wide))
        assert ekf.counts.refuted == (wrong > 0)
        assert ekf.counts.used == 5
        found[wrong] = np.allclose(one.q, other.q, atol=1e-9) and np.allclose(
            one.covariance, other.covariance
        )
    assert found == {0.0: False, 0.2: True}


def test_a_lost_filter_begins_anew():
    """At its start, with the deviations of `lost`."""
    model = softdyn.load("finger")
    ekf = Ekf(model, sensors(model))
    z = np.concatenate((model.tendon_lengths(model.q0)[:2], model.state(model.q0, [0] * 4).y))
    ekf.step(0.0, z, np.zeros(2))
    ekf._filter.v[:] = np.nan
    estimate = ekf.step(0.005, z, np.zeros(2))
    assert ekf.counts.restarts == 1
    assert np.allclose(estimate.q, model.q0)
    deviations = np.sqrt(np.diag(estimate.covariance))
    assert np.allclose(deviations[:4], ekf.parameters.lost * (model.upper - model.lower).clip(0, 1))
    unknown = Ekf(model, sensors(model), parameters=EkfParameters(spread=ekf.parameters.lost))
    assert np.allclose(deviations, np.sqrt(unknown._filtered.first))
    assert ekf.step(0.01, z, np.zeros(2)).used == 5


@pytest.mark.parametrize("disturbances", [(), ("tip_force", "payload")])
def test_a_reset_filter_is_a_new_one(disturbances):
    """To the bit: nothing of the run before is left."""
    model = softdyn.load("finger")
    ekf = Ekf(model, sensors(model, rate=60.0, latency=0.03), disturbances)
    rng = np.random.default_rng(0)
    z = np.concatenate((model.tendon_lengths(model.q0)[:2], model.state(model.q0, [0] * 4).y))
    rows, inputs = z + 1e-3 * rng.normal(size=(40, 5)), rng.uniform(-0.3, 0.3, (40, 2))

    def run():
        steps = enumerate(zip(rows, inputs, strict=True))
        return [ekf.step(PERIOD * k, row, u) for k, (row, u) in steps]

    first = run()
    ekf.reset()
    for one, other in zip(first, run(), strict=True):
        for name in ("q", "v", "covariance", "residuals"):
            assert np.array_equal(getattr(one, name), getattr(other, name), equal_nan=True), name


def test_variances_are_never_negative():
    """Rounding leaves -1e-18 where readings know everything; that is zero."""
    P = np.diag([1.0, -1e-18, 2.0])
    P[0, 1] = P[1, 0] = 1e-12
    assert symmetrised(P) == 3.0
    assert np.array_equal(P, np.diag([1.0, 0.0, 2.0]))
    model = softdyn.load("finger")
    exact = [replace(one, noise=(1e-9,)) for one in sensors(model)]
    ekf = Ekf(model, exact, ("tip_force",), parameters=EkfParameters(process=1e-6, lost=1.0))
    q = model.lower.copy()  # at the stops
    z = np.concatenate((model.tendon_lengths(q)[:2], model.state(q, np.zeros(4)).y))
    ekf.reset(q)
    for k in range(200):
        estimate = ekf.step(PERIOD * k, z, np.sin(k) * model.u_max)
        assert (np.diag(estimate.covariance) >= 0).all()
        assert (estimate.deviations["tip_force"] >= 0).all()


def test_memory_of_a_step():
    """A step leaves nothing behind but its estimate, and needs little more while it runs."""
    model = softdyn.load("helix")
    ekf = Ekf(model, sensors(model, rate=60.0, latency=0.03), ("tip_force",))
    q, v, u = model.q0, np.zeros(model.nv), np.zeros(model.nu)
    z = np.concatenate((model.tendon_lengths(q)[:9], model.state(q, v).y))
    before = []
    for k in range(60):
        ekf.step(k * PERIOD, z, u)
        if k % 20 == 19:
            before.append(len(ekf._filter.P))
    assert before[1] == before[2]  # late readings that wait
    tracemalloc.start()
    try:
        for k in range(60, 300):
            estimate = ekf.step(k * PERIOD, z, u)
        held = tracemalloc.get_traced_memory()[0]
        for k in range(300, 340):
            tracemalloc.reset_peak()
            estimate = ekf.step(k * PERIOD, z, u)
            assert tracemalloc.get_traced_memory()[1] < held + 4 * estimate.covariance.nbytes
        assert tracemalloc.get_traced_memory()[0] < held + 500
    finally:
        tracemalloc.stop()


def test_refused_arguments(tmp_path):
    model = softdyn.load("finger")
    for bad in (
        lambda: Ekf(model),
        lambda: Ekf(model, sensors(model), ("wind",)),
        lambda: Ekf(model, sensors(model), ("payload", "payload")),
        lambda: Ekf(model, [1, 2]),
        lambda: Ekf(model, sensors(model), start=(np.zeros(3), np.zeros(4))),
        lambda: Ekf(softdyn.load(write(tmp_path, WALKER), floating=True), sensors(model)),
        lambda: Ekf(model, sensors(model)).step(0.0, np.zeros(4), np.zeros(2)),
        lambda: Ekf(model, sensors(model)).step(0.0, np.zeros(5), "none"),
        lambda: EkfParameters(memory=0.0),
        lambda: Ekf(model, sensors(model)).step(0.0, np.zeros(5), np.zeros(2)).interval("wind"),
    ):
        with pytest.raises(InputError):
            bad()


def test_every_kind_of_sensor_is_late():
    """A pose, a gyro and a joint: with readings of the truth, late and in time, the error falls."""
    model = softdyn.load("finger")
    robot = model.robot
    given = [
        Sensor("pose", KIND.POSE, link=robot.task, noise=(1e-3,), rate=100.0, latency=0.02),
        Sensor("gyro", KIND.GYRO, link=robot.task, noise=(0.01,), latency=0.005),
        Sensor("joint", KIND.JOINT, joint=model.joint_names[0], noise=(1e-3,), latency=0.0125),
    ]
    model = softdyn.build(replace(robot, sensors=tuple(given)))
    ekf, u, held = Ekf(model), np.array([0.3, 0.2]), np.zeros(4, int)
    q, v = np.full(4, 0.15), np.zeros(4)
    step, past, nis, used = ImplicitStep(model), [], 0.0, 0
    for k in range(1600):  # the plant in steps of 0.5 ms
        if k:
            found = step(q, v, u, np.zeros(0), 0.0005, held)
            q, v, held = found.q, found.v, found.held
        past.append(model.measure(model.state(q, v), u).values)
        if k % 10 == 0:
            t = k * 0.0005
            ages = np.array([t - max(np.floor((t - 0.02) * 100 + 1e-6), 0) / 100, 0.005, 0.0125])
            rows = [past[max(k - round(age / 0.0005), 0)] for age in ages]
            z = np.concatenate((rows[0][:6], rows[1][6:9], rows[2][9:]))
            estimate = ekf.step(t, z, u)
            nis, used = nis + estimate.nis * (k > 400), used + estimate.used * (k > 400)
    # a reading taken at a wrong time would be off by many deviations
    assert nis < 1.2 * used
    assert np.abs(estimate.q - q).max() < 0.01
    assert ekf.counts.restarts == 0
    # own times before the first step: two of the pose, one of the gyro, three of the joint. The
    # gyro's own time at the first step is not expected: the length of the next one is not known
    assert ekf.counts.unmatched == 2 * 6 + 2 * 3 + 3


def test_joseph_keeps_a_covariance():
    """After many exact readings the covariance stays symmetric and positive."""
    rng = np.random.default_rng(1)
    A = rng.normal(size=(8, 8))
    P = block_diag(A @ A.T, np.eye(2))
    exact, rows = P.copy(), rng.normal(size=(300, 10))
    change = np.zeros(10)
    nis, used, *_ = update(P, rows, np.full(300, np.nan), np.full(300, 1e-8), change, np.inf)
    assert used == 0
    assert nis == 0
    assert np.array_equal(P, exact)
    assert not change.any()
    update(P, rows, np.zeros(300), np.full(300, 1e-8), change, np.inf)
    information = np.linalg.inv(exact) + 1e8 * rows.T @ rows
    assert np.allclose(P, np.linalg.inv(information), rtol=1e-4, atol=1e-14)
    assert symmetrised(P) == pytest.approx(np.trace(P))
    assert np.array_equal(P, P.T)
    assert np.linalg.eigvalsh(P)[0] > 0


def test_a_clock_that_drifts_by_rounding():
    """Sums of periods are off by nanoseconds after an hour; readings keep their own times."""
    model = softdyn.load("finger")
    ekf = Ekf(model, sensors(model, rate=60.0, latency=0.03))
    z = np.concatenate((model.tendon_lengths(model.q0)[:2], model.state(model.q0, [0] * 4).y))
    for k in range(120):
        ekf.step(3600.0 + k * PERIOD + 5e-8 * (k % 3), z, np.zeros(2))
    assert ekf.counts.unmatched <= 6  # two pictures from before the first step
    assert ekf.counts.used > 320
    assert ekf.counts.restarts == 0
