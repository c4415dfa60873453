"""`calrig apply` and `calrig.load`: a document as it was issued, readings from file, pipe or program."""

from __future__ import annotations

import csv
import io
import json
from http.server import BaseHTTPRequestHandler, HTTPServer

import numpy as np
import pytest
from command_line import calrig, reason
from issued_documents import issued
from support import at_work
from typer.testing import CliRunner

import calrig as package
from calrig.canonical_json import sha256_of
from calrig.cli.main import app
from calrig.errors import InputError
from calrig.export import applied_csv

WARM = {"name": "temperature_bias", "parameters": {"deg_per_c": 0.05, "reference_c": 24.0}, "formula": ""}


@pytest.fixture
def document(folder):
    """A calibration of ±30° in cal.json, whose uncertainty nobody knows."""
    return written(
        folder, issued(range_deg=[-30.0, 30.0], uncertainty={"type_a_deg": 0.03, "type_b_deg": None})
    )


def written(folder, document, **changes):
    document = {**document, **changes}
    document["sha256"] = sha256_of(document)
    (folder / "cal.json").write_text(json.dumps(document))
    return document


def rows_of(text):
    return list(csv.DictReader(io.StringIO(text)))


def test_what_came_is_printed_with_elevation_and_uncertainty_beside_it(folder, document):
    worth = {"type_a_deg": 0.03, "type_b_deg": 0.04}
    changed = {"uncertainty": worth, "covariance": None, "effects": [WARM]}
    document = written(folder, document, **changed, temperature_c={"min": 20.0, "max": 30.0})
    (folder / "r.csv").write_text('who,reading_deg,temperature_c\n"a, b",12.5,26\nc,-7,31.5\nd,80,20\n')
    done = calrig("apply", "cal.json", "r.csv")
    rows = rows_of(done.stdout)
    assert [row["who"] for row in rows] == ["a, b", "c", "d"]
    expected = (12.5 - 0.05 * 2.0 - document["bias_deg"]) / document["scale"]
    assert float(rows[0]["elevation_deg"]) == pytest.approx(expected, abs=1e-6)
    assert float(rows[0]["elevation_std_deg"]) == pytest.approx(0.05)
    assert rows[2]["elevation_std_deg"] == ""
    beyond, warm = done.stderr.splitlines()
    assert beyond.startswith(
        "calrig apply: r.csv: 1 row, the first in line 4: the elevation is outside -30° to"
    )
    assert "line 3: the temperature" in warm
    loaded = package.load("cal.json")
    assert (loaded.unit, loaded.revision, loaded.range_deg) == ("AS-0042", 3, (-30.0, 30.0))
    assert loaded.elevation_deg(12.5, temperature_c=26.0) == pytest.approx(expected)
    found = loaded.elevation_deg([[12.5, -7.0]], temperature_c=26.0)
    assert found.shape == (1, 2)
    assert loaded.elevation_std_deg(12.5, temperature_c=26.0) == pytest.approx(0.05)
    vector = [0.0, np.sin(np.radians(12.5)), np.cos(np.radians(12.5))]
    assert loaded.elevation_deg(accel_g=[vector], temperature_c=26.0) == pytest.approx([expected])
    with pytest.raises(ValueError, match="needs temperature_c"):
        loaded.elevation_deg(12.5)


def test_angles_of_a_full_turn_survive_with_their_scale(folder, document):
    """The reading is 5 + 1.01·θ; the third as a sensor gives it that counts to half a turn."""
    written(folder, document, range_deg=[0.0, 350.0], bias_deg=5.0, scale=1.01, effects=[])
    (folder / "r.csv").write_text("reading_deg,temperature_c\n247.4,20\n185.79,20\n-112.6,20\n")
    rows = rows_of(calrig("apply", "cal.json", "r.csv").stdout)
    assert [float(row["elevation_deg"]) for row in rows] == pytest.approx([240.0, 179.0, 240.0], abs=1e-6)


def test_readings_as_people_write_them_are_read_and_come_back_as_they_are(folder, document):
    (folder / "plain.csv").write_text("reading_deg,temperature_c\n12.5,20\n-7,21\n")
    lines = ["# by hand", "Reading,Temperature", "°,°F", "12.5°,68", "# a remark, here", "−7,69.8", ""]
    (folder / "r.csv").write_text("\n".join(lines))
    done = calrig("apply", "cal.json", "r.csv")
    plain, rows = rows_of(calrig("apply", "cal.json", "plain.csv").stdout), rows_of(done.stdout)
    for name in applied_csv.ADDED:
        assert [row[name] for row in rows] == [row[name] for row in plain]
    assert [row["Reading [°]"] for row in rows] == ["12.5°", "−7"]
    said = ("row of units", "comment", "unit or a typographic minus", "as temperature_c (converted from °F)")
    assert all(words in done.stderr for words in said)


def test_all_bad_cells_of_readings_are_told_at_once_also_in_later_pieces(folder, document, monkeypatch):
    monkeypatch.setattr(applied_csv, "PIECE_BYTES", 40)
    rows = "".join(f"{'x' if k in {3, 17} else k},20\n" for k in range(30))
    (folder / "r.csv").write_text(f"reading_deg,temperature_c\n{rows}")
    done = calrig("apply", "cal.json", "r.csv", status=2)
    assert 0 < len(rows_of(done.stdout)) < 4
    assert "line 5, column reading_deg: 'x'" in done.stderr
    assert "line 19, column reading_deg: 'x'" in done.stderr


