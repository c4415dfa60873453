from __future__ import annotations

import importlib.util
import re
import threading
from contextlib import contextmanager

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from stage_ports import KINDS, InProcessPort, homed, moved_to, simulated, until_it_stands
from support import PATIENCE_S

from calrig.instruments import drivers
from calrig.instruments.clock import WallClock
from calrig.instruments.errors import Halted, InstrumentError, PortError, StageError
from calrig.instruments.stages.zaber import driver as zaber
from calrig.instruments.stages.zaber.driver import FLAGS, Zaber
from calrig.simulator.config import SimulatorSettings
from calrig.simulator.rig import SimulatedRig


def test_without_the_makers_library_it_says_what_to_install(monkeypatch):
    def missing(name):
        raise ImportError(f"No module named {name!r}")

    monkeypatch.setattr(zaber.importlib, "import_module", missing)
    with pytest.raises(InstrumentError, match=re.escape("pip install 'calrig[zaber]'")):
        drivers.open_stage("zaber", "/dev/null")


needs_library = pytest.mark.skipif(
    importlib.util.find_spec("zaber_motion") is None,
    reason="the maker's library is not installed: pip install 'calrig[zaber]'",
)


class LibraryTime(WallClock):
    """The wall's, which the maker's library goes by; its threads read the port all the time."""

    def sleep(self, duration_s):
        super().sleep(0.0005)


LIBRARY_TIME = LibraryTime()


class Script:
    """A controller at address 1, written from the maker's protocol: numbered requests, checksums."""

    def __init__(self):
        self.values = {
            "pos": "64000", "limit.cycle.dist": "2304000", "limit.min": "-640000", "limit.max": "1280000",
            "maxspeed": "209715", "accel": "84", "version": "7.35",
        }  # fmt: skip
        self.status = "IDLE"
        self.flags: list[str] = []
        self.refuse: dict[str, str] = {}
        self.commands: list[str] = []
        self.silent = False

    def receive(self, data: bytes) -> bytes:
        return b"".join(self._answer(line) for line in data.decode().split("\n") if line)

    def emit(self) -> bytes:
        return b""

    def _answer(self, line: str) -> bytes:
        _head, _, number, command = re.fullmatch(r"/(1 1)( (\d\d) ?)?([^:]*?)(?::..)?", line).groups()
        command = command.strip()
        self.commands.append(command)
        if self.silent:
            return b""
        name = command.removeprefix("get ")
        data = self.values.get(name, "0") if command.startswith("get ") else "0"
        if command.startswith("warnings"):
            data = " ".join([f"{len(self.flags):02d}", *self.flags])
        flag = "OK"
        if command in self.refuse:
            flag, data = "RJ", self.refuse[command]
        warning = self.flags[0] if self.flags else "--"
        reply = f"01 1 {number} {flag} {self.status} {warning} {data}" if number else f"01 1 {flag} IDLE -- 0"
        return (f"@{reply}" + (f":{-sum(reply.encode()) & 255:02X}" if number else "") + "\r\n").encode()


@pytest.fixture(autouse=True)
def patience(monkeypatch):
    """For answers that come, by the wall's time, however busy the machine is."""
    monkeypatch.setattr(zaber, "REPLY_TIMEOUT_S", PATIENCE_S)
    monkeypatch.setattr(zaber, "LISTEN_S", 0.02)


