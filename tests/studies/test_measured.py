"""Measured logs: what is known of their axes from elsewhere is found, and predicts held-out poses."""

from __future__ import annotations

import pytest
from support import DATA

from calrig.calibration.diagnosis.tracing import diagnose, document
from calrig.export.poses_csv import read_poses

KNOWN = {
    "magalpha_magnet_one_turn": ({"amplitude_deg": [0.97, 3.28, 1.74]}, 0.65),
    "mechaduino_will_table1": ({"period_deg": [90.0, 7.2]}, 0.025),
    "phd2_astrophysics_ra": ({"period_deg": [1.5965]}, 0.00035),
    "servo_potentiometer": ({"backlash_deg": [-0.38], "size_deg": [0.59]}, 0.23),
}
"""By log: parameters and their values by the makers or a fit by hand (docs/validation/measured-logs.md), and
what held-out poses may be wrong by, degrees: at most 1.2 times what a fit by hand leaves."""


@pytest.mark.parametrize("log", KNOWN)
def test_what_is_known_of_a_measured_axis_is_found(log):
    file = DATA / f"{log}_poses.csv"
    if not file.is_file():
        pytest.skip(f"{file} is not here")
    said = document(diagnose([read_poses(file.read_bytes()).poses]), [log])
    known, held_out_deg = KNOWN[log]
    found = [effect["parameters"] for effect in said["effects"]]
    for name, values in known.items():
        of_name = [one[name]["value"] for one in found if one.get(name)]
        for value in values:
            assert any(at == pytest.approx(value, rel=0.05) for at in of_name), (name, value, of_name)
    assert said["final"]["held_out_rms_deg"] < held_out_deg
