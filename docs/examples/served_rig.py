"""A driver of the rig that `softdyn drive ROBOT --serve` simulates; the pattern for your own.

softdyn drive ROBOT CONTROLLER --driver served_rig.py:ServedRig --target X Y Z
"""

import json
import math
import os
import select
import socket
from typing import Any

PORT = int(os.environ.get("SERVED_RIG", "7600"))


class ServedRig:
    """Lines of JSON over a local socket; see `softdyn.validation.bench.served`."""

    def __init__(self, model):
        self.size = sum(sensor.kind.size for sensor in model.robot.sensors)
        self.link: Any = None
        self.rest = b""

    def start(self):
        self.link = socket.create_connection(("127.0.0.1", PORT), timeout=1.0)
        self.link.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)

    def read(self):
        values, stamps = [math.nan] * self.size, [math.nan] * self.size
        for line in self.lines():
            if "error" in line:  # commands beyond their bounds, or another program drives the rig
                raise RuntimeError(line["error"])
            for k, value in enumerate(line.get("values", ())):
                if value is not None:
                    values[k], stamps[k] = value, line["stamps"][k]
        return values, stamps

    def send(self, commands):
        self.say({"send": list(commands)})

    def stop(self):
        if self.link is None:  # not started, or stopped before
            return
        link, self.link = self.link, None
        with link:
            link.sendall(b'{"stop": true}\n')
            link.shutdown(socket.SHUT_WR)
            while link.recv(1 << 16):  # until the rig has heard it and closes, too
                pass

    def say(self, message):
        """Send one message."""
        self.link.sendall(json.dumps(message).encode() + b"\n")

    def lines(self):
        """The messages that have come; this never waits."""
        while select.select([self.link], [], [], 0)[0]:
            data = self.link.recv(1 << 16)
            if not data:
                raise ConnectionError("the rig has closed the connection")
            self.rest += data
        *lines, self.rest = self.rest.split(b"\n")
        return [json.loads(line) for line in lines]
