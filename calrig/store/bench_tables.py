"""Tables of a centre and its benches.

A bench's own file has only `taken_order` and `delivery`. `calrig.store.postgresql.set_up` grants the rights
of a bench's role.
"""

import re
from datetime import datetime
from typing import Any

from sqlmodel import Column, Field, Index, LargeBinary

from calrig.store.checksums import CheckedJson
from calrig.store.tables import Sha256, Table, UtcText

BENCH_NAME = re.compile(r"[A-Za-z0-9_.-]{1,20}")
"""Of a bench, which is part of its role's name: PostgreSQL keeps 63 bytes of one."""

PROTOCOL = 3
"""Of what bench and centre say to each other through the database. It changes where either side would
misunderstand the other; 1 is that of versions which did not tell, and since 3 a bench tells the schema that
it delivers for. A bench is accepted whose protocol and schema are the centre's.
"""


class BenchTable(Table, table=True):
    """A bench that has joined: its database role, and what it last said of itself.

    The database judges each report: `refused` is why it takes no orders, null where it does; `bears` are the
    names of its rigs (JSON), null where another bench has one of them.
    """

    name: str = Field(primary_key=True)
    hall: str | None = None
    role: str | None = Field(default=None, unique=True)
    code_sha256: str | None = Field(default=None, sa_type=Sha256)
    code_until: datetime | None = Field(default=None, sa_type=UtcText)
    enrolled_at: datetime | None = Field(default=None, sa_type=UtcText)
    revoked_at: datetime | None = Field(default=None, sa_type=UtcText)
    last_seen_at: datetime | None = Field(default=None, sa_type=UtcText)
    said: dict[str, Any] = Field(sa_type=CheckedJson)
    bears: str | None = None
    refused: str | None = None


class RunOrderTable(Table, table=True):
    """What a bench is to do with a run: only the newest epoch counts, and only what is newer than taken.

    An epoch that is not newer than `held_epoch` waits for a person's word, who orders it anew.
    """

    __table_args__ = (Index("ix_run_order_bench", "bench"),)

    run_uid: str = Field(primary_key=True)
    bench: str = Field(foreign_key="bench.name")
    rig: str
    epoch: int
    wish: str
    document: dict[str, Any] = Field(sa_type=CheckedJson)
    taken_epoch: int = 0
    held_epoch: int = 0
    ordered_at: datetime = Field(sa_type=UtcText)


class BenchCommandTable(Table, table=True):
    """Stop, abort, pause or resume, asked of a bench while somebody waits for the answer; or a look.

    A stop stays until the bench has answered it or somebody withdraws it, the others for seconds.
    """

    __table_args__ = (Index("ix_bench_command_bench", "bench"),)

    id: int = Field(default=None, primary_key=True)
    bench: str = Field(foreign_key="bench.name")
    kind: str
    rig: str | None = None
    run_uid: str | None = None
    asked_at: datetime = Field(sa_type=UtcText)
    taken_at: datetime | None = Field(default=None, sa_type=UtcText)
    answered_at: datetime | None = Field(default=None, sa_type=UtcText)
    withdrawn_at: datetime | None = Field(default=None, sa_type=UtcText)
    answer: dict[str, Any] | None = Field(default=None, sa_type=CheckedJson)


class ParcelTable(Table, table=True):
    """What a bench has delivered and nobody has unpacked yet."""

    __table_args__ = (Index("ix_parcel_bench_seq", "bench", "seq", unique=True),)

    id: int = Field(default=None, primary_key=True)
    bench: str = Field(foreign_key="bench.name")
    seq: int
    run_uid: str
    document: dict[str, Any] = Field(sa_type=CheckedJson)
    data: bytes | None = Field(default=None, sa_column=Column(LargeBinary))
    delivered_at: datetime = Field(sa_type=UtcText)


class TakenOrderTable(Table, table=True):
    """On a bench: the newest epoch of a run that it has acted on, and the order of it."""

    run_uid: str = Field(primary_key=True)
    epoch: int
    document: dict[str, Any] = Field(sa_type=CheckedJson)


class DeliveryTable(Table, table=True):
    """On a bench: how far a run has been delivered to the centre."""

    run_uid: str = Field(primary_key=True)
    event_seq: int
    sample_block_id: int
    is_complete: bool
