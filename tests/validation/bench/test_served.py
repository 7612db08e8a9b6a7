from __future__ import annotations

import json
import socket
import threading
from dataclasses import replace

import numpy as np
import pytest

import softdyn
from softdyn.description.rig import CommandKind
from softdyn.examples.served_rig import ServedRig as Client
from softdyn.validation.bench.served import Faults, ServedRig
from tests.support import PATIENCE
from tests.support.bench import bench_arm, tower
from tests.support.refused import refused

NAN = np.nan


BAD = (
    "{", "[]", '{"send": [1]}', '{"send": [1, null]}', '{"fault": "lie"}',
    '{"fault": "lose", "sensors": 3}', '{"fault": "delay", "seconds": 99}',
    '{"fault": "cut", "motors": ["uc"]}', '{"fault": "jam"}',
    '{"send": [1e308, -1e308]}', '{"send": [60.1, 0]}', '{"send": [0, -60.1]}',
)  # fmt: skip


@pytest.fixture(scope="module")
def model():
    return bench_arm()


@pytest.fixture
def faults(model):
    return Faults(model)


def passed(faults, values, now):
    values = np.array([*values, NAN, NAN, NAN], float)
    sent, stamps = faults.pass_on(values, np.where(np.isnan(values), NAN, now), now)
    return sent[:3].tolist(), stamps[:3].tolist()


def test_faults_of_readings(faults):
    assert passed(faults, (1, 2, 3), 0.0) == ([1, 2, 3], [0, 0, 0])
    faults.add("freeze", ["shoulder"], NAN)
    faults.add("repeat", ["elbow"], NAN)
    sent, stamps = passed(faults, (4, 5, 6), 1.0)
    assert sent == [1, 2, 6]
    assert stamps == [1, 0, 1]
    faults.add("lose", ["load"], NAN)
    assert np.isnan(passed(faults, (7, 8, 9), 2.0)[0][2])
    faults.clear()
    assert passed(faults, (4, 5, 6), 3.0) == ([4, 5, 6], [3, 3, 3])
    faults.add("delay", ["shoulder"], 0.5)
    assert np.isnan(passed(faults, (7, 5, 6), 4.0)[0][0])
    assert np.isnan(passed(faults, (8, 5, 6), 4.4)[0][0])
    sent, stamps = passed(faults, (9, 5, 6), 4.6)
    assert (sent[0], stamps[0]) == (7, 4.0)
    with refused("sensors", "'elbo'; did you mean 'elbow'?"):
        faults.add("lose", ["elbo"], NAN)


def test_stamps_are_the_times_of_measurement(model):
    made = tower(model)
    begin, seen = made.hands.time, []
    for _ in range(100):
        made.hands.pass_(0.003)
        values, stamps = made.rig.advance()
        assert abs(stamps[0] - made.hands.time) < 1e-3
        if not np.isnan(values[3]):
            seen.append(stamps[3] - begin)
            assert 0.02 - 1e-9 <= made.hands.time - stamps[3] <= 0.0201 + 0.003
    assert np.allclose(np.diff(seen), 0.02)


def test_bad_messages_change_nothing(model):
    made = tower(model)
    for line in BAD:
        answer = made.rig.obey(line)
        assert answer is not None
        assert "error" in answer, line
    assert made.rig.state()["sent_at"] is None


def test_commands_act_on_when_their_sender_goes_away(model):
    rig = ServedRig(model)
    thread = threading.Thread(target=rig.serve)
    thread.start()
    try:
        assert rig._listening.getsockname()[0] == "127.0.0.1"
        client = Client(model)
        client.stop()  # before start()
        client_of(client, rig.port)
        client.send(np.array([3.0, 1.0]))
        until(client, lambda line: "values" in line)
        client.link.close()
        client_of(client, rig.port)
        assert ask(client)["relaxed_at"] is None
        client.stop()
        client.stop()
        client_of(client, rig.port)
        assert ask(client)["relaxed_at"] is not None
        client.say({"fault": "die"})
        thread.join(timeout=PATIENCE)
        assert not thread.is_alive()
    finally:
        rig.over = True
        thread.join()


@pytest.mark.parametrize("kind", [CommandKind.LENGTH, CommandKind.VELOCITY])
def test_what_no_motor_takes_is_refused_by_the_motor_s_name(model, kind):
    winch = {"command": kind, "stiffness": 900.0, "gear": -1.0, "lower": 0.0}
    motors = tuple(replace(motor, **winch) for motor in model.robot.actuators)
    made = tower(softdyn.build(replace(model.robot, actuators=motors)))
    answer = made.rig.obey('{"send": [0, -1e308]}')
    assert "'ub'" in answer["error"]
    assert "-1e+308" in answer["error"]
    assert made.rig.obey('{"send": [0.01, 0]}') is None
    made.hands.pass_(0.1)
    made.rig.advance()
    assert np.isfinite(made.rig.state()["tip"]).all()


def test_a_second_driver_is_refused_and_does_not_stop_the_first_one(model):
    rig = ServedRig(model)
    thread = threading.Thread(target=rig.serve)
    thread.start()
    try:
        first, second, witness = Client(model), Client(model), Client(model)
        for one in (first, second, witness):
            client_of(one, rig.port)
        first.send(np.array([3.0, 1.0]))
        assert ask(first)["sent_at"] is not None
        second.send(np.array([-5.0, 0.0]))
        port = first.link.getsockname()[1]
        answer = until(second, lambda line: "error" in line)["error"]
        assert str(port) in answer
        second.send(np.array([-5.0, 0.0]))
        with pytest.raises(RuntimeError, match="one program that drives this rig"):
            all(second.read() for _ in iter(int, 1))  # until it hears of it
        second.stop()
        assert ask(witness)["relaxed_at"] is None
        witness.stop()  # anyone else may stop it
        assert ask(first)["relaxed_at"] is not None
        first.stop()
        third = Client(model)
        client_of(third, rig.port)
        third.send(np.array([1.0, 0.0]))
        assert ask(third)["relaxed_at"] is None
    finally:
        rig.over = True
        thread.join()


def client_of(client, port):
    """Start a client of the example on a port of its own."""
    client.link = socket.create_connection(("127.0.0.1", port), timeout=PATIENCE)
    client.rest = b""


def until(client, wanted):
    """The first message that is wanted."""
    while True:
        for line in client.lines():
            if wanted(line):
                return line


def ask(client):
    client.say({"ask": "state"})
    return until(client, lambda line: "state" in line)["state"]


def test_a_motor_that_jams_pulls_on_and_none_mends_it(model):
    made = tower(model)

    def force(message):
        assert made.rig.obey(json.dumps(message)) is None
        for _ in range(40):
            made.hands.pass_(0.002)
            made.rig.advance()
        return made.rig.state()["forces"][0]

    assert force({"send": [3.0, 1.0]}) == pytest.approx(3.0)
    assert force({"fault": "jam", "motors": ["ua"]}) == pytest.approx(3.0)
    assert force({"stop": True}) == pytest.approx(3.0)
    assert force({"fault": "none"}) == pytest.approx(0.0)
    assert force({"send": [3.0, 1.0]}) == pytest.approx(3.0)
    assert force({"fault": "cut", "motors": ["ua"]}) == pytest.approx(0.0)
    assert force({"fault": "none"}) == pytest.approx(3.0)


def test_the_message_in_the_docstring_are_obeyed(model):
    made = tower(model)
    for line in ('{"fault": "lose", "sensors": ["camera"]}', '{"stop": true}'):
        assert made.rig.obey(line) is None
    assert json.dumps(made.rig.obey('{"ask": "state"}'))
