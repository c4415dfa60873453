"""Set up a centre's database beside its tables: notification triggers, rights of benches.

A notification is a hint; the tables are authoritative. Each bench has a role in one group that holds the
rights, granted by column. A row-level policy of each table shows a bench only its own rows. The centre's role
owns the tables and is exempt from the policies.
"""

import hashlib
import secrets
from dataclasses import dataclass
from ipaddress import ip_address

from psycopg import sql
from sqlalchemy import URL, Connection, text

from calrig.store.bench_tables import PROTOCOL
from calrig.store.database import revisions
from calrig.store.errors import Refused
from calrig.store.postgresql.connection import driver_of

EVENTS, PARCELS = "calrig_event", "calrig_parcel"
COMMANDS, ANSWERS, BENCHES = "calrig_command", "calrig_answer", "calrig_bench"
ORDERS = "calrig_order"
"""Channels, each with what is told: a run's id, a bench's name, a bench's name, a command's number, a bench's
name, a bench's name.
"""

_NEWEST = "calrig_tell_order_v1"
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
CREATE OR REPLACE FUNCTION calrig_tell_order_v1() RETURNS trigger LANGUAGE plpgsql AS $$
BEGIN PERFORM pg_notify('calrig_order', NEW.bench); RETURN NULL; END $$;

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
CREATE OR REPLACE TRIGGER calrig_tell AFTER INSERT OR UPDATE OF epoch ON run_order
    FOR EACH ROW EXECUTE FUNCTION calrig_tell_order_v1();
"""
_NO_QUEUES = """
DO $$
DECLARE left_over text;
BEGIN
    DROP TABLE IF EXISTS procrastinate_periodic_defers, procrastinate_events, procrastinate_jobs,
        procrastinate_workers CASCADE;
    FOR left_over IN SELECT oid::regprocedure FROM pg_proc
        WHERE starts_with(proname, 'procrastinate_') AND pronamespace = current_schema()::regnamespace
    LOOP EXECUTE 'DROP ROUTINE IF EXISTS ' || left_over || ' CASCADE'; END LOOP;
    FOR left_over IN SELECT oid::regtype FROM pg_type
        WHERE starts_with(typname, 'procrastinate_') AND typnamespace = current_schema()::regnamespace
    LOOP EXECUTE 'DROP TYPE IF EXISTS ' || left_over || ' CASCADE'; END LOOP;
END $$;
"""
"""Earlier versions announced orders by jobs of Procrastinate, beside the notification that does it now."""


def is_set_up(connection: Connection) -> bool:
    """Whether a database has all of this."""
    wanted = text("SELECT to_regproc(:newest) IS NOT NULL")
    return bool(connection.execute(wanted, {"newest": _NEWEST}).scalar_one())


_OF_BENCHES = (
    "procrastinate_jobs", "procrastinate_workers", "procrastinate_events", "procrastinate_periodic_defers",
    "run_order", "bench_command", "parcel", "bench",
)  # fmt: skip
"""Tables that benches are at work in, those of earlier versions too. Each of their statements asks in the end
which bench it is: so `bench` comes last.
"""


def keep_benches_out(connection: Connection) -> None:
    """Waits for the statements that benches are in, and lets them begin no other one until this is over."""
    is_there = text("SELECT to_regclass(:table) IS NOT NULL")
    tables = [one for one in _OF_BENCHES if connection.scalar(is_there, {"table": one})]
    if tables:
        connection.exec_driver_sql(f"LOCK TABLE {', '.join(tables)} IN ACCESS EXCLUSIVE MODE")


def set_up(connection: Connection) -> None:
    """Gives it to a database, inside the transaction that the connection is in; what is there stays."""
    raw = driver_of(connection)
    raw.execute(_NO_QUEUES)
    raw.execute(_TRIGGERS)


GROUP = "calrig_bench"
MOST_CONNECTIONS = 20
"""Of one bench at once: its links, and those that a lost one left. One gone wild leaves room for others."""
END_MS = 5000
"""How long the end of a connection is waited for."""

MY_BENCH = """
    CREATE OR REPLACE FUNCTION calrig_my_bench() RETURNS text
    LANGUAGE sql STABLE SECURITY DEFINER SET search_path = {schema}, pg_temp
    AS 'SELECT name FROM bench WHERE role = session_user AND revoked_at IS NULL'
