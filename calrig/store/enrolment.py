"""Enrol and revoke benches of a centre: a code that works once, and a database role for each bench."""

import json
import secrets
from collections.abc import Sequence
from datetime import UTC, datetime, timedelta

from sqlmodel import Session, col, select

from calrig.model.clock_skew import said_skew_s, skew_in_words
from calrig.model.service import Membership
from calrig.store.bench_tables import BENCH_NAME, PROTOCOL, BenchTable
from calrig.store.benches import refusal, versions_here
from calrig.store.database import Repository, row_of
from calrig.store.errors import Refused
from calrig.store.trail import Act, append
from calrig.store.users import token_digest

CODE_LASTS = timedelta(days=1)
NO_CENTRE = "benches join a centre, whose store is in PostgreSQL: `calrig serve --db postgresql+psycopg://…`"


class WrongCode(Refused):
    """No bench may join by this code."""


class Enrolment(Repository):
    """Which benches there are. Each change goes into the trail in the same transaction."""

    def benches(self) -> list[Membership]:
        """Every bench by name, those that were revoked as well."""
        with self._database.reading() as session:
            return [
                Membership.model_validate(row).model_copy(update=_reported(row))
                for row in session.exec(select(BenchTable).order_by(BenchTable.name))
            ]

    def add(
        self, name: str, hall: str | None = None, *, who: str | None = None, now: datetime | None = None
    ) -> tuple[Membership, str]:
        """Lets a bench join within a day, by a code that is told here and never again.

        Who has not joined yet, or was revoked, gets a new code in place of the one before.

        Raises:
            Refused: the bench has joined; or a name has characters that no bench's has; or this is a file.
        """
        if not BENCH_NAME.fullmatch(name):
            raise Refused(f"a bench's name has 1 to 20 letters, digits and . _ -, unlike {name[:80]!r}")
        now, code = now or datetime.now(UTC), secrets.token_hex(16)
        with self._database.writing() as session:
            _require_centre(session)
            row = session.get(BenchTable, name)
            if row is None:
                row = BenchTable(name=name, said={})
                session.add(row)
            elif row.enrolled_at is not None and row.revoked_at is None:
                raise Refused(
                    f"bench {name} has joined already: revoke it first (`calrig bench revoke {name}`)"
                )
            row.hall = hall or row.hall
            row.code_sha256, row.code_until = token_digest(code), now + CODE_LASTS
            append(session, Act("bench_added", who=who, detail={"bench": name, "hall": row.hall}), now)
            return Membership.model_validate(row), code

    def enroll(
        self,
        code: str,
        *,
        host: str | None = None,
        port: int | None = None,
        is_elsewhere: bool = False,
        protocol: int = PROTOCOL,
        schema_revision: str | None = None,
        rigs: Sequence[str] = (),
        now: datetime | None = None,
    ) -> tuple[str, str]:
        """Has the bench of a code join: its role is made, or let in again with a new password.

        The code is looked up by its hash: how long that takes says nothing about those that are known.

        Args:
            code: as `add` told it.
            host: by which agents reach the database's server; None where the centre's does.
            port: likewise.
            is_elsewhere: whether the agent runs on another machine than the centre.
            protocol: that the agent speaks.
            schema_revision: of the tables that the agent delivers for; None takes this program's.
            rigs: names of the agent's rigs, as far as they are configured by now.
            now: the time; None takes the clock's.

        Returns:
            The bench's name, and the database's URL with its role and password, told here and never again.

        Raises:
            WrongCode: nobody may join by it, or not any more.
            Refused: the database cannot be reached from where the agent is; its version is not the centre's;
                or another bench has a rig of the same name. The code can be used again.
        """
        now = now or datetime.now(UTC)
        with self._database.writing() as session:
            _require_centre(session)
            wanted = select(BenchTable).where(BenchTable.code_sha256 == token_digest(code))
            row = session.exec(wanted).one_or_none()
            if row is None or row.code_until is None or row.code_until < now:
                raise WrongCode(
                    "no bench may join by this code: it is wrong, was used, or is older than a day; an admin "
                    "makes another one with `calrig bench add NAME`"
                )
            _require_understood(protocol, schema_revision)
            _require_own_names(session, row.name, rigs)
            url = _let_in(session, row, host, port, is_elsewhere=is_elsewhere)
            row.code_sha256 = row.code_until = row.revoked_at = row.bears = row.refused = None
            row.enrolled_at = now
            append(session, Act("bench_enrolled", detail={"bench": row.name}), now)
            return row.name, url

    def revoke(self, name: str, *, who: str | None = None) -> Membership:
        """Lets a bench in no more and ends its connections; what it measured stays.

        It is locked out before anything is written: it may hold the very lock that a write waits for.

        Raises:
            NotFound: there is no such bench.
        """
        with self._database.reading() as session:
            role = _known(session, name).role
        if role is not None:
            from calrig.store.postgresql.set_up import shut_out

            with self._database.staging() as connection:
                shut_out(connection, role)
        now = datetime.now(UTC)
        with self._database.writing() as session:
            row = _known(session, name)
            if row.revoked_at is None:
                row.revoked_at, row.code_sha256, row.code_until = now, None, None
                append(session, Act("bench_revoked", who=who, detail={"bench": name}), now)
            return Membership.model_validate(row)


