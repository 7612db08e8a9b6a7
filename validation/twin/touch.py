"""The forces of solid obstacles on a robot, as a run records them."""

from __future__ import annotations

from typing import Any

import numpy as np

from softdyn.controllers.channels import LogChannel
from softdyn.safety import Surroundings
from softdyn.validation.twin.obstacles import Contacts, check_start
from softdyn.validation.twin.twin import Twin

CHANNEL = "contact_force"


class Touch:
    """The record of a twin's contacts with solid obstacles.

    Parameters
    ----------
    twin : Twin
        The twin.
    contacts : Contacts
        Its `touching`.
    around : Surroundings
        The obstacles.

    Attributes
    ----------
    channel : LogChannel
        ``contact_force``: the force of each solid obstacle on the robot (N), with columns such as
        ``floor.z`` in the world's axes.
    """

    def __init__(self, twin: Twin, contacts: Contacts, around: Surroundings) -> None:
        self._twin, self._contacts = twin, contacts
        self._names = around.obstacle_names
        columns = [(f"{name}.{axis}", "N") for name in around.solid_names for axis in "xyz"]
        self.channel = LogChannel.of(CHANNEL, columns)

    @classmethod
    def of(cls, engine: Any, around: Surroundings | None) -> Touch | None:
        """That of a plant's engine; None without solid obstacles."""
        if around is None or not isinstance(engine, Twin) or engine.touching is None:
            return None
        return cls(engine, engine.touching, around)

    def check_start(self) -> None:
        """Refuse a state inside a solid obstacle.

        Raises
        ------
        InputError
            A link is deeper than 1 mm in one.
        """
        check_start(self._contacts, self._twin.data, self._names)

    def sample(self, *, refresh: bool = False) -> dict[str, np.ndarray]:
        """The forces at the state at which the twin was last refreshed, by the channel's name."""
        if refresh:
            self._twin.refresh()
        return {CHANNEL: self._contacts.forces(self._twin.data).ravel()}
