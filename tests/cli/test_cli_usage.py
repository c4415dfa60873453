"""Exit statuses: wrong usage is 2, work that fails is 1, and an error of calrig's own is neither."""

from __future__ import annotations

import errno
import importlib
import os
import re
import socket
import sys
from types import ModuleType

import pytest
from command_line import calrig, reason

from calrig.cli import start
from calrig.cli.exit_status import STATUS


def test_version():
    assert re.fullmatch(r"calrig \d+\.\d+\.\d+\n", calrig("--version").stdout)


@pytest.mark.parametrize("group", [[], ["users"], ["bench"], ["agent"]])
def test_a_list_of_commands_cuts_no_summary(group):
    listed = calrig(*group, "--help").stdout.partition("Commands:")[2]
    assert listed.strip()
    assert "..." not in listed
    assert max(len(line) for line in listed.splitlines()) <= 80


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        pytest.param(["frobnicate"], "frobnicate", id="no such command"),
        pytest.param(["run"], "--unit", id="no unit"),
        pytest.param(["run", "--unitt", "A"], "--unitt", id="no such option"),
        pytest.param(["serve", "--port", "70000"], "--port", id="no such port"),
        pytest.param(["export", "1", "--format", "xml"], "xml", id="no such format"),
        pytest.param(["export", "1", "--db", "mysql://host/db"], "a store is a SQLite file", id="no store"),
    ],
)
def test_wrong_usage_is_2_and_says_what_is_wrong(arguments, words):
    done = calrig(*arguments, status=2)
    assert words in done.stderr
    assert done.stdout == ""


@pytest.mark.parametrize("name", STATUS)
def test_each_error_that_has_a_status_is_one_that_can_be_raised(name):
    module, _, kind = name.rpartition(".")
    assert issubclass(getattr(importlib.import_module(module), kind), Exception)


def test_ctrl_c_is_1_and_says_so_and_a_defect_is_not_hidden(folder, monkeypatch):
    def interrupted(_):
        raise KeyboardInterrupt

    monkeypatch.setattr("calrig.settings.load_settings", interrupted)
    assert reason("rigs", status=1) == "calrig: interrupted"

    def full(_):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr("calrig.settings.load_settings", full)
    assert reason("rigs", status=1) == "calrig: standard output takes no more (No space left on device)"

    def defective(_):
        raise ZeroDivisionError("of calrig's own")

    monkeypatch.setattr("calrig.settings.load_settings", defective)
    with pytest.raises(ZeroDivisionError):
        calrig("rigs")


def test_ctrl_c_while_the_program_is_loaded_is_1_in_one_line(monkeypatch):
    class Interrupted(ModuleType):
        def __getattr__(self, name):
            raise KeyboardInterrupt

    monkeypatch.setitem(sys.modules, "calrig.cli.main", Interrupted("main"))
    with pytest.raises(SystemExit, match="calrig: interrupted"):
        start.main()


def test_a_port_in_use_is_1_and_says_which_and_what_to_do(folder):
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        said = reason("serve", "--port", port, status=1)
    assert f"127.0.0.1:{port} is in use" in said
    assert "--port" in said


def test_an_unknown_log_format_is_2(folder):
    assert "there is no log format 'xml'" in reason("serve", "--log-format", "xml", status=2)