"""
"""The bench whose role is logged in, null of everybody else's. It looks into `bench` as the owner, whose
policies would ask it again; `session_user` stays that of the login, whatever role is set since.
"""
JUDGE_BENCH = f"""
    CREATE OR REPLACE FUNCTION calrig_judge_bench() RETURNS trigger
    LANGUAGE plpgsql SECURITY DEFINER SET search_path = {{schema}}, pg_temp AS $$
    DECLARE
        spoken text := coalesce(substring(NEW.said ->> 'protocol' FROM '^[0-9]{{{{1,9}}}}$'), '1');
        shaped text := coalesce(substring(NEW.said ->> 'schema_revision' FROM '^[0-9]{{{{4}}}}$'), '0000');
        versions text := '(protocol ' || spoken || ', schema ' || shaped
            || ' instead of {PROTOCOL}, {{revision}})';
        mine jsonb := jsonb_path_query_array(NEW.said::jsonb, '$.rigs[*].name');
        twin record;
    BEGIN
        SELECT other.name, rig INTO twin
          FROM bench AS other, jsonb_array_elements_text(mine) AS rig
         WHERE other.name <> NEW.name AND other.revoked_at IS NULL AND other.bears::jsonb ? rig
           AND (NOT coalesce(OLD.bears::jsonb ? rig, false)
                OR (coalesce(other.enrolled_at, ''), other.name) < (coalesce(NEW.enrolled_at, ''), NEW.name))
         LIMIT 1;
        NEW.bears := CASE WHEN twin IS NULL THEN mine::text END;
        NEW.refused := CASE
            WHEN (spoken::int, shaped) < ({PROTOCOL}, '{{revision}}') THEN
                'its calrig is too old for the centre ' || versions
                || ': install the centre''s version on the bench'
            WHEN (spoken::int, shaped) > ({PROTOCOL}, '{{revision}}') THEN
                'its calrig is too new for the centre ' || versions || ': upgrade the centre'
            WHEN twin IS NOT NULL THEN
                'bench ' || twin.name || ' has a rig ' || quote_literal(twin.rig) || ' already: give the '
                'rigs names of their own in calrig.toml, or revoke the other bench'
            END;
        RETURN NEW;
    END $$
"""  # noqa: S608 (a number of our own)
"""Says with each report of a bench why it takes no orders: for its version, or for a rig whose name another
bench bears, which came first. Those names are read from what this has written: no report can spoil another's.
"""
_MINE = "(SELECT calrig_my_bench())"  # in brackets it is asked once a statement, and not once a row


@dataclass(frozen=True, slots=True)
class _Rights:
    """What the group may do with a table, of the rows that the condition holds of."""

    table: str
    grants: tuple[str, ...]
    own: str


RIGHTS = (
    _Rights("bench", ("SELECT", "UPDATE (last_seen_at, said)"), f"name = {_MINE}"),
    _Rights("run_order", ("SELECT", "UPDATE (taken_epoch, held_epoch)"), f"bench = {_MINE}"),
    _Rights("bench_command", ("SELECT", "UPDATE (taken_at, answered_at, answer)"), f"bench = {_MINE}"),
    _Rights(
        "parcel",
        ("SELECT (id, bench, seq)", "INSERT (bench, seq, run_uid, document, data, delivered_at)"),
        f"bench = {_MINE}",
    ),
)
_LAID = """
    SELECT obj_description(to_regprocedure('calrig_my_bench()'), 'pg_proc') = :mark
       AND has_table_privilege((SELECT oid FROM pg_roles WHERE rolname = :group), 'run_order', 'SELECT')
       AND NOT has_database_privilege('public', current_database(), 'CONNECT, TEMP')
"""
_JOINED = "SELECT role FROM bench JOIN pg_roles ON rolname = role WHERE revoked_at IS NULL"
_JUDGE_AGAIN = "UPDATE bench SET said = said WHERE last_seen_at IS NOT NULL AND revoked_at IS NULL"
"""An upgrade refuses what became too old at once, and not at its next report."""
_MAY_GRANT = """
    SELECT pg_has_role(:group, 'MEMBER WITH ADMIN OPTION')
        OR rolcreaterole AND current_setting('server_version_num')::int < 160000
      FROM pg_roles WHERE rolname = current_user
