"""An effect on a column that calrig knows nothing of: one module more, and no edit anywhere else."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import calrig

EFFECT = '''
"""A bias that follows the supply voltage."""

from calrig.calibration.regression.effect import Covariate, Effect, Parameter, Shape
from calrig.calibration.regression.terms import tilted

SUPPLY = Covariate("supply_v", "supply voltage", "V", lambda r: r.covariates.get("supply_v"))


def _forms(r, at):
    volts = r.covariates.get("supply_v")
    if volts is not None:
        reference_v = float(at.get("reference_v", volts.mean()))
        yield Shape(tilted(volts - reference_v), ("deg_per_v",), at={"reference_v": reference_v})


EFFECT = Effect(
    name="supply_bias",
    title="Bias that follows the supply",
    origin="sensor",
    scope="unit",
    covariate=SUPPLY,
    parameters=(
        Parameter("deg_per_v", "Supply coefficient", "°/V"),
        Parameter("reference_v", "Reference voltage", "V"),
    ),
    formula="deg_per_v·(supply_v − reference_v)",
    forms=_forms,
    on_reading_deg=lambda p: p.value("deg_per_v") * (p.column("supply_v") - p.value("reference_v", None)),
    in_c=lambda p: f"{p['deg_per_v']}f * (supply_v - {p['reference_v']}f)",
    apart="a run at one voltage",
    remedy="stabilise the supply",
)
'''
DEG_PER_V, BIAS_DEG = 1.7, 0.6
IN_USE = """
import json, sys
from pathlib import Path

import calrig as package
from command_line import calrig
from shared_processes import in_shared_process
from support import imported, running_service, serving

from calrig.analysis import unit_of_work

unit_of_work.run_in_subprocess = in_shared_process
with running_service(Path("calrig.db")) as service, serving(service) as client:
    run = imported(client, "A", Path("poses.csv").read_text())
    path = f"/api/runs/{run['id']}/diagnosis"
    found = client.post(path, json={}).json()
    client.post(f"{path}/accept", json={"effects": ["supply_bias"]}).raise_for_status()
    unit = "/api/units/A/calibration"
    header = client.get(unit, params={"format": "c-header"})
    document = client.get(unit).text
Path("unit.json").write_text(document)
loaded, reading_deg = package.load("unit.json"), float(sys.argv[1])
try:
    loaded.elevation_deg(reading_deg)
except ValueError as error:
    why = str(error)
refused = calrig("apply", "unit.json", "blind.csv", status=2)
answers = {
    "effects": found["effects"],
    "document": json.loads(document),
    "header": [header.status_code, header.text],
    "applied": calrig("apply", "unit.json", "flight.csv").stdout,
    "loaded": loaded.elevation_deg(reading_deg, columns={"supply_v": 3.6}),
    "why": why,
    "refused": [refused.stdout, refused.stderr],
}
json.dump(answers, sys.stdout)
"""


@pytest.fixture
def with_effect(tmp_path):
    """The environment of processes whose calrig has the module, and nothing else that differs."""
    here, copy = Path(calrig.__file__).parent, tmp_path / "installed" / "calrig"
    effects = copy / "calibration" / "effects"
    effects.parent.mkdir(parents=True)
    for original, there, own in (
        (here.parent, copy.parent, "calrig"),
        (here, copy, "calibration"),
        (here / "calibration", effects.parent, "effects"),
    ):
        for found in original.iterdir():
            if found.name != own:
                (there / found.name).symlink_to(found)
    shutil.copytree(here / "calibration" / "effects", effects)
    (effects / "supply_bias.py").write_text(EFFECT, encoding="utf-8")
    paths = [str(copy.parent), str(Path(__file__).parent.parent)]
    return {**os.environ, "PYTHONPATH": os.pathsep.join(paths)}


def test_an_effect_on_a_column_of_ones_own_is_found_accepted_exported_and_applied(with_effect, tmp_path):
    rng = np.random.default_rng(5)
    theta, volts = rng.uniform(-60, 60, 60).round(2), rng.uniform(3.0, 3.6, 60).round(3)
    reading = BIAS_DEG + theta + DEG_PER_V * (volts - 3.3) + rng.normal(0, 0.01, 60)
    rows = [f"{x},{y:.4f},{v}" for x, y, v in zip(theta, reading, volts, strict=True)]
    (tmp_path / "poses.csv").write_text("\n".join(["target_deg,reading_deg,supply_v", *rows]) + "\n")
    at_20_deg = BIAS_DEG + 20 + DEG_PER_V * 0.3
    (tmp_path / "flight.csv").write_text(f"reading_deg,supply_v\n{at_20_deg},3.6\n")
    (tmp_path / "blind.csv").write_text("reading_deg\n20\n")
    done = subprocess.run(
        [sys.executable, "-c", IN_USE, str(at_20_deg)],
        env=with_effect,
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    answers = json.loads(done.stdout)
    assert [one["name"] for one in answers["effects"]] == ["supply_bias"]
    document = answers["document"]
    assert document["effects"][0]["parameters"]["deg_per_v"] == pytest.approx(DEG_PER_V, abs=0.02)
    assert document["rms_with_effects_deg"] < 0.02 < 0.2 < document["rms_calibrated_deg"]
    assert (answers["header"][0], "supply_v" in answers["header"][1]) == (409, True)

    assert float(answers["applied"].splitlines()[1].split(",")[2]) == pytest.approx(20.0, abs=0.03)
    assert (answers["loaded"], "supply_v" in answers["why"]) == (pytest.approx(20.0, abs=0.03), True)
    nothing, refused = answers["refused"]
    assert (nothing, "supply_v" in refused, "no such column" in refused) == ("", True, True)
