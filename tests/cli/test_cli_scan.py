"""`calrig rigs --scan`, as a person uses it who wants to write a configuration."""

from __future__ import annotations

import tomllib

from serial.tools import list_ports
from simulated_devices import plug
from typer.testing import CliRunner

from calrig.cli.main import app

CONFIG = """
[[rig]]
name = "bench-1"
stage = { driver = "smc100", port = "ttyUSB0" }
imu = { driver = "calrig", port = "ttyUSB1" }

[[rig]]
name = "demo"
simulated = { preset = "demo" }
"""


def test_what_answers_on_the_configured_ports_is_shown_with_a_rig_to_paste(tmp_path, monkeypatch):
    plug(monkeypatch, ttyUSB0="zaber", ttyUSB1="calrig")
    monkeypatch.setattr(list_ports, "comports", list)  # what is configured is looked at, listed or not
    monkeypatch.setenv("COLUMNS", "200")
    config = tmp_path / "calrig.toml"
    config.write_text(CONFIG)
    done = CliRunner().invoke(app, ["rigs", "--scan", "--config", str(config)], catch_exceptions=False)
    assert "unit AS-0042" in done.stdout
    (found,) = tomllib.loads(done.stdout[done.stdout.index("[[rig]]") :])["rig"]
    assert found["name"] == "bench-2"
    assert (found["stage"]["driver"], found["stage"]["port"]) == ("zaber", "ttyUSB0")
    assert (found["imu"]["driver"], found["imu"]["port"]) == ("calrig", "ttyUSB1")
