"""A look at the ports over HTTP."""

from __future__ import annotations

from dataclasses import replace

import pytest
from serial.tools import list_ports
from serial.tools.list_ports_common import ListPortInfo

from calrig.instruments import scan
from calrig.simulator.config import SimulatorSettings
from calrig.simulator.rig import SimulatedRig


@pytest.fixture
def plugged(monkeypatch):
    """A stage and a board in the system's list of ports."""
    options = SimulatorSettings.from_options(
        {"preset": "ideal", "stage": {"driver": "grbl"}, "board": {"serial": "AS-7"}}
    )
    monkeypatch.setattr(scan, "LOOKS", [replace(look, listen_s=look.listen_s / 5) for look in scan.LOOKS])
    with SimulatedRig(options) as rig:
        listed = [ListPortInfo(rig.stage_port), ListPortInfo(rig.imu_port)]
        monkeypatch.setattr(list_ports, "comports", lambda: listed)
        yield rig


def test_a_look_at_the_ports_tells_who_answers_and_what_to_configure(client, plugged):
    answer = client.post("/api/rigs/scan").raise_for_status().json()
    on = {one["port"]: one for one in answer["found"]}
    assert (on[plugged.stage_port]["kind"], on[plugged.stage_port]["driver"]) == ("stage", "grbl")
    assert "AS-7" in on[plugged.imu_port]["identity"]
    assert f'driver = "calrig", port = "{plugged.imu_port}"' in answer["stanza"]
    assert 'name = "bench-2"' in answer["stanza"]  # the service's own rig is bench-1


def test_without_a_port_there_is_nothing(client, monkeypatch):
    monkeypatch.setattr(list_ports, "comports", list)
    assert client.post("/api/rigs/scan").json() == {"found": [], "stanza": ""}


def test_the_ports_of_the_services_own_rigs_stay_free_for_a_stop(client, rig, monkeypatch):
    ports = [rig.stage.port, rig.imu.port]
    monkeypatch.setattr(list_ports, "comports", lambda: [ListPortInfo(port) for port in ports])
    answer = client.post("/api/rigs/scan").raise_for_status().json()
    assert [(one["port"], one["kind"]) for one in answer["found"]] == [(p, "busy") for p in sorted(ports)]
    assert all("a rig of this service" in one["identity"] for one in answer["found"])