"""


def is_secure(connection: Connection) -> bool:
    """Whether a database has all that `secure` would lay: not a dump that was restored without its rights."""
    mark = _mark(_statements(connection))
    return connection.scalar(text(_LAID), {"group": GROUP, "mark": mark}) is True


def secure(connection: Connection) -> None:
    """Leaves benches their own rows, and everybody else but the owner nothing.

    Run it once calrig's tables are there, in a transaction, one process at a time. Where
    all is laid it does nothing: laid again, it would wait for everybody at work on these tables. Nor does it
    where the owner may make no roles: then there are no benches (`require_roles`), and nobody has any rights.
    """
    if is_secure(connection) or not _has_group(connection):
        return
    statements = _statements(connection)
    for statement in statements:
        connection.exec_driver_sql(statement)
    for role in connection.scalars(text(_JOINED)).all():  # a dump does not tell who may connect
        _let_connect(connection, role)
    connection.exec_driver_sql(_JUDGE_AGAIN)
    connection.exec_driver_sql(f"COMMENT ON FUNCTION calrig_my_bench() IS '{_mark(statements)}'")


def require_roles(connection: Connection) -> None:
    """Refuses to have benches join where the owner of the database can give them no role.

    Raises:
        Refused: says what the server's administrator has to grant.
    """
    if is_secure(connection) and connection.scalar(text(_MAY_GRANT), {"group": GROUP}):
        return
    raise Refused(
        "the centre's role in PostgreSQL can make none for a bench: as the server's administrator, "
        f"`ALTER ROLE … CREATEROLE`; and where there is a {GROUP}, `GRANT {GROUP} TO … WITH ADMIN OPTION`"
    )


def role_name(connection: Connection, bench: str) -> str:
    """The role of a bench: roles belong to the server, so that the database is in the name as well."""
    of_database = hashlib.sha256(_database(connection).encode()).hexdigest()[:8]
    return f"calrig_{bench}_{of_database}"


def let_in(connection: Connection, role: str) -> str:
    """Makes a bench's role, or lets one in again, with a new password, which it returns.

    The server gets the SCRAM verifier alone: its log may keep statements.
    """
    password, name = secrets.token_urlsafe(32), sql.Identifier(role)
    verifier = driver_of(connection).pgconn.encrypt_password(
        password.encode(), role.encode(), b"scram-sha-256"
    )
    _run(
        connection,
        sql.SQL("{} ROLE {} LOGIN CONNECTION LIMIT {} PASSWORD {}").format(
            sql.SQL("ALTER" if _is_role(connection, role) else "CREATE"),
            name,
            MOST_CONNECTIONS,
            verifier.decode(),
        ),
    )
    _run(connection, sql.SQL("GRANT {} TO {}").format(sql.Identifier(GROUP), name))
    # only who has a role's rights may end its connections
    _run(connection, sql.SQL("GRANT {} TO CURRENT_USER").format(name))
    _let_connect(connection, role)
    return password


def shut_out(connection: Connection, role: str) -> None:
    """Lets a role in no more and ends its connections, whatever they hold. Commits in between."""
    if _is_role(connection, role):
        _run(connection, sql.SQL("ALTER ROLE {} NOLOGIN").format(sql.Identifier(role)))
        connection.commit()
    ends = "SELECT pg_terminate_backend(pid, :end_ms) FROM pg_stat_activity WHERE usename = :role"
    connection.execute(text(ends), {"end_ms": END_MS, "role": role})
    connection.commit()


def _let_connect(connection: Connection, role: str) -> None:
    database = sql.Identifier(_database(connection))
    grant = sql.SQL("GRANT CONNECT ON DATABASE {} TO {}")
    _run(connection, grant.format(database, sql.Identifier(role)))


def _has_group(connection: Connection) -> bool:
    """Whether the group is there; it is made where it is not and the owner may."""
    if _is_role(connection, GROUP):
        return True
    may = "SELECT rolcreaterole OR rolsuper FROM pg_roles WHERE rolname = current_user"
    if not connection.scalar(text(may)):
        return False
    connection.exec_driver_sql(  # another database's centre may be making it this moment
        f"DO 'BEGIN CREATE ROLE {GROUP}; EXCEPTION WHEN duplicate_object OR unique_violation THEN NULL; END'"
    )
    return True


def _mark(statements: list[str]) -> str:
    """What the database keeps of what was laid."""
    return hashlib.sha256("\n".join(statements).encode()).hexdigest()


def _statements(connection: Connection) -> list[str]:
    """All that `secure` lays, in order."""
    schema = _quoted(str(connection.scalar(text("SELECT current_schema()"))))
    everybody = f"FROM PUBLIC, {GROUP}"
    laid = [
        f"REVOKE ALL ON DATABASE {_quoted(_database(connection))} FROM PUBLIC",
        f"REVOKE CREATE ON SCHEMA {schema} FROM PUBLIC",
        f"GRANT USAGE ON SCHEMA {schema} TO {GROUP}",
        f"REVOKE ALL ON ALL TABLES IN SCHEMA {schema} {everybody}",
        f"REVOKE ALL ON ALL SEQUENCES IN SCHEMA {schema} {everybody}",
        MY_BENCH.format(schema=schema),
        f"REVOKE ALL ON FUNCTION calrig_my_bench() {everybody}",
        f"GRANT EXECUTE ON FUNCTION calrig_my_bench() TO {GROUP}",
    ]
    for one in RIGHTS:
        laid += [
            f"ALTER TABLE {one.table} ENABLE ROW LEVEL SECURITY",
            f"DROP POLICY IF EXISTS calrig_own ON {one.table}",
            f"CREATE POLICY calrig_own ON {one.table} TO {GROUP} USING ({one.own}) WITH CHECK ({one.own})",
            f"GRANT {', '.join(one.grants)} ON {one.table} TO {GROUP}",
        ]
    laid += [
        JUDGE_BENCH.format(schema=schema, revision=revisions()[-1]),
        f"REVOKE ALL ON FUNCTION calrig_judge_bench() {everybody}",
        "CREATE OR REPLACE TRIGGER calrig_judge BEFORE UPDATE OF said ON bench "
        "FOR EACH ROW EXECUTE FUNCTION calrig_judge_bench()",
        "DROP POLICY IF EXISTS calrig_accepted ON run_order",
        f"CREATE POLICY calrig_accepted ON run_order AS RESTRICTIVE FOR UPDATE TO {GROUP} "
        "USING (EXISTS (SELECT FROM bench WHERE refused IS NULL))",  # of its own row
    ]
    return [*laid, f"GRANT USAGE ON SEQUENCE parcel_id_seq TO {GROUP}"]


def _quoted(name: str) -> str:
    return '"' + name.replace('"', '""') + '"'


def _is_role(connection: Connection, name: str) -> bool:
    """Whether the server has it: a dump of the database alone brings no roles along."""
    known = "SELECT EXISTS (SELECT FROM pg_roles WHERE rolname = :name)"
    return bool(connection.scalar(text(known), {"name": name}))


def _database(connection: Connection) -> str:
    return str(connection.scalar(text("SELECT current_database()")))


def _run(connection: Connection, statement: sql.Composable) -> None:
    """Runs a statement that takes no parameters, its names quoted."""
    connection.exec_driver_sql(statement.as_string(None))


def agent_url(centre: URL, role: str, password: str, host: str | None, port: int | None) -> URL:
    """The centre's own URL with the bench's name and password, as agents reach it.

    Across a network the server has to prove by its certificate who it is (`verify-full`).

    `host` and `port` are those by which agents reach the server; None where the centre's do.
    """
    place = centre if host is None else centre.set(host=host, query={})
    place = place.set(port=place.port if port is None else port)
    # of the rest of the query nothing: certificates and options are those of the centre's own connections
    query = {key: value for key, value in place.query.items() if key in {"host", "port"}}
    if not is_on_this_machine(place):
        query["sslmode"] = "verify-full"
    return place.set(drivername="postgresql+psycopg", username=role, password=password, query=query)


def is_on_this_machine(url: URL) -> bool:
    """Whether the database is reached by a socket or by loopback, as from no other machine."""
    host = url.host or url.query.get("host") or ""
    if not isinstance(host, str):
        return False  # several servers
    if not host or host.startswith(("/", "@")) or host == "localhost":
        return True
    try:
        return ip_address(host).is_loopback
    except ValueError:
        return False
