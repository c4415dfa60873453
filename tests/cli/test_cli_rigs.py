"""`calrig rigs`: what is configured, and with --scan a stanza to paste into the configuration."""

from __future__ import annotations

import tomllib
from dataclasses import replace

from command_line import calrig
from serial.tools import list_ports

from calrig.instruments import scan
from calrig.simulator.config import SimulatorSettings
from calrig.simulator.rig import SimulatedRig

CONFIG = """
[[rig]]
name = "bench-1"
stage = {{ driver = "smc100", port = "{stage}" }}
imu = {{ driver = "calrig", port = "{imu}" }}

[[rig]]
name = "demo"
simulated = {{ preset = "demo" }}
"""


def test_what_is_configured_is_listed_with_its_ports(folder):
    shown = calrig("rigs").stdout
    assert "bench-1" in shown
    assert "smc100 on /dev/ttyABSENT0" in shown
    (folder / "calrig.toml").unlink()
    assert "simulated" in calrig("rigs").stdout


def test_what_answers_on_the_configured_ports_is_shown_with_a_rig_to_paste(tmp_path, monkeypatch):
    monkeypatch.setattr(list_ports, "comports", list)
    monkeypatch.setattr(scan, "LOOKS", [replace(look, listen_s=look.listen_s / 5) for look in scan.LOOKS])
    monkeypatch.setenv("COLUMNS", "200")
    options = {"preset": "ideal", "stage": {"driver": "zaber"}, "board": {"serial": "AS-7"}}
    with SimulatedRig(SimulatorSettings.from_options(options)) as rig:
        config = tmp_path / "calrig.toml"
        config.write_text(CONFIG.format(stage=rig.stage_port, imu=rig.imu_port))
        done = calrig("rigs", "--scan", "--config", config)
    assert "unit AS-7" in done.stdout
    (found,) = tomllib.loads(done.stdout[done.stdout.index("[[rig]]") :])["rig"]
    assert found["name"] == "bench-2"
    assert (found["stage"]["driver"], found["stage"]["port"]) == ("zaber", rig.stage_port)
    assert (found["imu"]["driver"], found["imu"]["port"]) == ("calrig", rig.imu_port)
