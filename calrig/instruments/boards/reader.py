"""What every board's driver begins with: a thread that reads the port, and samples that wait to be taken."""

import logging
from abc import ABC, abstractmethod
from collections import Counter

from calrig.instruments.errors import BoardError, InstrumentError
from calrig.instruments.ports import Port
from calrig.instruments.types import Samples

log = logging.getLogger(__name__)


class ReadBoard(ABC):
    """One board on a port. What ends its thread is raised to the caller that waits for the board.

    `port` is open, and closed with the board; `driver` is the driver's name.
    """

    def __init__(self, port: Port, driver: str) -> None:
        self.faults: Counter[str] = Counter()
        self._port = port
        self._name = f"board {driver} on {port.name}"
        self._clock = port.clock
        self._news = self._clock.condition()
        self._closing = self._clock.event()
        self._failure: InstrumentError | None = None
        self._blocks: list[Samples] = []
        self._reading = self._clock.thread(self._read, f"reader of {self._name}")

    @abstractmethod
    def _listen(self) -> None:
        """Reads until the board is closed."""

    @abstractmethod
    def _check_health(self) -> None:
        """Raises BoardError where no sample came for too long."""

    def take(self, timeout_s: float) -> Samples:
        """The valid samples since the last call, waiting up to timeout_s for the first one.

        Raises:
            BoardError: for too long the board has been silent, frozen, unreadable or without a sensor; or
                it was reset and has taken a new zero.
            PortError: the port went away.
        """
        with self._news:
            self._news.wait_for(lambda: self._blocks or self._failure, timeout_s)
            blocks, self._blocks = self._blocks, []
            if not blocks:
                self._raise_failure()
                self._check_health()
            return Samples.join(blocks)

    def close(self) -> None:
        """Closes the port; never raises."""
        self._closing.set()
        self._reading.join()
        self._port.close()

    def _read(self) -> None:
        try:
            self._listen()
        except InstrumentError as error:
            self._fail(error)
        except Exception as error:
            log.exception("the reader of %s failed", self._name)
            kind = type(error).__name__
            self._fail(
                BoardError(f"{self._name}: reading it failed inside calrig ({kind}: {error}); see the log")
            )

    def _fail(self, error: InstrumentError) -> None:
        with self._news:
            self._failure = error
            self._news.notify_all()

    def _raise_failure(self) -> None:
        if self._failure is not None:
            raise self._failure
