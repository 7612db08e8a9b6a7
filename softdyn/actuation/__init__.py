"""Motors between a controller's inputs and the robot.

    from softdyn.actuation import Winches

    winches = Winches(model)
    lengths = winches.commands(state, u)     # free lengths of cable that give the input u
    winches.tensions(state, lengths)         # and back

- `capstan`: friction of cables on their guides;
- `winches`: the input of a motor that commands a cable's free length, its derivatives, its inverse.
"""

from softdyn.actuation.capstan import Capstan
from softdyn.actuation.winches import Winches
from softdyn.description.rig import CommandKind

__all__ = ["Capstan", "CommandKind", "Winches"]
