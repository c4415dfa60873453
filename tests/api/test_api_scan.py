"""The ports as they are looked at over HTTP."""

from __future__ import annotations

import threading
from concurrent.futures import ThreadPoolExecutor

from serial.tools import list_ports
from serial.tools.list_ports_common import ListPortInfo
from simulated_devices import plug
from support import PATIENCE_S, wait_for

from calrig.api import runs
from calrig.runs.single_flight import SingleFlight


def test_a_look_at_the_ports_tells_who_answers_and_what_to_configure(shared_client, monkeypatch):
    plug(monkeypatch, ttyUSB0="grbl", ttyUSB1="calrig")
    answer = shared_client.post("/api/rigs/scan").raise_for_status().json()
    on = {one["port"]: one for one in answer["found"]}
    assert (on["ttyUSB0"]["kind"], on["ttyUSB0"]["driver"]) == ("stage", "grbl")
    assert "AS-0042" in on["ttyUSB1"]["identity"]
    assert 'driver = "calrig", port = "ttyUSB1"' in answer["stanza"]
    assert 'name = "bench-2"' in answer["stanza"]  # the service's own rig is bench-1


def test_without_a_port_there_is_nothing(shared_client, monkeypatch):
    monkeypatch.setattr(list_ports, "comports", list)
    assert shared_client.post("/api/rigs/scan").json() == {"found": [], "stanza": ""}


def test_the_ports_of_the_services_own_rigs_stay_free_for_a_stop(shared_client, rig, monkeypatch):
    ports = [rig.stage.port, rig.imu.port]
    monkeypatch.setattr(list_ports, "comports", lambda: [ListPortInfo(port) for port in ports])
    answer = shared_client.post("/api/rigs/scan").raise_for_status().json()
    assert [(one["port"], one["kind"]) for one in answer["found"]] == [(p, "busy") for p in sorted(ports)]
    assert all("a rig of this service" in one["identity"] for one in answer["found"])


def test_who_asks_while_the_ports_are_looked_at_shares_that_look_and_takes_no_thread(
    shared_client, monkeypatch
):
    looks, go_on = [], threading.Event()

    def look(*, ours):
        looks.append(ours)
        assert go_on.wait(PATIENCE_S)
        return []

    shared: list = []
    share = SingleFlight.share
    monkeypatch.setattr(SingleFlight, "share", lambda *of: (share(*of), shared.append(of))[0])
    monkeypatch.setattr(runs.ports, "scan", look)
    crowd = 60  # more than there are threads for requests
    with ThreadPoolExecutor(crowd) as beside:
        asked = [beside.submit(shared_client.post, "/api/rigs/scan") for _ in range(crowd)]
        wait_for(lambda: len(shared) == crowd, "all of them")
        assert shared_client.get("/api/rigs").status_code == 200
        go_on.set()
        assert {answer.result().status_code for answer in asked} == {200}
    assert len(looks) == 1
