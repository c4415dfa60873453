"""What a centre's database has beside its tables: Procrastinate's schema, and triggers that tell of news.

A notification is a hint: whoever hears of it looks into the tables, which alone say what happened.
"""

from __future__ import annotations

from sqlalchemy import Connection, text

EVENTS, PARCELS = "calrig_event", "calrig_parcel"
COMMANDS, ANSWERS, BENCHES = "calrig_command", "calrig_answer", "calrig_bench"
"""Channels, each with what is told: a run's id, a bench's name, a bench's name, a command's number, a bench's
name.
"""

_NEWEST = "calrig_tell_bench_v1"
"""A function that is there once all of this is."""
_TRIGGERS = """
CREATE OR REPLACE FUNCTION calrig_tell_events_v1() RETURNS trigger LANGUAGE plpgsql AS $$
BEGIN
    PERFORM pg_notify('calrig_event', run.uid)
        FROM (SELECT DISTINCT run_id FROM new_rows) AS grown JOIN run ON run.id = grown.run_id;
    RETURN NULL;
END $$;
CREATE OR REPLACE FUNCTION calrig_tell_parcel_v1() RETURNS trigger LANGUAGE plpgsql AS $$
BEGIN PERFORM pg_notify('calrig_parcel', NEW.bench); RETURN NULL; END $$;
CREATE OR REPLACE FUNCTION calrig_tell_command_v1() RETURNS trigger LANGUAGE plpgsql AS $$
BEGIN PERFORM pg_notify('calrig_command', NEW.bench); RETURN NULL; END $$;
CREATE OR REPLACE FUNCTION calrig_tell_answer_v1() RETURNS trigger LANGUAGE plpgsql AS $$
BEGIN PERFORM pg_notify('calrig_answer', NEW.id::text); RETURN NULL; END $$;
CREATE OR REPLACE FUNCTION calrig_tell_bench_v1() RETURNS trigger LANGUAGE plpgsql AS $$
BEGIN PERFORM pg_notify('calrig_bench', NEW.name); RETURN NULL; END $$;

CREATE OR REPLACE TRIGGER calrig_tell AFTER INSERT ON event
    REFERENCING NEW TABLE AS new_rows FOR EACH STATEMENT EXECUTE FUNCTION calrig_tell_events_v1();
CREATE OR REPLACE TRIGGER calrig_tell AFTER INSERT ON parcel
    FOR EACH ROW EXECUTE FUNCTION calrig_tell_parcel_v1();
CREATE OR REPLACE TRIGGER calrig_tell AFTER INSERT ON bench_command
    FOR EACH ROW EXECUTE FUNCTION calrig_tell_command_v1();
CREATE OR REPLACE TRIGGER calrig_tell_answer AFTER UPDATE OF answered_at ON bench_command
    FOR EACH ROW EXECUTE FUNCTION calrig_tell_answer_v1();
CREATE OR REPLACE TRIGGER calrig_tell AFTER UPDATE OF said ON bench
    FOR EACH ROW WHEN (OLD.said::text IS DISTINCT FROM NEW.said::text)
    EXECUTE FUNCTION calrig_tell_bench_v1();
"""


def is_set_up(connection: Connection) -> bool:
    """Whether a database has all of this."""
    wanted = text("SELECT to_regclass('procrastinate_jobs') IS NOT NULL AND to_regproc(:newest) IS NOT NULL")
    return bool(connection.execute(wanted, {"newest": _NEWEST}).scalar_one())


def set_up(connection: Connection) -> None:
    """Gives it to a database, inside the transaction that the connection is in; what is there stays."""
    raw = connection.connection.driver_connection
    assert raw is not None  # noqa: S101 (it is in a transaction)
    has_queues = text("SELECT to_regclass('procrastinate_jobs') IS NOT NULL")
    if not connection.execute(has_queues).scalar_one():
        from procrastinate.schema import SchemaManager

        raw.execute(SchemaManager.get_schema())
    raw.execute(_TRIGGERS)
