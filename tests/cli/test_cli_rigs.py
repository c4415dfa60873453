"""`calrig rigs`: what is configured, and with --scan a stanza to paste into the configuration."""

from __future__ import annotations

import tomllib

from command_line import RIG, calrig, reason
from serial.tools import list_ports
from simulated_devices import plug

CONFIG = """
[[rig]]
name = "bench-1"
stage = { driver = "smc100", port = "ttyUSB0" }
imu = { driver = "calrig", port = "ttyUSB1" }

[[rig]]
name = "demo"
simulated = { preset = "demo" }
"""


def test_what_is_configured_is_listed_with_its_ports(folder):
    shown = calrig("rigs").stdout
    assert "bench-1" in shown
    assert "smc100 on /dev/ttyABSENT0" in shown
    (folder / "calrig.toml").write_text(RIG.replace("smc100", "smc10"))
    for command in (["rigs"], ["run", "--unit", "A"]):
        assert "rig 'bench-1': no stage driver is called 'smc10'" in reason(*command, status=2)
    (folder / "calrig.toml").unlink()
    assert "simulated" in calrig("rigs").stdout


def test_what_answers_on_the_configured_ports_is_shown_with_a_rig_to_paste(tmp_path, monkeypatch):
    plug(monkeypatch, ttyUSB0="zaber", ttyUSB1="calrig")
    monkeypatch.setattr(list_ports, "comports", list)  # what is configured is looked at, listed or not
    monkeypatch.setenv("COLUMNS", "200")
    config = tmp_path / "calrig.toml"
    config.write_text(CONFIG)
    done = calrig("rigs", "--scan", "--config", config)
    assert "unit AS-0042" in done.stdout
    (found,) = tomllib.loads(done.stdout[done.stdout.index("[[rig]]") :])["rig"]
    assert found["name"] == "bench-2"
    assert (found["stage"]["driver"], found["stage"]["port"]) == ("zaber", "ttyUSB0")
    assert (found["imu"]["driver"], found["imu"]["port"]) == ("calrig", "ttyUSB1")