@contextmanager
def short_patience():
    """For answers that do not come."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(zaber, "REPLY_TIMEOUT_S", 0.05)
        yield


@pytest.fixture
def controller():
    return Script()


@pytest.fixture
def port(controller):
    return InProcessPort(controller, clock=LIBRARY_TIME)


@pytest.fixture
def stage(port):
    driver = Zaber(port)
    yield driver
    driver.close()


@needs_library
def test_a_library_that_does_not_end_keeps_nobody_from_closing_the_stage(stage, port, monkeypatch):
    ended = threading.Event()
    with monkeypatch.context() as patch:
        patch.setattr(zaber, "CLOSE_S", 0.01)
        patch.setattr(stage._connection, "close", ended.wait)
        stage.close()
        assert port.closed
    ended.set()


@needs_library
def test_it_says_who_it_is_and_what_it_allows_in_degrees(controller, stage):
    identity = stage.identify()
    assert (identity.driver, identity.firmware, identity.limits_deg) == ("zaber", "7.35", (-100.0, 200.0))
    assert identity.velocity_dps == pytest.approx(20.0, rel=1e-4)  # 128000 microsteps per second
    assert identity.acceleration_dps2 == pytest.approx(80.1, rel=1e-3)
    assert stage.position_deg() == 10.0
    assert not [command for command in controller.commands if re.match("move|home|set|stop", command)]


@needs_library
def test_a_linear_stage_is_refused(controller, stage):
    controller.values["limit.cycle.dist"] = "0"
    with pytest.raises(StageError, match="no rotary stage"):
        stage.identify()


@needs_library
@pytest.mark.parametrize("flag", sorted({*FLAGS} - {"FF"}))
def test_every_flag_is_said_in_words(controller, stage, flag):
    controller.flags = [flag]
    status = stage.status()
    assert FLAGS[flag] in status.words
    expected = {"F": "disabled"}.get(flag[0], "not_referenced" if flag in {"WR", "WH"} else "ready")
    assert status.state == expected


@needs_library
def test_a_critical_error_is_said_in_the_makers_words(controller, stage):
    controller.flags = ["FF"]
    with pytest.raises(StageError, match="Critical System Error"):
        stage.status()


@needs_library
def test_it_moves_in_microsteps_at_the_velocity_set(controller, stage):
    stage.set_velocity(10)
    stage.move(-30.5)
    assert controller.commands[-2:] == ["set maxspeed 104858", "move abs -195200"]
    controller.status = "BUSY"
    assert stage.status().state == "moving"


@needs_library
def test_homing_is_sent_once_even_if_its_answer_is_lost(controller, port, stage):
    port.damages = ["lost"]
    with pytest.raises(StageError, match="does not answer home"), short_patience():
        stage.home()
    assert controller.commands.count("home") == 1


@needs_library
def test_a_homing_whose_answer_is_lost_is_known_by_its_motion(controller, port, stage):
    port.damages, controller.status = ["lost"], "BUSY"
    with short_patience():
        stage.home()
    assert controller.commands.count("home") == 1
    assert stage.status().state == "homing"


@needs_library
@pytest.mark.parametrize(
    ("reason", "words"),
    [("BADDATA", "out of range"), ("BADCOMMAND", "incorrect"), ("DRIVERDISABLED", "disabled")],
)
def test_a_refused_move_is_refused_in_the_makers_words(controller, stage, reason, words):
    controller.refuse = {"move abs 64000": reason}
    with pytest.raises(StageError, match=f"refused move abs 64000: .*{reason}.*{words}"):
        stage.move(10)


@needs_library
def test_no_motion_follows_a_stop(controller, port, stage):
    stage.move(10)
    stage.halt()
    assert port.sent.endswith(b"/1 1 stop\n")
    with pytest.raises(Halted, match="move abs 128000 was not sent"):
        stage.move(20)
    with pytest.raises(Halted, match="home was not sent"):
        stage.home()
    assert controller.commands[-1] == "stop"


@needs_library
def test_a_silent_controller_fails_in_words_and_answers_again(controller, port, stage):
    controller.silent = True
    silence = f"address 1 on {port.name} does not answer warnings .*check power"
    with pytest.raises(StageError, match=silence), short_patience():
        stage.status()
    controller.silent = False
    assert stage.status().state == "ready"


@needs_library
def test_a_port_that_goes_away_is_a_port_error(port, stage, monkeypatch):
    def gone():
        raise PortError("port test-port went away while reading")

    stage.status()
    monkeypatch.setattr(zaber, "REPLY_TIMEOUT_S", 1.0)  # who asks at that moment may get no answer
    monkeypatch.setattr(port, "read_some", gone)
    with pytest.raises(PortError, match="went away"):
        for _ in range(50):
            stage.status()


@needs_library
@given(
    damages=st.lists(st.sampled_from(KINDS), max_size=6),
    microsteps=st.integers(-600_000, 1_200_000),
)
@settings(max_examples=15, deadline=None)
def test_no_damage_is_taken_for_a_place_and_the_next_command_is_answered(damages, microsteps):
    script = Script()
    script.values["pos"] = str(microsteps)
    port = InProcessPort(script, clock=LIBRARY_TIME)
    stage = Zaber(port)
    stage.identify()
    port.damages = list(damages)
    try:
        with short_patience():
            assert stage.position_deg() == microsteps / 6400
            assert stage.status().state == "ready"
    except StageError as error:
        assert "does not answer" in str(error)
    port.damages = []
    assert stage.position_deg() == microsteps / 6400
    stage.close()


@needs_library
def test_a_reply_whose_checksum_does_not_hold_is_dropped_and_counted(port, stage):
    reply = "01 1 00 OK IDLE -- 65000"
    port.push(f"@{reply}:{(1 - sum(reply.encode())) & 255:02X}\r\n".encode())
    assert stage.glimpse_deg() == 10.0
    assert stage.faults["crc"] == 1


@needs_library
def test_a_simulated_one_homes_moves_and_stops():
    stage = Zaber(simulated("zaber", clock=LIBRARY_TIME))
    assert stage.status().state == "not_referenced"
    homed(stage)
    assert moved_to(stage, -30.5).position_deg() == pytest.approx(-30.5, abs=1e-3)
    stage.move(170)
    stage.halt()
    assert until_it_stands(stage) == "ready"
    assert stage.position_deg() < 170
    stage.close()


@needs_library
def test_a_simulated_one_that_is_blocked_says_so():
    stage = homed(Zaber(simulated("zaber", clock=LIBRARY_TIME, mechanics={"obstruction_deg": 30.0})))
    stage.move(60)
    assert until_it_stands(stage) == "disabled"
    assert "stalled" in stage.status().words
    stage.close()


@needs_library
def test_over_a_socket_it_is_the_same():
    options = {"time_scale": 100, "ports": "tcp", "stage": {"driver": "zaber"}}
    with SimulatedRig(SimulatorSettings.from_options(options)) as rig:
        stage = homed(drivers.open_stage("zaber", rig.stage_port))
        assert moved_to(stage, 12.5).position_deg() == pytest.approx(12.5, abs=1e-3)
        stage.close()
