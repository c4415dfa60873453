"""What was found on the ports, as it goes into `calrig.toml`."""

from __future__ import annotations

import tomllib

from calrig.instruments.scan import Found, stanza
from calrig.settings import Settings


def found(kind, driver, port="/dev/ttyUSB0", serial=None, axis=None, baudrate=None):
    return Found(port, kind, driver, "", axis, baudrate, None, serial, "")


def test_one_stage_and_one_board_are_a_rig_that_can_be_pasted():
    stage = found("stage", "smc100", serial="FT1", axis=3)
    board = found("board", "tockn", "COM4", baudrate=19200)
    text = stanza([stage, board], taken={"bench-1"})
    (rig,) = Settings.model_validate(tomllib.loads(text)).rig
    assert (rig.name, rig.stage.driver, rig.stage.port, rig.stage.axis) == ("bench-2", "smc100", "usb:FT1", 3)
    assert (rig.imu.driver, rig.imu.port, rig.imu.baudrate) == ("tockn", "COM4", 19200)


def test_two_stages_have_a_rig_each_and_their_boards_to_choose_from():
    stages = [found("stage", "grbl", "/dev/ttyUSB0"), found("stage", "esp301", "/dev/ttyUSB1")]
    board = found("board", "calrig", "/dev/ttyACM0", baudrate=115200)
    text = stanza([*stages, board])
    document = tomllib.loads(text)
    assert [rig["name"] for rig in document["rig"]] == ["bench-1", "bench-2"]
    chosen = text.replace("# imu", "imu")
    assert {rig.imu.port for rig in Settings.model_validate(tomllib.loads(chosen)).rig} == {"/dev/ttyACM0"}


def test_adapters_that_share_a_serial_number_are_bound_by_their_ports():
    stage = found("stage", "smc100", "/dev/ttyUSB0", serial="0001")
    board = found("board", "calrig", "/dev/ttyUSB1", serial="0001")
    (rig,) = tomllib.loads(stanza([stage, board]))["rig"]
    assert (rig["stage"]["port"], rig["imu"]["port"]) == ("/dev/ttyUSB0", "/dev/ttyUSB1")


def test_a_board_alone_makes_no_rig():
    assert stanza([found("board", "calrig")]) == ""
