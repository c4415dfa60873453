from __future__ import annotations

import pytest
from instrument_fakes import CLOCK, FakeBoard, FakeSmc100, Wire, end_senders

from calrig.instruments.boards.calrig.driver import CalrigBoard
from calrig.instruments.stages.smc100.driver import Smc100


@pytest.fixture(scope="session", autouse=True)
def _time_stands():
    """Until a test waits for something: so it acts at the very instant that it waited for."""
    with CLOCK.taking_part():
        yield
    CLOCK.stop()


@pytest.fixture(autouse=True)
def _senders_end_with_their_test():
    yield
    end_senders()


@pytest.fixture
def wire():
    end = Wire()
    yield end
    end.vanish()


@pytest.fixture
def controller():
    device = FakeSmc100()
    yield device
    device.vanish()


@pytest.fixture
def stage(controller):
    driver = Smc100.open(controller.path)
    yield driver
    driver.close()


@pytest.fixture
def device():
    fake = FakeBoard()
    yield fake
    fake.vanish()


@pytest.fixture
def board(device):
    driver = CalrigBoard.open(device.path)
    yield driver
    driver.close()


@pytest.fixture
def streaming(device, board):
    board.identify()
    board.start(200)
    return board
