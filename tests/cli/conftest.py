from __future__ import annotations

import pytest
from command_line import POSES, RIG
from empty_store import lay_empty_store


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """Where commands are run: with poses, an empty store, and a configuration whose rig is not plugged in."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("CALRIG_DB", str(tmp_path / "calrig.db"))
    monkeypatch.setenv("COLUMNS", "200")
    lay_empty_store(tmp_path / "calrig.db")
    (tmp_path / "calrig.toml").write_text(RIG)
    (tmp_path / "poses.csv").write_text(POSES)
    return tmp_path
