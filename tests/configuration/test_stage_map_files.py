"""`reference = { map = … }`: the file is looked at when the program starts."""

from __future__ import annotations

import json

import pytest

from calrig.analysis.stage_maps import configured_maps
from calrig.canonical_json import sha256_of
from calrig.settings import SettingsError, load_settings

CONTENT = {
    "schema": "calrig.stage-map/1",
    "orders": [1.0],
    "coefficients_deg": [0.1, 0.2, 0.0],
    "covariance_deg2": [[1e-5, 0.0, 0.0], [0.0, 1e-5, 0.0], [0.0, 0.0, 0.0]],
    "map": {"stage_deg": [-60.0, 0.0, 60.0]},
    "units": ["A"],
    "solved_from": ["a.csv"],
    "separable": True,
}
RIG = """[[rig]]
name = "b"
stage = { driver = "smc100", port = "a" }
imu = { driver = "calrig", port = "b" }
reference = { map = "maps/stage-map.json" }
"""


@pytest.fixture
def settings(tmp_path):
    """Those of a folder; the map lies in another one beside the file."""
    (tmp_path / "maps").mkdir()
    (tmp_path / "calrig.toml").write_text(RIG)
    return load_settings(str(tmp_path / "calrig.toml"))


def test_the_file_is_looked_for_beside_calrig_toml(settings, tmp_path, monkeypatch):
    monkeypatch.chdir("/")
    map_file = {**CONTENT, "sha256": sha256_of(CONTENT)}
    (tmp_path / "maps" / "stage-map.json").write_text(json.dumps(map_file))
    kept = configured_maps(settings)["b"]
    assert (kept["file"], kept["sha256"]) == ("maps/stage-map.json", map_file["sha256"])
    assert kept["dial_deg"] == [-60.0, 60.0]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (None, r"cannot be read \(No such file.*name the stage-map.json"),
        ("{", "is no JSON document"),
        ("[]", "is no stage's map.*make it again with `calrig solve"),
        (json.dumps({**CONTENT, "sha256": "0"}), "was changed since it was made"),
        ('{"schema": NaN}', r"not finite \(NaN\)"),
    ],
)
def test_what_cannot_be_used_is_named_with_file_and_what_to_do(settings, tmp_path, text, said):
    if text is not None:
        (tmp_path / "maps" / "stage-map.json").write_text(text)
    with pytest.raises(SettingsError, match=rf"calrig\.toml: rig 'b'.*stage-map\.json.*{said}"):
        configured_maps(settings)