def _let_in(
    session: Session, row: BenchTable, host: str | None, port: int | None, *, is_elsewhere: bool
) -> str:
    from calrig.store.postgresql.set_up import agent_url, is_on_this_machine, let_in, role_name

    connection = session.connection()
    row.role = row.role or role_name(connection, row.name)
    password = let_in(connection, row.role)
    url = agent_url(connection.engine.url, row.role, password, host, port)
    if is_elsewhere and is_on_this_machine(url):
        raise Refused(
            "the centre reaches its database on its own machine, as no bench can: write the name of the "
            "database's server as `agent_db_host` under [centre] in the centre's calrig.toml"
        )
    return url.render_as_string(hide_password=False)


def _require_understood(protocol: int, schema_revision: str | None) -> None:
    ours = tuple(versions_here().values())
    its = (protocol, schema_revision or ours[1])
    if its != ours:
        old, who = ("old", "the bench") if its < ours else ("new", "the centre")
        raise Refused(
            f"the calrig of this bench is too {old} for the centre (protocol {its[0]}, schema {its[1]} "
            f"instead of {ours[0]}, {ours[1]}): upgrade {who} first"
        )


def _require_own_names(session: Session, name: str, rigs: Sequence[str]) -> None:
    wanted = select(BenchTable).where(col(BenchTable.name) != name, col(BenchTable.revoked_at).is_(None))
    for other in session.exec(wanted.order_by(BenchTable.name)):
        if twins := sorted({*rigs} & {*json.loads(other.bears or "[]")}):
            raise Refused(
                f"bench {other.name} has a rig {twins[0]!r} already: give the rigs names of their own in "
                f"calrig.toml, or revoke bench {other.name} first"
            )


def _reported(row: BenchTable) -> dict[str, float | str | None]:
    """What a membership says of a bench by its last report: its clock, its calrig, why it takes no orders."""
    skew_s = said_skew_s(row.said.get("clock_skew_s"))
    said = {name: row.said.get(name) for name in ("version", "schema_revision")}
    versions = {name: one for name, one in said.items() if isinstance(one, str)}
    return {"refused": refusal(row), "clock_skew_s": skew_s, "clock": skew_in_words(skew_s), **versions}


def _require_centre(session: Session) -> None:
    if session.connection().dialect.name != "postgresql":
        raise Refused(NO_CENTRE)
    from calrig.store.postgresql.set_up import require_roles

    require_roles(session.connection())


def _known(session: Session, name: str) -> BenchTable:
    return row_of(session, BenchTable, name, f"there is no bench {name!r}")
