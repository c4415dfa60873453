"""The ports as a person looks at them."""

from __future__ import annotations

import pytest
from simulated_devices import Counterpart, plug

pytestmark = pytest.mark.browser


def test_the_ports_are_looked_at_and_the_configuration_shown_as_text(page, go, expect, monkeypatch):
    plugged = plug(monkeypatch, ttyUSB0="grbl", ttyUSB1="calrig")
    plugged["ttyUSB1"] = Counterpart("calrig", serial="<b>AS-7</b>")
    go("#/")
    page.get_by_role("button", name="Scan serial ports").click()
    ports = page.get_by_test_id("ports")
    expect(ports.locator("tbody tr")).to_have_count(2)
    expect(ports).to_contain_text("calrig: unit <b>AS-7</b>")
    expect(page.get_by_test_id("stanza")).to_contain_text('port = "ttyUSB0"')
