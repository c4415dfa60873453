"""One headline: the page shows what is in force, with effects, and the plain fit below it by name."""

from __future__ import annotations

import math
import re

import pytest
from support import running_service, serving
from told_units import IMU, LIMIT, accepted, agrees, measured, solved

from .page_help import figures_of, imported, row_of, unfold

pytestmark = pytest.mark.browser

NUMBER = r"−?\d+(?:\.\d+)?"


@pytest.fixture(scope="module")
def client(launch_rig, tmp_path_factory):
    """A service with a unit whose effects were accepted, its verification, and one that was solved for."""
    path = tmp_path_factory.mktemp("page-story") / "calrig.db"
    with running_service(path, launch_rig(imu=IMU)) as service, serving(service) as client:
        client.put("/api/limits", json=[LIMIT]).raise_for_status()
        accepted(client, "EFFECTS")
        measured(client, "EFFECTS", kind="verification")
        solved(client, "SOLVED")
        yield client


@pytest.fixture
def runs(client):
    """The verification of the unit, and its calibration."""
    items = client.get("/api/runs?unit=EFFECTS").json()["items"]
    assert [one["plan"]["kind"] for one in items] == ["verification", "calibration"]
    return items


def in_force(client, unit="EFFECTS"):
    return client.get(f"/api/units/{unit}/calibration").raise_for_status().json()


def shows(text, value, std=None):
    """Whether `value ± std` on the page are these, to the digits that it shows."""
    numbers = re.findall(NUMBER, text)
    assert agrees(numbers[0], value), (text, value)
    assert std is None or agrees(numbers[1], std), (text, std)


def test_card_run_lists_and_comparison_show_the_figures_in_force(page, client, go, expect, runs):
    document, run = in_force(client), runs[1]
    stds = [math.sqrt(document["covariance"][k][k]) for k in range(2)]
    assert abs(run["result"]["bias_deg"] - document["bias_deg"]) > 10 * stds[0]  # the plain fit is another

    def shows_it(figures):
        shows(figures["Bias"], document["bias_deg"], stds[0])
        shows(figures["Scale"], document["scale"], stds[1])

    go("#/units/EFFECTS")
    expect(page.locator("#sha256")).to_have_text(document["sha256"])
    card = figures_of(page, "#calibration")
    shows_it(card)
    shows(card["RMS error, with effects"], document["rms_with_effects_deg"])
    shows(card["RMS error, plain fit"], document["rms_calibrated_deg"])
    shows(card["Expanded uncertainty"], document["expanded_uncertainty_deg"])
    shows_it(row_of(page, "#history-table", run["id"][:8]))
    go("#/")
    expect(page.locator("#runs-table")).to_contain_text(run["id"][:8])
    shows_it(row_of(page, "#runs-table", run["id"][:8]))
    go("#/compare?unit=EFFECTS")
    expect(page.locator("#compare-table")).to_contain_text("EFFECTS")
    shows_it(row_of(page, "#compare-table", "EFFECTS"))
    go(f"#/runs/{run['id']}")
    expect(page.locator("#result")).to_contain_text("Plain fit")
    result = figures_of(page, "#result")
    shows_it(result)
    shows(result["RMS error, with effects"], document["rms_with_effects_deg"])
    shows(result["Plain fit: bias"], run["result"]["bias_deg"], run["result"]["bias_std_deg"])
    shows(result["Plain fit: scale"], run["result"]["scale"], run["result"]["scale_std"])
    shows(result["Plain fit: RMS error"], document["rms_calibrated_deg"])
    assert list(result).index("Bias") < list(result).index("Plain fit: bias")


def test_a_toggle_shows_residuals_of_the_plain_fit(page, client, go, expect, runs):
    go(f"#/runs/{runs[1]['id']}")
    unfold(page, "charts")
    lower = """() => document.querySelector("[data-testid=residual]").data
        ?.filter(trace => trace.yaxis === "y2").flatMap(trace => [...trace.y])"""
    cells = page.locator("#poses-table tbody tr td:nth-child(7)")
    title = page.get_by_test_id("residual").locator(".y2title")

    def rms_shown():
        values = page.evaluate(lower)
        column = [float(text.rstrip("°").replace("−", "-")) for text in cells.all_text_contents()]
        assert len(values) == len(column) == runs[1]["result"]["n_poses"]
        assert sum(v * v for v in values) == pytest.approx(sum(v * v for v in column), rel=0.1)
        return math.sqrt(sum(value**2 for value in values) / len(values))

    expect(title).to_contain_text("with effects")
    expect(cells).to_have_count(26)
    assert rms_shown() == pytest.approx(runs[1]["result"]["rms_with_effects_deg"])
    before = cells.first.text_content()
    page.get_by_label("Plain fit of bias and scale").check()
    expect(cells.first).not_to_have_text(before)
    expect(title).to_contain_text("bias and scale alone")
    assert rms_shown() == pytest.approx(runs[1]["result"]["rms_calibrated_deg"])


def test_a_verification_shows_errors_of_indication_and_no_bias(page, client, go, expect, runs):
    go(f"#/runs/{runs[0]['id']}")
    expect(page.locator("#result")).to_contain_text("Mean error of indication")
    shown, over = figures_of(page, "#result"), runs[0]["result"]["over_range"]
    assert not {"Bias", "Scale"} & set(shown)
    shows(shown["Revision applied"], in_force(client)["revision"])
    shows(shown["Mean error of indication"], over["mean_error_deg"])
    shows(shown["Errors of indication"], min(over["lowest_error_deg"]))
    shows(shown["RMS error of indication"], runs[0]["result"]["verified"]["rms_deg"])
    go("#/")
    row = row_of(page, "#runs-table", runs[0]["id"][:8])
    assert (row["Bias"], row["Scale"]) == ("–", "–")


def test_a_solved_unit_has_no_bias_of_twelve_zeros(page, client, go, expect):
    document = in_force(client, "SOLVED")
    assert document["bias_deg"] == 0.0 and not document["level_known"]
    go("#/units/SOLVED")
    expect(page.locator("#sha256")).to_have_text(document["sha256"])
    card = figures_of(page, "#calibration")
    assert "level is not known" in card["Bias"] and "Scale" not in card
    shows(card["RMS error, with effects"], document["rms_with_effects_deg"])
    go("#/compare?unit=SOLVED")
    expect(page.locator("#compare-table")).to_contain_text("SOLVED")
    assert "000000" not in page.locator("#compare-table").text_content()


def test_what_is_undecided_has_the_colour_of_no_pass(page, client, go, expect):
    run = imported(client, "UNSURE")
    assert run["verdict"]["answer"] == "undecided"  # U of an import without a reference is not known
    go(f"#/runs/{run['id']}")
    expect(page.get_by_test_id("verdict")).to_have_class("verdict unknown")
    expect(page.get_by_test_id("verdict").locator(".headline")).to_contain_text("Undecided")
