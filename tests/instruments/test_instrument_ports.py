from __future__ import annotations

import errno
import socket
import threading
from types import SimpleNamespace

import pytest
import serial
from serial import rfc2217

from calrig.instruments.errors import PortError
from calrig.instruments.ports import open_port


@pytest.fixture
def server():
    listener = socket.create_server(("127.0.0.1", 0))
    yield listener
    listener.close()


def open_it(url):
    return open_port(url, baudrate=57600, timeout_s=0.2)


def url_of(listener):
    return f"socket://127.0.0.1:{listener.getsockname()[1]}"


def test_bytes_go_both_ways_over_a_pseudo_terminal_which_has_no_rts(wire):
    port = open_it(wire.path)
    wire.send(b"1TP0.5\r\n")
    assert port.read(8) == b"1TP0.5\r\n"
    port.write(b"1TP\r\n")
    assert wire.recv() == b"1TP\r\n"
    port.close()


def test_bytes_go_both_ways_over_a_socket(server):
    port = open_it(url_of(server))
    peer, _ = server.accept()
    peer.sendall(b"1TP0.5\r\n")
    assert port.read(8) == b"1TP0.5\r\n"
    port.write(b"1TP\r\n")
    assert peer.recv(100) == b"1TP\r\n"
    port.close()
    peer.close()


def test_a_missing_port_is_named_and_how_to_list_those_there_are():
    with pytest.raises(PortError, match=r"/dev/ttyNONE9 does not exist.*list_ports"):
        open_it("/dev/ttyNONE9")


def test_a_port_that_may_not_be_opened_names_the_group_to_join(monkeypatch):
    def refuse(*args, **kwargs):
        raise serial.SerialException(errno.EACCES, "could not open port: Permission denied")

    monkeypatch.setattr(serial, "serial_for_url", refuse)
    with pytest.raises(PortError, match=r"/dev/ttyUSB0 .*dialout"):
        open_it("/dev/ttyUSB0")


def test_a_port_opens_only_once(wire):
    first = open_it(wire.path)
    with pytest.raises(PortError, match="in use by another program"):
        open_it(wire.path)
    first.close()
    open_it(wire.path).close()


def test_a_refused_connection_asks_for_the_server(server):
    url = url_of(server)
    server.close()
    with pytest.raises(PortError, match=f"{url} refused the connection"):
        open_it(url)


@pytest.mark.parametrize("url", ["nosuch://x", "socket://127.0.0.1", "socket://127.0.0.1:99999", "", "a\0b"])
def test_what_is_no_port_is_a_port_error(url):
    with pytest.raises(PortError, match=r"^port "):
        open_it(url)


def test_a_file_that_is_no_tty_is_a_port_error(tmp_path):
    file = tmp_path / "not-a-tty"
    file.touch()
    with pytest.raises(PortError, match="cannot be opened"):
        open_it(str(file))


def test_a_cable_pulled_while_reading_and_writing_is_a_port_error(wire):
    port = open_it(wire.path)
    wire.vanish()
    with pytest.raises(PortError, match=f"{wire.path} went away while reading"):
        port.read(1)
    with pytest.raises(PortError, match=f"{wire.path} went away while writing"):
        port.write(b"x")
    port.close()


def test_a_server_that_hangs_up_is_a_port_error(server):
    port = open_it(url_of(server))
    server.accept()[0].close()
    with pytest.raises(PortError, match="went away while reading"):
        port.read(1)
    port.close()


def test_a_device_that_takes_nothing_ends_the_write(server):
    port = open_it(url_of(server))
    peer, _ = server.accept()
    with pytest.raises(PortError, match="took nothing"):
        port.write(bytes(50_000_000))
    port.close()
    peer.close()


class Leaping:
    """The wall's clock to a thread that waits a second for the processor wherever it looks at it."""

    def __init__(self):
        self.time_s = 0.0

    def now_s(self):
        self.time_s += 1.0
        return self.time_s


def test_a_port_that_takes_all_is_not_blamed_for_a_busy_machine(wire, server):
    for url in (wire.path, url_of(server)):
        port = open_it(url)
        port.clock = Leaping()
        port.write(b"1PA10\r\n")
        port.close()
    assert wire.recv() == b"1PA10\r\n"
    assert server.accept()[0].recv(100) == b"1PA10\r\n"


@pytest.mark.filterwarnings("ignore:set:DeprecationWarning:serial")
def test_bytes_go_both_ways_over_rfc2217(server):
    def serve_an_echo():
        connection, _ = server.accept()
        echo = serial.serial_for_url("loop://", timeout=0)
        with connection:
            manager = rfc2217.PortManager(echo, SimpleNamespace(write=connection.sendall))
            while data := connection.recv(1000):
                echo.write(b"".join(manager.filter(data)))
                connection.sendall(b"".join(manager.escape(echo.read(1000))))

    serving = threading.Thread(target=serve_an_echo, daemon=True)
    serving.start()
    port = open_it(url_of(server).replace("socket", "rfc2217"))
    port.write(b"1TP0.5\r\n")
    assert port.read(8) == b"1TP0.5\r\n"
    port.close()
    serving.join()
