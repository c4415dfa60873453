"""`calrig runs`: what `GET /api/runs` gives, from a service or from the store, as a table or as JSON."""

from __future__ import annotations

import json
from typing import get_args

import pytest
from command_line import calrig, reason
from support import imported, running_service, serving

from calrig.analysis.amendments import Records
from calrig.analysis.revisions import Issuer
from calrig.cli.runs import KindName, StatusName, VerdictName
from calrig.model.run import Status
from calrig.settings import store_url
from calrig.store import Store
from calrig.store.runs import RunKind
from calrig.store.verdicts import Judged

LIMIT = {"name": "flight", "units": "A*", "scale": [0.8, 0.9]}


def listed(*options):
    """The document that the command prints."""
    return json.loads(calrig("runs", *options, "--json").stdout)


@pytest.fixture
def three(folder):
    """Ids of runs of A, B and A in this order, in a store that nobody writes to."""
    return [calrig("import", "poses.csv", "--unit", unit).stdout.strip() for unit in "ABA"]


def ids(*options):
    return [run["id"] for run in listed(*options)["items"]]


def test_service_and_store_give_the_document_of_the_api(folder, rig):
    with running_service(folder / "calrig.db", rig) as service, serving(service) as client:
        service.store.answers_at(str(client.base_url))
        assert listed() == {"items": [], "next_cursor": None}
        client.put("/api/limits", json=[LIMIT]).raise_for_status()
        for unit in "ABA":
            imported(client, unit)
        by_api = client.get("/api/runs?unit=A&verdict=fail&limit=1").raise_for_status().json()
        there = listed("--unit", "A", "--verdict", "fail", "--limit", 1)
        assert "is neither a day nor a time" in reason("runs", "--from", "then", status=2)
    assert by_api["next_cursor"] is not None
    assert there == by_api == listed("--unit", "A", "--verdict", "fail", "--limit", 1)


def test_each_filter_narrows_the_list(three):
    first, second, third = three
    with Store.open(store_url(), writer="note") as store:
        Records(store, Issuer(store)).note(second, "wet clamp")
    assert ids() == [third, second, first]
    assert ids("--unit", "A") == [third, first]
    assert ids("--text", "WET") == ids("--begins", second[:8]) == [second]
    assert ids("--status", "failed") == ids("--rig", "nope") == ids("--follows", first) == []
    assert ids("--kind", "import", "--verdict", "no_limits") == [third, second, first]
    assert ids("--from", "2020-01-01", "--to", "2020-01-02") == []
    older = listed("--limit", 1)["next_cursor"]
    assert ids("--limit", 1, "--cursor", older) == [second]


def test_a_person_reads_a_table_and_how_to_go_on(three):
    said = calrig("runs", "--limit", 2).stdout
    assert all(words in said for words in ("created (UTC)", three[2][:8], "completed", "RMS error"))
    assert said.endswith(f"older runs: --cursor {three[1]}\n")
    assert calrig("runs", "--unit", "nope").stdout == "no run matches\n"


def test_what_is_no_filter_is_2(three):
    assert "at least 6 characters" in reason("runs", "--begins", "ab", status=2)
    assert "is neither a day nor a time" in reason("runs", "--to", "then", status=2)
    assert "nope" in calrig("runs", "--status", "nope", status=2).stderr


def test_the_choices_are_those_of_the_api():
    for choices, names in ((StatusName, Status), (KindName, RunKind), (VerdictName, Judged)):
        assert set(get_args(choices)) == set(get_args(names))
