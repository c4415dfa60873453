"""PDF and DCC of a revision, read back: every figure is that of the JSON, and none says another."""

from __future__ import annotations

import base64
import io
import json
import math
import re
import xml.etree.ElementTree as ET
from typing import Any

import httpx
import pypdf
import pytest
from support import running_service, serving
from told_units import IMU, LIMIT, PLAN, accepted, agrees, measured, solved

from calrig.export.certificate.wording import flattened

NUMBER = r"−?\d+(?:\.\d+)?"
DCC = {"dcc": "https://ptb.de/dcc", "si": "https://ptb.de/si"}


@pytest.fixture(scope="module")
def client(launch_rig, tmp_path_factory):
    """A service with a plain unit, one with effects and one that was solved for."""
    rig = launch_rig(imu=IMU)
    path = tmp_path_factory.mktemp("story") / "calrig.db"
    with running_service(path, rig) as service, serving(service) as client:
        client.put("/api/limits", json=[LIMIT]).raise_for_status()
        accepted(client, "EFFECTS")
        measured(client, "PLAIN")
        solved(client, "SOLVED")
        yield client


class Documents:
    """What there is of a unit's revision in force: JSON, its verdict, the PDF's text and the DCC."""

    def __init__(self, client: httpx.Client, unit: str) -> None:
        path = f"/api/units/{unit}/calibration"
        self.json = client.get(path).raise_for_status().json()
        revisions = client.get(f"{path}s").json()
        self.verdict = next(one for one in revisions if one["revision"] == self.json["revision"])["verdict"]
        revision = {"revision": self.json["revision"]}
        pdf = client.get(path, params={**revision, "format": "pdf"}).raise_for_status().content
        pages = [page.extract_text() for page in pypdf.PdfReader(io.BytesIO(pdf)).pages]
        without_heads = [re.sub(r"^Certificate \S+ \d+ of \d+", "", page) for page in pages]
        self.pdf = " ".join(" ".join(without_heads).split())
        dcc = client.get(path, params={**revision, "format": "dcc"}).raise_for_status().content
        self.dcc = ET.fromstring(dcc)

    def told(self, pattern: str) -> tuple[str, ...]:
        """The groups of a pattern that the PDF must have, `#` in it being a number."""
        found = re.search(pattern.replace("#", f"({NUMBER})"), self.pdf)
        assert found is not None, pattern
        return found.groups()

    def quantities(self, ref_type: str) -> list[ET.Element]:
        """The quantities of the DCC with a reference type."""
        every = self.dcc.iterfind(".//dcc:quantity", DCC)
        return [one for one in every if ref_type in one.get("refType", "").split()]

    def real(self, ref_type: str, place: str = "si:value") -> float:
        """A figure of the DCC in degrees, or as it is."""
        (one,) = self.quantities(ref_type)
        reals = list(one.iterfind(".//si:real", DCC))
        text = reals[-1].findtext(place, namespaces=DCC)
        assert text is not None
        return float(text)

    def column(self, ref_type: str) -> list[float]:
        """A list of figures of the DCC in degrees."""
        (one,) = self.quantities(ref_type)
        lists = list(one.iterfind(".//si:valueXMLList", DCC))
        return [float(value) for value in (lists[-1].text or "").split()]

    @property
    def rows(self) -> list[tuple[str, ...]]:
        """The table of errors: elevation, as left mean, lowest and highest, U."""
        errors = "#° \\d+ #° #° … #° #° #° … #° #°".replace("#", f"({NUMBER})")
        return [(row[0], *row[4:]) for row in re.findall(errors, self.pdf)]


@pytest.fixture(scope="module", params=["PLAIN", "EFFECTS", "SOLVED"])
def told(client, request):
    return Documents(client, request.param)


def value_of(text: str) -> float:
    return float(text.replace("−", "-"))


def test_u_and_k_are_the_documents(told):
    json, (u, k) = told.json, told.told("U = #° \\(k = #, 95 %\\)")
    assert agrees(u, json["expanded_uncertainty_deg"]) and agrees(k, json["coverage_factor"])
    assert told.real("calrig_elevation", ".//si:uncertainty") == pytest.approx(
        json["expanded_uncertainty_deg"]
    )
    assert told.real("calrig_elevation", ".//si:coverageFactor") == pytest.approx(json["coverage_factor"])
    assert agrees(told.told("Expanded uncertainty U #°")[0], json["expanded_uncertainty_deg"])
    for row in told.rows:
        assert agrees(row[-1], json["expanded_uncertainty_deg"])
    parts = [told.json["uncertainty"][name] for name in ("type_a_deg", "type_b_deg")]
    assert agrees(told.told("Combined standard uncertainty u #°")[0], math.hypot(*parts))
    judged = " ".join(told.verdict["says"])
    u_of_elevation = re.search(rf"of an elevation ({NUMBER})°", judged) or re.search(
        rf"Largest error.*?U = ({NUMBER})°", judged
    )
    assert agrees(u_of_elevation[1], json["expanded_uncertainty_deg"])


