"""The zeros that were found before a rig's zeroing stopped, in a file from which it goes on.

The file is written after each cable, by a thread, because a disk may take longer than the watchdog
waits. So it is there too if the process is killed.
"""

from __future__ import annotations

import threading
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path

from softdyn import FormatError, InputError, SoftModel
from softdyn.checks import number
from softdyn.formats import KEY, ZEROS, check_format
from softdyn.validation.files import read_json, write_json

EXPECTED = "zeros that softdyn drive --zero has kept"


@dataclass(frozen=True)
class CableZero:
    """The zero of one cable.

    Attributes
    ----------
    actuator : str
        Its winch.
    offset : float
        The offset (m): the mean of both directions.
    spread : float
        Largest difference (m) of an offset from another of the same direction.
    hysteresis : float
        Mean offset (m) while the cable is paid out, less that while it is wound up.
    biases : dict of str to float
        Bias (m) of each encoder of the cable.
    """

    actuator: str
    offset: float
    spread: float
    hysteresis: float
    biases: dict[str, float]


class KeptZeros:
    """The file of the zeros of one robot.

    Parameters
    ----------
    path : str or Path
        The file.
    model : SoftModel
        The robot; zeros of another one are refused by its digest.
    """

    def __init__(self, path: str | Path, model: SoftModel) -> None:
        self.path, self._model = Path(path), model
        self._writer: threading.Thread | None = None

    def read(self) -> list[CableZero]:
        """The zeros in the file.

        Raises
        ------
        InputError
            The file cannot be read, or its zeros are those of another robot.
        FormatError
            It is another file, or one of another version.
        """
        where, found = str(self.path), read_json(self.path, EXPECTED)
        check_format(found.get(KEY), ZEROS, where, "zeros")
        if found.get("digest") != self._model.robot.digest:
            raise InputError(where, f"zeros of {self._model.name!r} as its file is now", "others")
        names = [motor.name for motor in self._model.robot.actuators]
        try:
            zeros = [CableZero(**entry) for entry in found["zeros"]]
            for zero in zeros:
                names.remove(zero.actuator)
                lengths = zero.offset, zero.spread, zero.hysteresis, *zero.biases.values()
                for length in lengths:
                    number(zero.actuator, length)
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            raise FormatError(where, EXPECTED, error) from None
        return zeros

    def write(self, zeros: Sequence[CableZero]) -> None:
        """Write these zeros while the caller goes on; one that cannot be written is left out."""
        self.wait()
        content = {
            KEY: ZEROS, "robot": self._model.name, "digest": self._model.robot.digest,
            "zeros": [asdict(zero) for zero in zeros],
        }  # fmt: skip

        def work() -> None:
            with suppress(InputError):
                write_json(self.path, content)

        self._writer = threading.Thread(target=work)
        self._writer.start()

    def wait(self) -> bool:
        """Wait until the last zeros are written; whether there is a file."""
        if self._writer is not None:
            self._writer.join()
        return self.path.exists()

    def remove(self) -> None:
        """Remove the file, because all zeros stand in the robot's."""
        self.wait()
        self.path.unlink(missing_ok=True)
