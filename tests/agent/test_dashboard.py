"""The dashboard for Grafana: its own models read it whole, and it asks for nothing that nobody says."""

from __future__ import annotations

import json
from contextlib import closing
from pathlib import Path
from typing import Any

import httpx
import pytest
from a_bench import HandWritten, agent_at, rigs_of
from prometheus_client.parser import text_string_to_metric_families as prometheus_text
from repository import DOCS
from support import QUICK, ended, serving, wait_for

from calrig.centre.service import CentreService
from calrig.store import Store

FILE = DOCS / "grafana-centre.json"
OF_THE_SCRAPER = {"instance", "job"}
"""Labels that Prometheus adds to whatever it scrapes."""
GRID = 24
"""Columns of a dashboard."""


@pytest.fixture(scope="module")
def dashboard() -> dict[str, Any]:
    return json.loads(FILE.read_text(encoding="utf-8"))


def selectors(expression: Any) -> list[Any]:
    """The series that an expression asks for."""
    import promql_parser

    found: list[Any] = []

    def note(node: Any) -> None:
        if isinstance(node, promql_parser.VectorSelector):
            found.append(node)

    promql_parser.walk(expression, note, lambda _: None)
    return found


def metrics(client: httpx.Client) -> dict[str, set[str]]:
    """What is said, and by which labels."""
    said: dict[str, set[str]] = {}
    for family in prometheus_text(client.get("/api/metrics").raise_for_status().text):
        for sample in family.samples:
            said.setdefault(sample.name, set()).update(sample.labels)
    return said


def test_grafanas_own_models_read_all_of_it(dashboard: dict[str, Any]) -> None:
    models = pytest.importorskip("grafana_foundation_sdk.models.dashboard", reason="Grafana's SDK is missing")
    from grafana_foundation_sdk.cog.encoder import JSONEncoder
    from grafana_foundation_sdk.cog.plugins import register_default_plugins

    register_default_plugins()
    read = json.loads(json.dumps(models.Dashboard.from_json(dashboard), cls=JSONEncoder))
    assert lost(dashboard, read) == []


def lost(of: Any, in_: Any, place: str = "") -> list[str]:
    """Where the second document has not what the first one has."""
    if isinstance(of, dict) and isinstance(in_, dict):
        return [one for key in of for one in lost(of[key], in_.get(key), f"{place}.{key}")]
    if isinstance(of, list) and isinstance(in_, list) and len(of) == len(in_):
        return [
            one for k, (a, b) in enumerate(zip(of, in_, strict=True)) for one in lost(a, b, f"{place}[{k}]")
        ]
    return [] if of == in_ else [place]


def test_panels_have_numbers_of_their_own_and_none_lies_on_another(dashboard: dict[str, Any]) -> None:
    panels = dashboard["panels"]
    assert len({panel["id"] for panel in panels}) == len(panels)
    taken: set[tuple[int, int]] = set()
    for at in (panel["gridPos"] for panel in panels):
        cells = {(at["x"] + i, at["y"] + j) for i in range(at["w"]) for j in range(at["h"])}
        assert not cells & taken
        assert at["x"] + at["w"] <= GRID
        taken |= cells


def test_every_panel_asks_for_what_a_centre_or_a_bench_says(
    dashboard: dict[str, Any], centre: HandWritten, spool: Path
) -> None:
    promql = pytest.importorskip("promql_parser", reason="no parser of PromQL")
    with (
        rigs_of("bench-1", board={"fault": "corrupt"}) as (rig,),
        Store.open(centre.url, writer="tests") as store,
        closing(CentreService(store, centre.url)) as service,
        serving(service) as of_centre,
        agent_at(centre.bench_url, spool, rig) as agent,
        serving(agent.service, is_bench=True) as of_bench,
    ):
        wait_for(lambda: [r for r in of_centre.get("/api/rigs").json() if r["state"] != "offline"], "bench")
        run = of_centre.post("/api/runs", json={"unit": "AS-1", "plan": QUICK}).raise_for_status().json()
        assert ended(of_centre, run["id"])["faults"]["crc"] > 0
        said = metrics(of_bench)
        for name, labels in metrics(of_centre).items():
            said.setdefault(name, set()).update(labels)
    asked = [target["expr"] for panel in dashboard["panels"] for target in panel.get("targets", [])]
    assert len(asked) >= 20
    for expression in asked:
        series = selectors(promql.parse(expression))
        assert series, expression
        for one in series:
            assert one.name in said, expression
            assert {matcher.name for matcher in one.matchers.matchers} <= said[one.name], expression
    for panel in dashboard["panels"]:
        for target in panel.get("targets", []):
            names = {one.name for one in selectors(promql.parse(target["expr"]))}
            known = set.union(*(said[name] for name in names)) | OF_THE_SCRAPER
            assert {part.split("}}")[0] for part in target["legendFormat"].split("{{")[1:]} <= known
