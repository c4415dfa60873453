"""Names come in one order on every engine: that of their bytes, as SQLite has it."""

from __future__ import annotations

from sqlalchemy import create_engine, text

from calrig.store import Store
from calrig.store.raw_rows import TEXTS, tables

SERIALS = ["B", "a-1", "A 2", "Ä-1", "A-1", "_1", "a1", "z", "é", "温度", "10", "9"]


def test_names_come_in_the_order_of_their_bytes(store: Store) -> None:
    for serial in SERIALS:
        store.runs.create(unit=serial, rig=serial, plan=None, status="completed", provenance={})
        store.check_standards.name(serial, serial, 7.0)
    in_order = sorted(SERIALS, key=str.encode)
    assert [unit.serial for unit in store.units.all()] == in_order
    assert [check.rig for check in store.check_standards.all()] == in_order


def test_no_text_is_ordered_by_a_language(new_database) -> None:
    """A server's databases are made for one, mostly; that of these tests is for none."""
    engine = create_engine(new_database())
    known = "SELECT table_name, column_name FROM information_schema.columns WHERE collation_name = 'C'"
    with engine.connect() as connection:
        by_bytes = {tuple(row) for row in connection.execute(text(known))}
    engine.dispose()
    ours = {(t.name, c.name) for t in tables() for c in t.columns if isinstance(c.type, TEXTS)}
    assert ours <= by_bytes