def test_degrees_of_freedom_are_the_same_in_verdict_budget_and_document(told):
    freedom = told.json["degrees_of_freedom"]
    lines = re.findall(r"A (?:Student's t|normal) (\d+) ", told.pdf)
    assert lines and {int(one) for one in lines} == {math.floor(freedom)}
    said = re.findall(r"\((\d+) degrees of freedom\)", told.pdf)
    assert [int(one) for one in said] == ([] if told.json["run_id"] is None or not said else [freedom])
    of_effects = [float(one) for one in re.findall(r"degrees of freedom ([\d.]+)", dcc_text(told))]
    assert of_effects and all(
        one in (freedom, math.inf) or one == pytest.approx(freedom, abs=1e-3) for one in of_effects
    )


def dcc_text(told: Documents) -> str:
    """The words about contributions in the DCC."""
    return " ".join(" ".join(one.itertext()) for one in told.quantities("calrig_uncertaintyContribution"))


def test_bias_and_scale_and_effects_are_the_documents(told):
    json = told.json
    if "elevation_std_deg" in json:
        assert not told.quantities("calrig_bias_deg") and "0.0000000000" not in told.pdf.split("Annex")[0]
    else:
        bias, scale = told.told("not known\\) #° #° #")[0], told.told("Scale # # #")
        assert agrees(bias, json["bias_deg"]) and agrees(scale[0], json["scale"])
        assert told.real("calrig_bias_deg") == pytest.approx(json["bias_deg"])
        assert told.real("calrig_scale") == pytest.approx(json["scale"])
        said = re.search(rf"Scale ({NUMBER}), U = ({NUMBER})", " ".join(told.verdict["says"]))
        assert agrees(said[1], json["scale"]) and said[2] == scale[1]
    for effect in json["effects"]:
        for name, value in effect["parameters"].items():
            shown = re.findall(rf"\({name}\) ({NUMBER})", told.pdf)
            assert any(agrees(one, value) for one in shown), name


def test_rms_errors_are_the_same_in_table_caption_and_verdict(told):
    json, judged = told.json, " ".join(told.verdict["says"])
    steps = re.findall(rf"(?:RMS )({NUMBER})°", told.told(r"(Residual of each pose.*?\.) Measurement")[0])
    raw, calibrated = re.search(rf"({NUMBER})° raw, ({NUMBER})° calibrated", judged).groups()
    if "elevation_std_deg" in json:  # the document has all runs of the unit, figure and verdict one of them
        of_all = told.told("over all runs of the solution #°.*?over all runs of the solution #°")
        assert agrees(of_all[0], json["rms_raw_deg"]) and agrees(of_all[1], json["rms_with_effects_deg"])
        assert "of one run of the joint solution" in judged
        assert (steps[0], steps[-1]) == (raw, calibrated)
        return
    assert agrees(steps[0], json["rms_raw_deg"]) and agrees(raw, json["rms_raw_deg"])
    assert agrees(steps[1], json["rms_calibrated_deg"]) and agrees(calibrated, json["rms_calibrated_deg"])
    final = json["rms_with_effects_deg"]
    final = json["rms_calibrated_deg"] if final is None else final
    assert agrees(steps[-1], final) and agrees(re.search(rf"RMS error ({NUMBER})°, U", judged)[1], final)
    for name in ("rms_raw_deg", "rms_calibrated_deg"):
        assert told.real(f"calrig_{name}") == pytest.approx(json[name])
    assert agrees(told.told("plain fit of bias and scale #°")[0], json["rms_calibrated_deg"])


def test_the_largest_error_of_the_verdict_is_in_the_table_at_its_elevation(told):
    said = re.search(rf"Largest error ({NUMBER})°, near ({NUMBER})°", " ".join(told.verdict["says"]))
    rows = {value_of(place): (low, high) for place, _, low, high, _ in told.rows}
    assert len(rows) == (25 if "elevation_std_deg" in told.json else 13)
    largest = max(abs(value_of(end)) for ends in rows.values() for end in ends)
    assert agrees(said[1], largest)
    assert agrees(said[1], max(abs(value_of(end)) for end in rows[value_of(said[2])]))
    means = told.column("basic_measurementError")
    for (_, mean, *_), value in zip(told.rows, means, strict=True):
        assert agrees(mean, value)
    for (place, *_), value in zip(told.rows, told.column("basic_nominalValue"), strict=True):
        assert agrees(place, value)


def test_every_number_of_the_document_is_in_the_annex_and_in_the_file_inside_the_dcc(told):
    annex = told.pdf.replace(" ", "")
    for name, value in flattened(told.json):
        assert value.replace(" ", "") in annex, name
    (inside,) = told.dcc.iterfind(".//dcc:dataBase64", DCC)
    assert json.loads(base64.b64decode(inside.text)) == told.json


