"""The whole rig over real ports and as a process of its own; and what its `simulated` table may say."""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
import time

import numpy as np
import psutil
import pytest
import serial
from simulated_packets import Packet, decode
from support import PATIENCE_S, program

from calrig.simulator import wire
from calrig.simulator.config import SimulatorSettings
from calrig.simulator.launch import launch
from calrig.simulator.rig import SimulatedRig

KINDS = [
    pytest.param("pty", marks=pytest.mark.skipif(not wire.PTY_AVAILABLE, reason="no pseudo-terminals here")),
    "tcp",
]


def rig(now_s=time.monotonic, **options) -> SimulatedRig:
    settings = SimulatorSettings.from_options({"preset": "ideal", "time_scale": 20.0} | options)
    return SimulatedRig(settings, now_s=now_s)


class HandClock:
    """Stands until it is moved on."""

    def __init__(self) -> None:
        self.at_s = 0.0

    def __call__(self) -> float:
        return self.at_s


def ask(stage: serial.SerialBase, command: str) -> str:
    stage.write(command.encode() + b"\r\n")
    return stage.read_until(b"\r\n").decode().removesuffix("\r\n")


def wait_for(stage: serial.SerialBase, status: str) -> None:
    deadline = time.monotonic() + PATIENCE_S
    while (last := ask(stage, "1TS")) != status:
        assert time.monotonic() < deadline, last


def read_packet(board: serial.SerialBase) -> Packet:
    return decode(board.read_until(b"\0"))[0]


def read_samples(board: serial.SerialBase, n: int) -> list[tuple[int, ...]]:
    """The first n samples, read in large pieces as a driver does."""
    samples: list[tuple[int, ...]] = []
    tail = b""
    while len(samples) < n:
        piece = board.read(max(1, board.in_waiting))
        assert piece, f"silent after {len(samples)} samples"
        whole, end, tail = (tail + piece).rpartition(b"\0")
        samples += [packet.sample for packet in decode(whole + end) if packet.kind == 0x02]
    return samples[:n]


def open_port(url: str, baudrate: int) -> serial.SerialBase:
    """Locked, as calrig's own are: a service whose rig had this terminal's name before may yet stop it."""
    locked = {} if "://" in url else {"exclusive": True}
    return serial.serial_for_url(url, baudrate=baudrate, timeout=PATIENCE_S, **locked)


def open_stage(url: str) -> serial.SerialBase:
    return open_port(url, 57600)


def open_board(url: str) -> serial.SerialBase:
    return open_port(url, 115200)


@pytest.mark.parametrize("kind", KINDS)
def test_a_pose_from_homing_to_reading_over_the_wire(kind):
    """In time that the test moves on: what is sent when, no busy machine changes."""
    wall = HandClock()
    with (
        rig(wall, ports=kind) as simulated,
        open_stage(simulated.stage_port) as stage,
        open_board(simulated.imu_port) as board,
    ):
        assert ask(stage, "1TS") == "1TS00000A"
        stage.write(b"1OR\r\n")
        assert ask(stage, "1TS") == "1TS00001E"
        wall.at_s += 3.0
        assert ask(stage, "1TS") == "1TS000032"
        stage.write(b"1PA-30\r\n")
        assert ask(stage, "1TS") == "1TS000028"
        wall.at_s += 1.0
        assert ask(stage, "1TS") == "1TS000033"
        assert ask(stage, "1TP") == "1TP-30"

        board.write(b"START 200\n")
        while read_packet(board) != Packet(0x04, b"START 200"):
            pass  # the identity it said at power-up, unless the port was opened after that
        wall.at_s += 0.05
        samples = read_samples(board, 200)
        assert [sample[0] for sample in samples] == list(range(200))
        assert np.degrees(np.arctan2(samples[-1][3], samples[-1][4])) == pytest.approx(-30.0, abs=0.01)


@pytest.mark.parametrize("kind", KINDS)
def test_both_ports_can_be_closed_and_opened_again(kind):
    with rig(ports=kind) as simulated:
        for _ in range(2):
            with open_stage(simulated.stage_port) as stage, open_board(simulated.imu_port) as board:
                assert ask(stage, "1VE") == "1VE SMC100CC simulated"
                board.write(b"START 100\n")
                board.read_until(b"\0")  # closed while it is still sending


def test_a_board_that_nobody_reads_does_not_hold_up_the_stage():
    with (
        rig(time_scale=100.0) as simulated,
        open_stage(simulated.stage_port) as stage,
        open_board(simulated.imu_port) as board,
    ):
        board.write(b"START 1000\n")
        deadline = time.monotonic() + PATIENCE_S
        while simulated.clock() < 30.0:  # 30 000 samples, ten times what the port holds
            assert ask(stage, "1TS") == "1TS00000A"
            assert time.monotonic() < deadline


def test_time_runs_at_its_scale_on_the_boards_own_clock():
    with rig(time_scale=50.0) as simulated, open_board(simulated.imu_port) as board:
        started_s = time.monotonic()
        board.write(b"START 200\n")
        samples = read_samples(board, 5000)
        took_s = time.monotonic() - started_s
        passed_s = (samples[-1][1] - samples[0][1]) / 1e6
        assert passed_s == pytest.approx((samples[-1][0] - samples[0][0]) / 200)
        assert took_s > passed_s / 50  # never ahead; how far behind, or lost, is the machine's business


