"""Every line format of sketches.md, whole and damaged."""

from __future__ import annotations

import itertools
import re
import sys
from collections import Counter
from importlib import import_module
from textwrap import dedent

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sketch_texts import BANNERS, BY_DRIVER, ELECTRONIC_CATS, SKETCH, TEXTS

from calrig.instruments.boards.sketch import Sketch, line_forms
from calrig.instruments.boards.sketch_board import SketchReader, SketchSamples
from calrig.instruments.errors import BoardError

G_MPS2 = 9.80665
ALL = pytest.mark.parametrize("text", TEXTS, ids=lambda text: text.sketch.driver)
RAW = BY_DRIVER["i2cdev-raw"]


def read(sketch, data):
    faults = Counter()
    return SketchReader(sketch, faults).feed(data), faults


def sample(sketch, data):
    """The one sample that a record makes."""
    records, _ = read(sketch, data)
    return SketchSamples(sketch, Counter()).push([(1.0, records[0])])


def test_raw_registers_are_g_and_degrees_per_second():
    block = sample(SKETCH["i2cdev-raw"], b"a/g:\t-16384\t8192\t16384\t131\t-262\t13100\r\n")
    np.testing.assert_allclose(block.accel_g, [[-1, 0.5, 1]])
    np.testing.assert_allclose(block.gyro_dps, [[1, -2, 100]])
    assert np.isnan(block.temperature_c).all()
    assert np.isnan(block.angle_deg).all()


@pytest.mark.parametrize(
    ("driver", "line", "angle_deg"),
    [
        ("tkj-kalman", b"1.00\t2.00\t3.00\t-4.25\t\t5.00\t6.00\t7.00\t8.00\t\r\n", -4.25),
        ("mpu6050-light", b"X : -12.34\tY : 0.05\tZ : 371.00\r\n", -12.34),
        ("tockn", b"angleX : -0.00\tangleY : 1.00\tangleZ : -2.00\r\n", 0.0),
        ("dmp-ypr", b"ypr\t-120.05\t-3.30\t59.97\r\n", 59.97),
    ],
)
def test_the_elevation_of_an_angle_sketch_is_its_turn_about_x(driver, line, angle_deg):
    block = sample(BY_DRIVER[driver].sketch, line)
    assert block.angle_deg[0] == angle_deg
    for missing in (block.accel_g, block.gyro_dps, block.temperature_c):
        assert np.isnan(missing).all()


def test_adafruits_units_become_g_and_degrees_per_second():
    line = b"AccelX:0.00,AccelY:-4.90,AccelZ:9.81, GyroX:0.01,GyroY:-3.14,GyroZ:0.00\r\n"
    block = sample(SKETCH["adafruit-plotter"], line)
    np.testing.assert_allclose(block.accel_g, [[0, -4.90 / G_MPS2, 9.81 / G_MPS2]])
    np.testing.assert_allclose(block.gyro_dps, [[0.572958, -179.908748, 0]], atol=1e-6)


def test_adafruits_basic_record_has_four_lines():
    record = (
        b"Acceleration X: 0.12, Y: -0.05, Z: 9.79 m/s^2\r\nRotation X: 0.02, Y: 0.00, Z: -0.01 rad/s\r\n"
        b"Temperature: 27.35 degC\r\n\r\n"
    )
    block = sample(SKETCH["adafruit-basic"], record)
    np.testing.assert_allclose(block.accel_g * G_MPS2, [[0.12, -0.05, 9.79]])
    np.testing.assert_allclose(np.radians(block.gyro_dps), [[0.02, 0, -0.01]])
    assert block.temperature_c[0] == 27.35


def test_a_record_of_four_lines_is_not_patched_together_from_two():
    text = BY_DRIVER["adafruit-basic"]
    first, second = (text.say((k, 0, 9.8, 0, 0, 0, 20 + k)) for k in (1, 2))
    lines = first.splitlines(keepends=True)
    for part in (lines[:1], lines[:2], lines[:3], lines[:2] + lines[3:]):
        records, faults = read(text.sketch, first + b"".join(part) + second)
        assert [record[0] for record in records] == [1, 2]
        assert faults == {"unparsed": 1}


@ALL
def test_a_banner_is_no_record_and_no_fault(text):
    record = (1,) * len(text.largest)
    records, faults = read(text.sketch, BANNERS.get(text.sketch.driver, b"") + b"\r\n" + text.say(record) * 2)
    assert records == [record, record]
    assert not faults


def test_the_banner_with_a_bare_line_feed_is_none_either():
    records, faults = read(RAW.sketch, ELECTRONIC_CATS + RAW.say((1, 2, 3, 4, 5, 6)))
    assert records == [(1, 2, 3, 4, 5, 6)]
    assert not faults


