"""Transcripts: what went over a wire is written down, and is had again from the file."""

from __future__ import annotations

import io

import pytest
from support import running_service, serving

from calrig.instruments.drivers import open_board, open_stage
from calrig.instruments.errors import InstrumentError, PortError
from calrig.instruments.ports import open_port
from calrig.instruments.stages.smc100 import driver
from calrig.instruments.transcript import KEPT_BYTES, Tape, read_transcript, taped
from calrig.plan import Plan


def test_a_stage_says_the_same_again_from_its_transcript(rig, tmp_path, monkeypatch):
    with taped(tmp_path / "tapes") as tapes:
        stage = open_stage(rig.stage.driver, rig.stage.port)
        identity, position_deg = stage.identify(), stage.position_deg()
        stage.close()
    (file,) = (tmp_path / "tapes").iterdir()
    assert rig.stage.port in tapes.all[0].last_minute().splitlines()[0]

    monkeypatch.setattr(driver, "REPLY_TIMEOUT_S", 0.05)  # a transcript has the wall's time
    again = open_stage(rig.stage.driver, f"replay://{file}")
    assert again.identify() == identity
    assert [again.position_deg() for _ in range(3)] == [position_deg] * 3, "asked oftener than it was then"
    with pytest.raises(InstrumentError, match="does not answer"):
        again.set_velocity(3.0)  # was never sent
    again.close()


def test_a_boards_stream_is_decoded_again_to_the_same_samples(rig, tmp_path):
    with taped(tmp_path / "tapes"):
        board = open_board(rig.imu.driver, rig.imu.port)
        board.identify()
        board.start(200)
        while len(first := board.take(1.0)) == 0:
            pass
        board.stop()
        board.close()
    (file,) = (tmp_path / "tapes").iterdir()

    again = open_board(rig.imu.driver, f"replay://{file}")
    again.identify()
    again.start(200)
    samples = again.take(1.0)
    again.close()
    assert samples.accel_g[: len(first)].tolist() == first.accel_g.tolist()


def test_a_failed_run_keeps_the_last_minute_of_each_wire(launch_rig, tmp_path):
    rig = launch_rig("dumb-stage", stage={"fault": "garbage"})
    with running_service(tmp_path / "calrig.db", rig) as service:
        failed = service.wait(service.start(unit="AS-1", plan=Plan()).id, 30)
        assert failed.status == "failed"
        kept = service.store.events.transcripts(failed.id)
        with serving(service) as client:
            told = client.get(f"/api/runs/{failed.id}/transcript").text
    assert list(kept) == [rig.stage.port, rig.imu.port]
    assert {piece.direction for piece in read_transcript(kept[rig.stage.port].splitlines())} == {"<", ">"}
    assert told == "".join(kept.values())


def test_the_memory_of_a_tape_is_bounded():
    tape = Tape("a port")
    for _ in range(9):
        tape.note("<", bytes(KEPT_BYTES // 4))
    assert sum(len(piece.data) for piece in read_transcript(io.StringIO(tape.last_minute()))) == KEPT_BYTES


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("0.0 > zz\n", "line 1"),
        ("0.0 < 00\nhello\n", "line 2"),
        ("0.0 x 00\n", "line 1"),
        (None, "No such file"),
    ],
)
def test_what_is_no_transcript_is_said_to_be_none(tmp_path, text, reason):
    file = tmp_path / "wire.txt"
    if text is not None:
        file.write_text(text)
    with pytest.raises(PortError, match=reason):
        open_port(f"replay://{file}", baudrate=9600, timeout_s=0.1)


@pytest.mark.parametrize(
    "port", ["../../evil", "/dev/ttyUSB0", "socket://h:1/..\\x", "a\n0.5 > 00", "x" * 500, "\x00"]
)
def test_a_transcript_lies_in_its_folder_whatever_the_port_is_called(tmp_path, port):
    with taped(tmp_path / "record") as tapes:
        tape = tapes.of(port)
        tape.note(">", b"1TS\r\n")
    (file,) = (tmp_path / "record").iterdir()
    assert file.is_file()
    (piece,) = read_transcript(file.read_text().splitlines())
    assert piece.data == b"1TS\r\n"
    assert len(read_transcript(tape.last_minute().splitlines())) == 1