def test_a_quote_in_a_comment_does_not_join_pieces(folder, document, monkeypatch):
    monkeypatch.setattr(applied_csv, "PIECE_BYTES", 40)
    monkeypatch.setattr(applied_csv, "LONGEST_BYTES", 80)
    (folder / "r.csv").write_text('reading_deg\n# 5" rod\n' + "1.5\n" * 100)
    assert len(rows_of(calrig("apply", "cal.json", "r.csv").stdout)) == 100


def test_a_pipe_of_accelerations_with_semicolons_and_decimal_commas(document, monkeypatch):
    monkeypatch.setattr(applied_csv, "PIECE_BYTES", 60)
    text = 'accel_y_mps2;accel_z_mps2;note\r\n0,0;9,80665;x\r\n\r\n4,903325;8,4928;"two\nlines"\r\n'
    done = CliRunner().invoke(app, ["apply", "cal.json"], input=text.encode())
    assert done.exit_code == 0
    rows = list(csv.DictReader(io.StringIO(done.stdout), delimiter=";"))
    found = [float(row["elevation_deg"].replace(",", ".")) for row in rows]
    expected = (np.array([0.0, 30.0]) - document["bias_deg"]) / document["scale"]
    np.testing.assert_allclose(found, expected, atol=1e-4)
    assert rows[1]["note"] == "two\nlines"
    assert "elevation_std_deg is blank" in done.stderr


@pytest.mark.parametrize(
    ("readings", "says"),
    [
        ("angle\n1\n", ["line 1", "column reading_deg", "accel_y_g"]),
        ("reading_deg\n1\n", ["line 1", "column temperature_c"]),
        ("reading_deg,temperature_c\n1,20\n\n2,\n", ["line 4", "column temperature_c"]),
        ("reading_deg,temperature_c\n1,20\nx,20\n", ["line 3", "column reading_deg", "'x'"]),
        ("reading_deg,temperature_c,elevation_deg\n1,2,3\n", ["line 1", "column elevation_deg"]),
        ("reading_deg,temperature_c\n", ["line 1", "no rows"]),
        ("", ["empty"]),
    ],
)
def test_bad_readings_are_2_with_file_line_and_column(folder, document, readings, says):
    written(folder, document, effects=[WARM])
    (folder / "r.csv").write_text(readings)
    said = reason("apply", "cal.json", "r.csv", status=2)
    assert all(word in said for word in ["r.csv", *says])


def test_the_token_does_not_follow_a_redirection_to_another_address(folder, document, monkeypatch):
    heard = []

    class Service(BaseHTTPRequestHandler):
        def do_GET(self):
            heard.append((self.path, self.headers["Authorization"]))
            self.send_response(302 if self.path == "/here" else 200)
            self.send_header("Location", f"http://localhost:{self.server.server_port}/elsewhere")
            self.end_headers()
            self.wfile.write(json.dumps(document).encode() if self.path == "/elsewhere" else b"")

        def log_message(self, *_words):
            """Says nothing."""

    monkeypatch.setenv("CALRIG_TOKEN", "secret")
    with at_work(HTTPServer(("127.0.0.1", 0), Service)) as server:
        unit = package.load(f"http://127.0.0.1:{server.server_port}/here").unit
    assert unit == "AS-0042"
    assert heard == [("/here", "Bearer secret"), ("/elsewhere", None)]


@pytest.mark.parametrize(
    "changes",
    [
        {"scale": 0.0},
        {"scale": 1e300},
        {"bias_deg": None},
        {"range_deg": "wide"},
        {"covariance": [[1.0]]},
        {"effects": [{"name": "gremlins", "parameters": {}}]},
        {"effects": [7]},
        {"uncertainty": "large"},
        {"elevation_std_deg": {"elevation_deg": [0.0], "std_deg": []}},
        {"accelerometer": {"bias_g": [0.0], "matrix": [[1.0]]}, "bias_deg": 0.0, "scale": 1.0},
    ],
)
def test_what_cannot_be_applied_is_said_in_a_line(folder, document, changes):
    written(folder, document, **changes)
    (folder / "r.csv").write_text("reading_deg\n1\n")
    assert "cal.json: cannot be applied" in reason("apply", "cal.json", "r.csv", status=2)
    with pytest.raises(InputError, match="cannot be applied"):
        package.load("cal.json")


def test_a_document_that_was_changed_or_is_none_is_refused(folder, document):
    (folder / "cal.json").write_text(json.dumps({**document, "bias_deg": 0.0}))
    assert "was changed since it was issued" in reason("apply", "cal.json", "poses.csv", status=2)
    with pytest.raises(InputError, match="was changed"):
        package.load("cal.json")
    (folder / "cal.json").write_text('{"schema": "calrig.stage-map/1"}')
    assert "is no calibration" in reason("apply", "cal.json", "poses.csv", status=2)
    (folder / "cal.json").write_text('{"schema": \n oops')
    assert "cal.json, line 2, column 2" in reason("apply", "cal.json", "poses.csv", status=2)
    assert "absent.json" in reason("apply", "absent.json", "poses.csv", status=2)