def test_the_line_glued_to_tockns_banner_is_left_out():
    text = BY_DRIVER["tockn"]
    records, faults = read(text.sketch, BANNERS["tockn"] + text.say((1, 2, 3)) + text.say((4, 5, 6)))
    assert records == [(4, 5, 6)]
    assert not faults


@pytest.mark.parametrize("driver", sorted(BANNERS))
def test_a_banner_in_the_stream_tells_a_reset_once(driver):
    text = BY_DRIVER[driver]
    record = (1,) * len(text.largest)
    records, faults = read(text.sketch, text.say(record) + BANNERS[driver] + b"\r\n" + text.say(record) * 2)
    assert records == [record, None, record, record]
    assert not faults


@pytest.mark.parametrize(
    ("driver", "words"),
    [
        ("tkj-kalman", b"Error reading sensor"),  # without an end of line
        ("adafruit-plotter", b"Failed to find MPU6050 chip\r\n"),
        ("adafruit-basic", b"Adafruit MPU6050 test!\r\nFailed to find MPU6050 chip\r\n"),
        ("mpu6050-light", b"MPU6050 status: 2\r\n"),
        ("dmp-ypr", b"Initializing DMP...\r\nDMP Initialization failed (code 1)\r\n"),
    ],
)
def test_a_sketch_that_gives_up_is_quoted(driver, words):
    last_line = words.decode().strip().splitlines()[-1]
    with pytest.raises(BoardError) as error:
        read(BY_DRIVER[driver].sketch, words)
    assert f"says {last_line!r} and stops" in str(error.value)
    assert "clone" in str(error.value)


def test_a_remark_is_counted_and_the_data_are_taken():
    said = b"MPU6050 connection failed\r\n"
    records, faults = read(RAW.sketch, said + RAW.say((1, 2, 3, 4, 5, 6)))
    assert records == [(1, 2, 3, 4, 5, 6)]
    assert faults == {"board_error": 1}


@pytest.mark.parametrize(
    "line",
    [
        b"a/g:\t1\t2\t3\t4\t5\r\n",
        b"a/g:\t1\t2\t3\t4\t5\t6\n",
        b"a/g:\t1\t2\t3\t4\t5\t6\t7\r\n",
        b"a/g:\t1\t2\t3\t4\t5\t\r\n",
        b"/g:\t1\t2\t3\t4\t5\t6\r\n",
        b"\t1\t2\t3\t4\t5\t6\r\n",
        b"a/g:\t1\t2\t32768\t4\t5\t66666\r\n",
        b"a/g:\t1\t02\t3\t4\t5\t6\r\n",
        b"a/g:\t1\t2\t3\t4\t5\t-0\r\n",
        b"a/g:\t1\t2\t3\t4\xb5\t5\t6\r\n",
        b"a/g:\t1\t2\t3a/g:\t1\t2\t3\t4\t5\t6\r\n",
    ],
)
def test_a_line_that_is_not_whole_is_dropped_and_counted(line):
    good = RAW.say((1, 2, 3, 4, 5, 6))
    records, faults = read(RAW.sketch, good + line + good)
    assert records == [(1, 2, 3, 4, 5, 6)] * 2
    assert faults == {"unparsed": 1}


def test_half_a_line_at_the_start_is_not_counted():
    records, faults = read(RAW.sketch, b"\t3\t4\t5\t6\r\n" + RAW.say((1, 2, 3, 4, 5, 6)))
    assert len(records) == 1
    assert not faults


def test_a_line_that_never_ends_is_let_go():
    good = RAW.say((1, 2, 3, 4, 5, 6))
    records, faults = read(RAW.sketch, good + b"\x55" * 5000)
    assert len(records) == 1
    assert faults == {"unparsed": 1}


def cut(data, places):
    edges = [0, *sorted(place % (len(data) + 1) for place in places), len(data)]
    return [data[a:b] for a, b in itertools.pairwise(edges)]


@ALL
@settings(max_examples=20)
@given(data=st.data())
def test_how_the_bytes_are_cut_changes_nothing(text, data):
    records = data.draw(st.lists(text.records(), min_size=1, max_size=5))
    sent = b"".join(map(text.say, records))
    faults = Counter()
    reader = SketchReader(text.sketch, faults)
    places = data.draw(st.lists(st.integers(0, 10_000), max_size=8))
    found = [record for piece in cut(sent, places) for record in reader.feed(piece)]
    assert found == records
    assert not faults


