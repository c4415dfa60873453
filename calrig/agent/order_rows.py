"""The orders of a bench in its centre's database: looking at them, and taking one by one statement."""

from __future__ import annotations

from typing import NamedTuple

from calrig.agent.link import Centre
from calrig.store.checksums import unsealed
from calrig.store.errors import StoreDamagedError, Unreadable
from calrig.store.records import Document

_PENDING = """
SELECT run_uid, epoch FROM run_order
WHERE bench = %s AND rig = %s AND epoch > taken_epoch AND wish IN ('begin', 'resume')
ORDER BY ordered_at, run_uid LIMIT 1
"""
_TAKE = """
UPDATE run_order SET taken_epoch = %(epoch)s
WHERE run_uid = %(run_id)s AND bench = %(bench)s AND epoch = %(epoch)s AND taken_epoch < %(epoch)s
RETURNING wish, document
"""
_TAKEN = """
SELECT run_uid, epoch FROM run_order
WHERE bench = %s AND rig = %s AND epoch = taken_epoch AND wish IN ('begin', 'resume')
"""
_ORDER = "SELECT document FROM run_order WHERE bench = %s AND run_uid = %s"


class Pending(NamedTuple):
    """An order that nobody has taken."""

    run_id: str
    epoch: int


def pending_order(centre: Centre, rig: str) -> Pending | None:
    """The oldest order of a rig that is not taken."""
    found = centre.connection.execute(_PENDING, (centre.bench, rig)).fetchone()
    return None if found is None else Pending(*found)


def take(centre: Centre, order: Pending) -> tuple[str, Document] | None:
    """Takes an order: its wish and document; None where another epoch counts by now, or it was taken."""
    wanted = {"bench": centre.bench, "run_id": order.run_id, "epoch": order.epoch}
    found = centre.connection.execute(_TAKE, wanted).fetchone()
    return None if found is None else (found[0], _document(order.run_id, found[1]))


def epochs_taken(centre: Centre, rig: str) -> dict[str, int]:
    """The newest epoch of each of a rig's runs where that was taken."""
    return dict(centre.connection.execute(_TAKEN, (centre.bench, rig)).fetchall())


def order_of(centre: Centre, run_id: str) -> Document:
    """The order of a run."""
    found = centre.connection.execute(_ORDER, (centre.bench, run_id)).fetchone()
    return _document(run_id, None if found is None else found[0])


def _document(run_id: str, stored: object) -> Document:
    try:
        return unsealed(stored)
    except (Unreadable, TypeError) as error:
        raise StoreDamagedError(f"the order of run {run_id} cannot be read: {error}") from error
