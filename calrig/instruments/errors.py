"""What can go wrong on a wire, each said so that a person can act on it."""


class InstrumentError(Exception):
    """A device or its port failed. The message names device, port, what happened and what to do."""


class PortError(InstrumentError):
    """The port cannot be opened, or went away while it was in use."""


class PortBlocked(PortError):  # noqa: N818 (of a port that is there)
    """It took nothing in time, as a device without power does, or this machine had no time for it."""


class StageError(InstrumentError):
    """The stage refused, stalled, arrived elsewhere, did not arrive, or answered what cannot be read."""


class LimitError(StageError):
    """A target lies beyond the soft limits; nothing was sent."""


class Halted(StageError):  # noqa: N818 (a state the operator asked for, not a fault)
    """The stage was halted by a stop request; it takes no motion until it is opened again."""


class BoardError(InstrumentError):
    """The board never answered, refused a command, reset, or its sensor is silent, frozen or absent."""
