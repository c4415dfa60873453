"""The ports as a person looks at them."""

from __future__ import annotations

from dataclasses import replace

import pytest
from serial.tools import list_ports
from serial.tools.list_ports_common import ListPortInfo

from calrig.instruments import scan
from calrig.simulator.config import SimulatorSettings
from calrig.simulator.rig import SimulatedRig

pytestmark = pytest.mark.browser


def test_the_ports_are_looked_at_and_the_configuration_shown_as_text(page, go, expect, monkeypatch):
    options = {"preset": "ideal", "stage": {"driver": "grbl"}, "board": {"serial": "<b>AS-7</b>"}}
    monkeypatch.setattr(scan, "LOOKS", [replace(look, listen_s=look.listen_s / 5) for look in scan.LOOKS])
    with SimulatedRig(SimulatorSettings.from_options(options)) as rig:
        listed = [ListPortInfo(rig.stage_port), ListPortInfo(rig.imu_port)]
        monkeypatch.setattr(list_ports, "comports", lambda: listed)
        go("#/")
        page.get_by_role("button", name="Scan serial ports").click()
        ports = page.get_by_test_id("ports")
        expect(ports.locator("tbody tr")).to_have_count(2)
        expect(ports).to_contain_text("calrig: unit <b>AS-7</b>")
        expect(page.get_by_test_id("stanza")).to_contain_text(f'port = "{rig.stage_port}"')
