"""Virtual time and the ports that live in it: it moves on when everybody waits, and not before."""

from __future__ import annotations

import gc
import threading

import pytest
import serial
from virtual_time import virtual_rig
from virtual_time.clock import VirtualClock, Wait

from calrig.instruments.clock import WALL
from calrig.instruments.errors import PortError
from calrig.instruments.ports import clock_of, open_port
from calrig.simulator.config import SimulatorSettings


@pytest.fixture
def clock():
    clock = VirtualClock()
    with clock.taking_part():
        yield clock
        clock.stop()


def test_threads_go_on_in_the_order_of_their_times_however_long_those_are(clock):
    seen = []

    def nap(name, naps_s):
        for nap_s in naps_s:
            clock.sleep(nap_s)
            seen.append((name, clock.now_s() - began_s))

    began_s = clock.now_s()
    threads = [clock.thread(lambda a=a: nap(*a), a[0]) for a in (("a", [3000, 3000]), ("b", [1000, 4000]))]
    for thread in threads:
        thread.start()
    assert seen == [], "this thread has not waited yet"
    for thread in threads:
        thread.join()
    assert seen == [("b", 1000), ("a", 3000), ("b", 5000), ("a", 6000)]


def test_who_is_told_goes_on_at_that_instant_and_who_is_not_when_time_is_up(clock):
    news, told, ended = clock.condition(), [], []

    def listen():
        with news:
            ended.append((news.wait_for(lambda: "sent" in told, 10.0), clock.now_s() - began_s))
            ended.append((news.wait_for(lambda: "never" in told, 10.0), clock.now_s() - began_s))

    began_s = clock.now_s()
    listener = clock.thread(listen, "listener")
    listener.start()
    clock.sleep(4.0)
    with news:
        told.append("sent")
        news.notify_all()
    listener.join()
    assert ended == [(True, 4.0), (False, 14.0)]


def test_what_is_waited_for_in_vain_for_hours_takes_no_memory(clock):
    def kept():
        return sum(isinstance(one, Wait) for one in gc.get_objects())

    news, before = clock.condition(), kept()  # clocks of other tests have theirs
    with news:
        for _ in range(100):
            assert not news.wait_for(lambda: False, 60.0)
    assert kept() < before + 10


def test_a_thread_that_outlasts_a_join_is_waited_for_so_long_in_its_own_time(clock):
    sleeper = clock.thread(lambda: clock.sleep(100.0), "sleeper")
    began_s = clock.now_s()
    sleeper.start()
    sleeper.join(7.0)
    assert (clock.now_s() - began_s, sleeper.is_alive()) == (7.0, True)


def test_time_stands_where_something_is_first_seen(clock):
    seen = []

    def count():
        while True:
            clock.sleep(0.5)
            seen.append(clock.now_s())

    clock.thread(count, "counter").start()
    assert clock.until(lambda: seen if len(seen) == 3 else None, "third count") == seen
    threading.Event().wait(0.01)  # of the wall's time: nothing comes of it
    assert len(seen) == 3
    with pytest.raises(AssertionError, match="no hundredth count within 10 s"):
        clock.until(lambda: len(seen) == 100, "hundredth count", 10.0)


def test_what_only_time_brings_is_seen_as_well(clock):
    began_s = clock.now_s()
    assert clock.until(lambda: clock.now_s() >= began_s + 100.0, "moment")
    assert clock.now_s() - began_s == pytest.approx(100.0, abs=0.03)


def test_a_thread_from_outside_waits_for_members_without_being_one():
    clock = VirtualClock(most_speed=1e6)
    event = clock.event()

    def happen():
        clock.sleep(30.0)
        event.set()

    clock.thread(happen, "happens").start()
    assert event.wait(60.0)
    assert not clock.event().wait(5.0)


def test_no_faster_than_it_may_be_while_nobody_waits_for_it():
    clock = VirtualClock(most_speed=100.0)
    done = threading.Event()

    def work():
        clock.sleep(5.0)
        done.set()

    began_s = WALL.now_s()
    clock.thread(work, "work").start()
    assert done.wait(30.0)
    assert WALL.now_s() - began_s > 0.04


@pytest.fixture
def rig(clock):
    with virtual_rig(SimulatorSettings(), clock) as rig:
        yield rig


def test_a_port_brings_its_time_and_is_one_users_at_a_time(clock, rig):
    assert clock_of(rig.stage_port) is clock
    assert clock_of("/dev/ttyUSB0") is WALL is clock_of("socket://localhost:1")
    port = open_port(rig.stage_port, baudrate=57600, timeout_s=1.0)
    with pytest.raises(PortError, match="in use by another program"):
        open_port(rig.stage_port, baudrate=57600, timeout_s=1.0)
    began_s = clock.now_s()
    port.write(b"1TS\r\n")
    assert port.read(11) == b"1TS00000A\r\n"
    assert 0 < clock.now_s() - began_s < 0.01
    assert port.read(1) == b""
    assert clock.now_s() - began_s > 1.0
    port.close()
    open_port(rig.stage_port, baudrate=57600, timeout_s=1.0).close()


def test_a_device_that_is_pulled_out_is_gone_for_its_user_and_for_the_next(clock, rig):
    port = open_port(rig.stage_port, baudrate=57600, timeout_s=None)
    pulls = clock.thread(lambda: (clock.sleep(2.0), rig.stage_wire.stop()), "hand")
    pulls.start()
    with pytest.raises(PortError, match="went away while reading"):
        port.read(1)
    with pytest.raises(PortError, match="went away while writing"):
        port.write(b"1ST\r\n")
    port.close()
    with pytest.raises(PortError, match="does not exist"):
        open_port(rig.stage_port, baudrate=57600, timeout_s=1.0)
    rig.stage_wire.start()
    with serial.serial_for_url(rig.stage_port, timeout=1.0) as again:
        assert again.in_waiting == 0