def test_the_bench_behind_the_ports_knows_the_truth():
    with rig(mount={"offset_deg": 0.8}) as simulated, open_stage(simulated.stage_port) as stage:
        stage.write(b"1OR\r\n")
        wait_for(stage, "1TS000032")
        with simulated.bench.lock:
            truth_deg = simulated.bench.sensor(np.array([simulated.clock()])).angle_deg
        assert truth_deg == pytest.approx([0.8])


def test_stopping_twice_is_no_error_and_closes_the_ports():
    simulated = rig(ports="tcp")
    simulated.start()
    simulated.stop()
    simulated.stop()
    host, port = simulated.stage_port.removeprefix("socket://").split(":")
    with pytest.raises(ConnectionRefusedError):
        socket.create_connection((host, int(port)), timeout=PATIENCE_S)


def test_a_launched_rig_answers_and_ends_when_stopped():
    with launch({"preset": "demo", "time_scale": 50}) as process:
        assert process.time_scale == 50.0  # which the form on the page reckons with until a run has told
        with open_stage(process.stage_port) as stage, open_board(process.imu_port) as board:
            assert ask(stage, "1TS") == "1TS00000A"
            board.write(b"ID\n")
            assert json.loads(read_packet(board).text)["serial"] == ""
        assert psutil.pid_exists(process.pid)
    assert not psutil.pid_exists(process.pid)


def test_a_rig_process_ends_with_its_standard_input():
    with program(sys.executable, "-m", "calrig.simulator", "{}", stdin=subprocess.PIPE) as process:
        assert set(json.loads(process.stdout.readline())) == {"stage", "imu"}
        process.stdin.close()
        assert process.wait(PATIENCE_S) == 0


@pytest.mark.skipif(os.name == "nt", reason="no SIGTERM here")
def test_a_rig_process_ends_when_terminated():
    with launch({}) as process:
        os.kill(process.pid, signal.SIGTERM)
        assert psutil.wait_procs([psutil.Process(process.pid)], timeout=PATIENCE_S)[1] == []


def test_a_wrong_option_is_said_before_anything_starts():
    with pytest.raises(ValueError, match=r"mount\.offset: no such option; did you mean offset_deg\?"):
        launch({"mount": {"offset": 1}})


@pytest.mark.parametrize("options", ['{"seed": -1}', "[]", "{"])
def test_a_process_with_wrong_options_says_so_in_one_line(options):
    ended = subprocess.run(
        [sys.executable, "-m", "calrig.simulator", options],
        check=False,
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
    )
    assert (ended.returncode, ended.stdout) == (2, "")
    assert ended.stderr.startswith("simulated rig: ")
    assert ended.stderr.count("\n") == 1


def test_launching_needs_no_arrays_in_the_service():
    code = "import sys, calrig.simulator.launch; sys.exit('numpy' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False, timeout=PATIENCE_S).returncode == 0


def test_nothing_asked_is_an_mpu_6050_on_a_perfect_stage():
    settings = SimulatorSettings.from_options({})
    assert settings.imu.accel_noise_ug_per_rthz == 400.0
    assert settings.imu.gyro_noise_dps_per_rthz == 0.005
    assert settings.mechanics.backlash_deg == settings.mount.offset_deg == 0.0


def test_options_go_over_those_of_the_preset_one_by_one():
    demo = SimulatorSettings.from_options({"preset": "demo"})
    changed = SimulatorSettings.from_options(
        {"preset": "demo", "seed": 3, "mechanics": {"backlash_deg": 0.0}}
    )
    assert demo.mechanics.backlash_deg == 0.12
    assert changed.mechanics == demo.mechanics.model_copy(update={"backlash_deg": 0.0})
    assert changed.imu == demo.imu
    assert changed.seed == 3


def test_the_demo_board_names_no_serial_and_streams_at_200_hz():
    board = SimulatorSettings.from_options({"preset": "demo"}).board
    assert (board.serial, board.default_rate_hz) == ("", 200)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"preset": "dmeo"}, "preset: 'dmeo' is unknown; there are demo, ideal"),
        ({"preset": ["demo"]}, "preset: ['demo'] is unknown"),
        ({"mechanics": {"backlash": 1}}, "mechanics.backlash: no such option; did you mean backlash_deg?"),
        ({"sede": 1}, "sede: no such option; did you mean seed?"),
        ({"time_scale": 0}, "time_scale: Input should be greater than 0"),
        ({"imu": {"accel_bias_mg": [1, 2]}}, "imu.accel_bias_mg"),
        ({"imu": {"accel_range_g": 3}}, "imu.accel_range_g"),
        ({"imu": {"accel_cross_axis_deg": {"xx": 1}}}, "imu.accel_cross_axis_deg.xx"),
        ({"mechanics": "much"}, "mechanics"),
        ({"mechanics": {"worm_deg": 3}}, "mechanics: worm_deg is so large"),
        ({"mechanics": {"vibration_direction": [0, 0, 0]}}, "mechanics: vibration_direction is 0, 0, 0"),
        ({"imu": {"dlpf_cfg": 7}}, "imu.dlpf_cfg: Input should be less than or equal to 6"),
        ({"environment": {"start_c": float("nan")}}, "environment.start_c"),
        ({"board": {"default_rate_hz": 2000}}, "board: default_rate_hz is above max_rate_hz"),
    ],
)
def test_a_slip_is_named_by_its_key(options, said):
    with pytest.raises(ValueError) as refused:
        SimulatorSettings.from_options(options)
    assert said in str(refused.value)
    assert "\n" not in str(refused.value)
