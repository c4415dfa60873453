"""Poses by the hundred thousand: laid in a temporary table, which locks nothing, then copied at once.

A run on a rig stores each pose as it is measured, and must not wait while an import is written row by row.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager

from sqlalchemy import Column, Connection, MetaData, Table
from sqlmodel import Session, insert, literal, select

from calrig.calibration.poses import Pose
from calrig.store import checksums
from calrig.store.convert import POSE_NUMBERS, pose_values
from calrig.store.database import Database
from calrig.store.tables import PoseTable

AT_ONCE = 1000
"""Handed to SQLite together."""
NO_RUN = 0
_POSES = PoseTable.__table__  # type: ignore[attr-defined]
_STAGED = Table(
    "staged_pose", MetaData(), *(Column(c.name, c.type) for c in _POSES.columns), prefixes=["TEMPORARY"]
)


@contextmanager
def staged(database: Database, poses: Sequence[Pose]) -> Iterator[Connection]:
    """The poses, as those of no run yet, on a connection for `Database.writing`; locks nothing."""
    with database.staging() as connection:
        with connection.begin():
            _STAGED.create(connection)
            for first in range(0, len(poses), AT_ONCE):
                some = enumerate(poses[first : first + AT_ONCE], start=first)
                connection.execute(
                    insert(_STAGED), [pose_values(NO_RUN, index, pose) for index, pose in some]
                )
        yield connection


def take_over(session: Session, run_id: int) -> None:
    """Makes what was staged the poses of a run, inside the transaction that makes the run.

    Their checksums have the run's number in them. A CRC is affine over GF(2), so that another number changes
    all of one length by the same bits; and x ^ k is (x | k) - (x & k), since SQLite has no exclusive or.
    """
    rest = [0.0] * (1 + len(POSE_NUMBERS))
    change = checksums.of_numbers([NO_RUN, *rest]) ^ checksums.of_numbers([run_id, *rest])
    crc32 = _STAGED.c.crc32
    anew = {
        "run_id": literal(run_id),
        "crc32": crc32.bitwise_or(change) - crc32.bitwise_and(change),
    }
    names = list(_STAGED.c.keys())
    rows = select(*(anew.get(name, _STAGED.c[name]) for name in names))
    session.execute(insert(PoseTable).from_select(names, rows))