@st.composite
def damaged(draw, text):
    """A stream with bytes lost, changed, doubled, and lines merged; a whole record at its end."""
    sent = bytearray(b"".join(map(text.say, draw(st.lists(text.records(), min_size=1, max_size=5)))))
    for _ in range(draw(st.integers(1, 4))):
        at = draw(st.integers(0, len(sent)))
        length = draw(st.integers(0, 12))
        how = draw(st.sampled_from(["lose", "change", "double", "merge", "insert"]))
        if how == "lose":
            del sent[at : at + length]
        elif how == "change":
            sent[at : at + 1] = draw(st.binary(min_size=1, max_size=1))
        elif how == "double":
            sent[at:at] = sent[at : at + length]
        elif how == "merge":
            sent = sent.replace(b"\r\n", b"", 1)
        else:
            sent[at:at] = draw(st.binary(max_size=length))
    return bytes(sent)


@ALL
@settings(max_examples=20)
@given(data=st.data())
def test_nothing_is_taken_that_did_not_come_as_a_whole_line(text, data):
    sent = data.draw(damaged(text))
    records, _ = read(text.sketch, sent)
    for record in filter(None, records):
        whole = re.findall(rb"(?:^|(?<=\n))" + re.escape(text.say(record)), sent)
        assert records.count(record) <= len(whole)


@ALL
@settings(max_examples=20)
@given(data=st.data())
def test_the_reader_recovers_with_the_next_record(text, data):
    last = data.draw(text.records())
    records, _ = read(text.sketch, data.draw(damaged(text)) + b"\r\n" + text.say(last))
    assert records[-1] == last


@given(st.lists(st.integers(0, 3), min_size=2, max_size=60))
def test_equal_registers_are_never_accepted(values):
    faults = Counter()
    samples = SketchSamples(SKETCH["i2cdev-raw"], faults)
    block = samples.push([(0.1 * k, (v, 0, 0, 0, 0, 0)) for k, v in enumerate(values)])
    accepted = [v for before, v in zip([0, *values], values, strict=False) if v != before and v != 0]
    assert (block.accel_g[:, 0] * 16384).tolist() == accepted
    assert faults["frozen"] == len(values) - len(accepted)


@given(st.lists(st.tuples(st.integers(1, 3), st.integers(1, 50)), min_size=1, max_size=8))
def test_two_decimals_repeat_honestly_for_three_seconds_and_no_longer(runs):
    """Each run is a value that comes some times over, eight a second."""
    runs = [run for k, run in enumerate(runs) if k == 0 or run[0] != runs[k - 1][0]]
    stream, valid, last = [], [], len(runs) - 1
    for k, (value, times) in enumerate(runs):
        came = [(0.125 * (len(stream) + j), (float(value), 0.0, 0.0)) for j in range(times)]
        stream += came
        honest = times <= 25 and k != last
        valid += came if honest else came[:1]
    faults = Counter()
    samples = SketchSamples(SKETCH["mpu6050-light"], faults)
    taken = [samples.push([one]) for one in stream]
    times_s = np.concatenate([block.time_s for block in taken])
    np.testing.assert_array_equal(times_s, [time_s for time_s, _ in valid])


@pytest.mark.parametrize(
    ("declared", "names"),
    [
        ("bounds=(32768,) * 5, accel=(0, 1 / 16384)", "bounds"),
        ("bounds=(32768,) * 7, accel=(0, 1 / 16384)", "bounds"),
        ("bounds=(32768,) * 6, gyro=(3, 1 / 131)", "accel"),
        ("bounds=(32768,) * 6, accel=(4, 1 / 16384)", "accel"),
        ("bounds=(32768,) * 6, accel=(-1, 1 / 16384)", "accel"),
        ("bounds=(32768,) * 6, accel=(0, 1 / 16384), gyro=(5, 1 / 131)", "gyro"),
        ("bounds=(32768,) * 6, accel=(0, 1 / 16384), temperature=6", "temperature"),
        ("bounds=(32768,) * 6, angle=6", "angle"),
    ],
)
def test_a_dialect_whose_fields_do_not_fit_its_lines_is_refused_when_it_is_imported(
    tmp_path, monkeypatch, declared, names
):
    source = f"""
        from calrig.instruments.boards.sketch import Sketch, board_device, line_forms

        SKETCH = Sketch(
            driver="our-lab", source="our/lab", baudrate=9600, pace="", lines=line_forms("a/g:" + "\\t#" * 6),
            {declared},
        )
        DEVICE = board_device(SKETCH)
    """
    (tmp_path / "our_lab_dialect.py").write_text(dedent(source))
    monkeypatch.syspath_prepend(tmp_path)
    try:
        with pytest.raises(ValueError, match=f"'our-lab'.*{names}"):
            import_module("our_lab_dialect")
    finally:
        sys.modules.pop("our_lab_dialect", None)


def test_a_dialect_without_a_number_is_refused():
    with pytest.raises(ValueError, match=r"'silent'.*no number"):
        Sketch("silent", "our/lab", 9600, "", lines=line_forms("ready"), bounds=(), angle=0)
