from __future__ import annotations

import pytest
from instrument_fakes import FakeBoard, FakeSmc100

from calrig.instruments.boards.calrig.driver import CalrigBoard
from calrig.instruments.stages.smc100 import driver as smc100
from calrig.instruments.stages.smc100 import wire as smc100_wire
from calrig.instruments.stages.smc100.driver import Smc100


@pytest.fixture(autouse=True)
def short_patience(monkeypatch):
    """What waits for an answer that never comes waits less, so that the tests take seconds."""
    monkeypatch.setattr(smc100_wire, "REPLY_TIMEOUT_S", 0.2)
    monkeypatch.setattr(smc100, "ENABLE_TIMEOUT_S", 0.2)


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