def test_range_and_temperature_are_the_documents(told):
    for shown, end in zip(told.told("Range #° to #°"), told.json["range_deg"], strict=True):
        assert agrees(shown, end)
    warmth = told.json["temperature_c"]
    if warmth is None or warmth["min"] is None:
        assert not told.quantities("basic_temperatureMin")
        return
    for shown, end in zip(told.told("Temperature # °C to # °C"), ("min", "max"), strict=True):
        assert agrees(shown, warmth[end])
        of_dcc = told.quantities(f"basic_temperature{end.capitalize()}")
        assert {float(one.findtext(".//si:value", namespaces=DCC)) for one in of_dcc} == {warmth[end]}


def test_parameters_of_effects_in_the_dcc_are_the_documents(told):
    for effect in told.json["effects"]:
        for name, value in effect["parameters"].items():
            quantities = told.quantities(f"calrig_{name}")
            found = [float(one.text) for each in quantities for one in each.iterfind(".//si:value", DCC)]
            in_words = [
                one for each in quantities for one in each.iterfind("dcc:noQuantity/dcc:content", DCC)
            ]
            found += [float(one.text.split()[0]) for one in in_words]  # of a unit that D-SI has none for
            assert any(one == pytest.approx(value) for one in found), name


def test_errors_as_found_and_numbers_of_poses_are_one_in_pdf_and_dcc(told):
    errors = "(#)° (\\d+) (#)° #° … #° #° #° … #° #°".replace("#", NUMBER)
    rows = re.findall(errors, told.pdf)
    columns = (
        told.column("basic_nominalValue"),
        told.column("calrig_poses"),
        told.column("calrig_errorAsFound"),
    )
    assert len(rows) == len(columns[0])
    for row, *values in zip(rows, *columns, strict=True):
        assert all(agrees(shown, value) for shown, value in zip(row, values, strict=True))


def test_contributions_of_the_budget_are_one_in_pdf_and_dcc_and_come_to_the_documents(told):
    parts = told.quantities("calrig_uncertaintyContribution")
    values = [float(one.findtext(".//si:value", namespaces=DCC)) for one in parts]
    budget = re.findall(NUMBER, told.told("(Contribution Share.*?)Combined standard")[0])
    for value in values:
        assert value == 0.0 or any(agrees(shown, value) for shown in budget), value
    correlated = any("Correlation" in "".join(one.itertext()) for one in parts)
    combined = [told.json["uncertainty"][name] for name in ("type_a_deg", "type_b_deg")]
    if not correlated:
        assert math.hypot(*values) == pytest.approx(math.hypot(*combined), rel=1e-6)


def test_a_verification_and_its_poses_say_one_rms(client):
    run = measured(client, "EFFECTS", kind="verification", step_deg=20)
    poses = client.get(f"/api/runs/{run['id']}/poses").json()
    rms = math.sqrt(sum(pose["residual_deg"] ** 2 for pose in poses) / len(poses))
    assert rms == pytest.approx(run["result"]["rms_with_effects_deg"])


def test_residuals_are_those_that_the_verdict_judges_or_of_the_plain_fit(client):
    (run,) = (
        one
        for one in client.get("/api/runs?unit=EFFECTS").json()["items"]
        if one["plan"]["kind"] == "calibration"
    )
    result = run["result"]
    for fit, name, title in (
        ("verdict", "rms_with_effects_deg", "with effects"),
        ("plain", "rms_calibrated_deg", "bias and scale alone"),
    ):
        asked: dict[str, Any] = {"params": {"fit": fit}}
        poses = client.get(f"/api/runs/{run['id']}/poses", **asked).raise_for_status().json()
        rms = math.sqrt(sum(pose["residual_deg"] ** 2 for pose in poses) / len(poses))
        assert rms == pytest.approx(result[name])
        figure = client.get(f"/api/runs/{run['id']}/figures/residual", **asked).raise_for_status().json()
        assert title in figure["layout"]["yaxis2"]["title"]["text"]
        shown = [value for trace in figure["data"] if trace.get("yaxis") == "y2" for value in trace["y"]]
        assert math.sqrt(sum(value**2 for value in shown) / len(shown)) == pytest.approx(result[name])
    assert len(poses) == 26 == len(range(PLAN["start_deg"], PLAN["stop_deg"] + 1, PLAN["step_deg"])) * 2


def test_the_first_pose_has_a_number_in_what_has_changed(client):
    (run,) = client.get("/api/runs?unit=PLAIN").json()["items"]
    why = {"reason": "somebody leant on the bench"}
    client.post(f"/api/runs/{run['id']}/poses/0/exclude", json=why).raise_for_status()
    (said,) = client.get("/api/units/PLAIN/calibrations").json()[-1]["stale"]
    assert "none" in said and "no. 0" in said
