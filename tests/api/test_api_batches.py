"""Lists of units over HTTP: one after the other, retried, side by side, and what does not go twice."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import pytest
from support import LONG, QUICK, ended, running_service, serving, wait_for

LIMITS = [
    {"name": "strict", "units": "BAD-*", "rms_deg": 1e-6},
    {"name": "loose", "units": "OK-*", "rms_deg": 5},
]


def made(client, units, **more):
    body = {"units": units, "plan": {**QUICK, "sweeps": 1}, **more}
    return client.post("/api/batches", json=body).raise_for_status().json()


def looked(client, batch):
    return client.get(f"/api/batches/{batch['id']}").raise_for_status().json()


def begun(client, batch, unit, rig="bench-1"):
    return client.post(f"/api/batches/{batch['id']}/start", json={"rig": rig, "unit": unit})


def finished(client, batch, unit, rig="bench-1"):
    """The list once the unit that was begun has been measured."""
    now = begun(client, batch, unit, rig).raise_for_status().json()
    (place,) = [one for one in now["rigs"] if one["name"] == rig]
    ended(client, place["on"]["run_id"])
    wait_for(lambda: client.get("/api/rigs").json()[0]["state"] == "idle", "free rig")
    return looked(client, batch)


def seen(client, batch, state):
    """What is said of the unit on the first rig once a look has found it so."""

    def look():
        sight = client.post(f"/api/batches/{batch['id']}/look").raise_for_status().json()["rigs"][0]["seen"]
        return sight if sight and sight["state"] == state else None

    return wait_for(look, f"unit that is {state}")


def states(batch):
    return [(turn["unit"], turn["word"] or turn["state"]) for turn in batch["units"]]


def test_units_go_one_after_the_other_and_one_that_fails_once_more_at_the_end(shared_client):
    shared_client.put("/api/limits", json=LIMITS).raise_for_status()
    batch = made(shared_client, ["OK-1", " BAD-2 ", "OK-1", "", "PLAIN-3"], operator="ada", note="tray 7")
    assert states(batch) == [("OK-1", "waiting"), ("BAD-2", "waiting"), ("PLAIN-3", "waiting")]
    (rig,) = batch["rigs"]
    assert (rig["on"]["unit"], rig["next"]["unit"], rig["last"]) == ("OK-1", "BAD-2", None)
    assert finished(shared_client, batch, "OK-1")["rigs"][0]["last"]["word"] == "pass"
    now = finished(shared_client, batch, "BAD-2")
    assert states(now)[1:] == [("BAD-2", "fail"), ("PLAIN-3", "waiting"), ("BAD-2", "waiting")]
    assert now["rigs"][0]["last_says"] and now["rigs"][0]["on"]["unit"] == "PLAIN-3"
    assert "strict" in now["units"][1]["why"] and "at most 0.0000010°" in now["units"][1]["why"]
    run = shared_client.get(f"/api/runs/{now['units'][0]['run_id']}").json()
    assert (run["operator"], run["note"], run["unit"]) == ("ada", "tray 7", "OK-1")
    assert begun(shared_client, batch, "OK-1").status_code == 409
    shared_client.put("/api/limits", json=[]).raise_for_status()


def test_of_two_who_press_enter_at_once_one_begins_the_run(shared_client):
    batch = made(shared_client, ["E-1", "E-2"], plan=LONG)
    assert looked(shared_client, batch)["rigs"][0]["seen"] is None, "nobody has asked for a look"
    assert "without serial number. Check that the unit is E-1" in seen(shared_client, batch, "there")["says"]
    with ThreadPoolExecutor(2) as both:
        answers = list(both.map(lambda _: begun(shared_client, batch, "E-1"), range(2)))
    assert sorted(answer.status_code for answer in answers) == [200, 409]
    assert len(shared_client.get("/api/runs?unit=E-1").json()["items"]) == 1
    now = looked(shared_client, batch)
    run_id = now["rigs"][0]["on"]["run_id"]
    assert now["rigs"][0]["seen"] is None, "the board is the run's"
    assert (now["rigs"][0]["status"], now["rigs"][0]["next"]["unit"]) in [
        ("running", "E-2"),
        ("queued", "E-2"),
    ]
    assert begun(shared_client, batch, "E-2").status_code == 409, "the rig is busy"
    shared_client.post(f"/api/runs/{run_id}/abort").raise_for_status()
    now = looked(shared_client, batch)
    assert (now["rigs"][0]["on"]["unit"], now["rigs"][0]["on"]["why"]) == ("E-1", "its run was aborted")
    known = shared_client.post(f"/api/batches/{batch['id']}/units", json={"units": ["E-2", "E-3"]}).json()
    assert known["known"] == ["E-2"] and len(known["units"]) == 3
    gone = shared_client.post(f"/api/batches/{batch['id']}/remove", json={"unit": "E-2"}).json()
    assert [turn["unit"] for turn in gone["units"]] == ["E-1", "E-3"]
    closed = shared_client.post(f"/api/batches/{batch['id']}/close").json()
    assert closed["closed_at"] and begun(shared_client, batch, "E-3").status_code == 409


def test_rigs_side_by_side_have_a_unit_each_and_a_service_that_begins_anew_knows_the_list(
    launch_rig, store_path
):
    with (
        running_service(store_path, launch_rig("left"), launch_rig("right")) as service,
        serving(service) as c,
    ):
        batch = made(c, [f"S-{k}" for k in range(5)], rigs=["left", "right"], plan=LONG)
        assert [rig["on"]["unit"] for rig in batch["rigs"]] == ["S-0", "S-1"]
        now = begun(c, batch, "S-1", "right").json()
        assert [(rig["on"]["unit"], rig["next"]["unit"]) for rig in now["rigs"]] == [
            ("S-0", "S-2"),
            ("S-1", "S-3"),
        ]
        scanned = [{"units": [f"S-{k}"]} for k in range(5, 12)]
        with ThreadPoolExecutor(8) as at_once:
            start = at_once.submit(begun, c, batch, "S-4", "left")
            adds = [at_once.submit(c.post, f"/api/batches/{batch['id']}/units", json=one) for one in scanned]
        assert {one.result().status_code for one in (start, *adds)} == {200}, "none is in the other's way"
        now = looked(c, batch)
        assert now["rigs"][0]["on"]["unit"] == "S-4", "who mounts another one says so"
        assert len(now["units"]) == 12
    with (
        running_service(store_path, launch_rig("left"), launch_rig("right")) as service,
        serving(service) as c,
    ):
        now = looked(c, batch)
        assert [rig["on"]["unit"] for rig in now["rigs"]] == ["S-4", "S-1"]
        assert all(rig["on"]["state"] == "waiting" and "stopped" in rig["on"]["why"] for rig in now["rigs"])


def test_a_board_of_another_unit_fails_before_anything_moves_and_the_unit_stays_next(launch_rig, store_path):
    rig = launch_rig("bench-1", board={"serial": "OTHER-9"})
    with running_service(store_path, rig) as service, serving(service) as c:
        batch = made(c, ["MINE-1", "MINE-2"])
        sight = seen(c, batch, "wrong")
        assert sight["serial"] == "OTHER-9" and "OTHER-9, not MINE-1" in sight["says"]
        assert c.get("/api/rigs").json()[0]["state"] == "idle" and not c.get("/api/runs").json()["items"]
        ended(c, begun(c, batch, "MINE-1").json()["rigs"][0]["on"]["run_id"])
        (place,) = looked(c, batch)["rigs"]
        assert (place["on"]["unit"], place["next"]["unit"]) == ("MINE-1", "MINE-2")
        assert "OTHER-9" in place["on"]["why"] and "nothing was moved" in place["on"]["why"]
        assert place["nothing_measured"] and place["last"] is None


@pytest.mark.parametrize(
    ("table", "serials", "left_out"),
    [
        ("\ufefflot;Serial\r\n7;A-1\r\n7;A-2\r\n", ["A-1", "A-2"], 0),
        ("sep=;\r\nunit;was\r\nA-1;red,\r\n", ["A-1"], 0),
        ("A-1,red\nA-2,blue\n", ["A-1", "A-2"], 0),
        ("lot,unit\n7\n7,\n\n7, A-1\n7,A-1\n", ["A-1", "A-1"], 2),
        ('unit,of\n"Ä ""1"", b","two\nlines"\n', ['Ä "1", b'], 0),
    ],
)
def test_serials_come_from_a_table(shared_client, table, serials, left_out):
    read = shared_client.post("/api/batches/read", json={"csv": table}).raise_for_status().json()
    assert read == {"units": serials, "left_out": left_out}


@pytest.mark.parametrize(
    ("body", "says"),
    [
        ({"units": ["  "]}, "no serial number"),
        ({"units": ["A", "B\u0007"]}, "serial 2, 'B\\x07'"),
        ({"units": [f"U{k}" for k in range(2001)]}, "at most 2000"),
        ({"units": ["A"], "plan": {"stop_deg": 100}}, "beyond"),
        (
            {"units": ["A"], "plan": {"until": {"expanded_uncertainty_deg": 0.3}}},
            "alone makes it 0.",
        ),
        ({"csv": "unit\n"}, "no serial number"),
        ({"csv": "sep=;\nunit\nA\nB\u0007\n"}, "line 4, 'B\\x07'"),
        ({"csv": "unit\n\ufffd-1\n"}, "UTF-8"),
    ],
)
def test_what_is_no_list_is_refused_with_the_reason(shared_client, body, says):
    refused = shared_client.post("/api/batches", json=body)
    assert refused.status_code == 422 and says in refused.json()["detail"]
