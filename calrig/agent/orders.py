"""Take orders from the centre's database: each at most once, when its rig is free.

The row of an order is authoritative. A notification only announces that a row may have changed.
"""

import logging
import threading
import time
from typing import NamedTuple

from calrig.agent.link import Centre, Lease, Link, LinkDown
from calrig.analysis.errors import Conflict, RunsError
from calrig.model.run import Status
from calrig.runs.assignment import ordered_run
from calrig.runs.service import RunService
from calrig.settings import RigSettings
from calrig.store import StoreError
from calrig.store.checksums import unsealed
from calrig.store.errors import StoreDamagedError, Unreadable
from calrig.store.records import Document

_NO_STOP = """NOT EXISTS (
    SELECT FROM bench_command AS stop
    WHERE stop.bench = run_order.bench AND stop.rig = run_order.rig AND stop.kind = 'stop'
      AND stop.answered_at IS NULL AND stop.withdrawn_at IS NULL
)"""
_PENDING = f"""
SELECT run_uid, epoch FROM run_order
WHERE bench = %s AND rig = %s AND epoch > taken_epoch AND epoch > held_epoch
  AND wish IN ('begin', 'resume') AND {_NO_STOP}
ORDER BY ordered_at, run_uid LIMIT 1
"""  # noqa: S608 (no text of anybody's)
_TAKE = f"""
UPDATE run_order SET taken_epoch = %(epoch)s
WHERE run_uid = %(run_id)s AND bench = %(bench)s AND epoch = %(epoch)s AND taken_epoch < %(epoch)s
  AND held_epoch < %(epoch)s AND {_NO_STOP}
RETURNING wish, document
"""  # noqa: S608 (no text of anybody's)
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
    """The oldest order of a rig that is neither taken nor held back."""
    found = centre.connection.execute(_PENDING, (centre.bench, rig)).fetchone()
    return None if found is None else Pending(*found)


def take(centre: Centre, order: Pending) -> tuple[str, Document] | None:
    """Takes an order: its wish and document; None where another epoch counts by now, or it was taken."""
    wanted = {"bench": centre.bench, "run_id": order.run_id, "epoch": order.epoch}
    found = centre.connection.execute(_TAKE, wanted).fetchone()
    return None if found is None else (found[0], _document(order.run_id, found[1]))


def order_of(centre: Centre, run_id: str) -> Document:
    """The order of a run."""
    found = centre.connection.execute(_ORDER, (centre.bench, run_id)).fetchone()
    return _document(run_id, None if found is None else found[0])


def _document(run_id: str, stored: object) -> Document:
    try:
        return unsealed(stored)
    except (Unreadable, TypeError) as error:
        raise StoreDamagedError(f"the order of run {run_id} cannot be read: {error}") from error


log = logging.getLogger(__name__)

FREE_S = 0.1
"""How often it is looked whether the rig has become free, which asks nobody."""
LOOK_S = 5.0
"""How often the centre is asked for orders though no notification came."""
DOUBT = (
    "the bench took the order and cannot tell whether it began: nothing is done twice; "
    "see that the stage stands, then resume the run"
)
NOT_HERE = "the bench does not have what this run has measured: start a new run"


class RigOrders:
    """The orders of one rig, in a thread of its own, until `closing` is set.

    Args:
        link: to the centre, shared by all that is short.
        lease: without it, nothing is taken.

    Attributes:
        trouble: why an order that waits is not taken; None where none waits, or for the rig alone.
    """

    def __init__(
        self, rig: RigSettings, link: Link, lease: Lease, service: RunService, closing: threading.Event
    ) -> None:
        self.name = f"orders of {rig.name}"
        self._rig, self._link, self._lease = rig, link, lease
        self._service, self._closing = service, closing
        self._store = service.store
        self._wake = threading.Event()
        self._wake.set()
        self._look_at_s = 0.0
        self._in_doubt = True  # what became of the last order, before this program began
        self.trouble: str | None = None

    def wake(self) -> None:
        """There may be an order."""
        self._wake.set()

    def _be_in_doubt(self) -> None:
        self._in_doubt = True
        self._wake.set()

    def run(self) -> None:
        """Carries orders out until the agent is closed."""
        while not self._closing.is_set():
            try:
                self.look()
            except LinkDown:
                self._be_in_doubt()
            except StoreError as error:
                self._be_in_doubt()
                log.error("rig %s takes no orders: %s", self._rig.name, error)
                self._closing.wait(LOOK_S)
            self._closing.wait(FREE_S)

    def look(self) -> None:
        """Takes and begins the next order where there is one, the rig is free and the lease held.

        Raises:
            LinkDown: the centre is away; of an order in hand it is not known whether it was taken.
        """
        is_due = self._wake.is_set() or time.monotonic() >= self._look_at_s
        if not (is_due and self._service.crew.is_free(self._rig.name) and self._lease.is_held()):
            return
        if self._in_doubt:
            self._settle()
            self._in_doubt = False
        self._wake.clear()
        self._look_at_s = time.monotonic() + LOOK_S
        with self._link.centre() as centre:
            order = pending_order(centre, self._rig.name)
        if order is None:
            self.trouble = None
            return
        self.trouble = self._why_not_written()
        if self.trouble is not None:
            return
        self._wake.set()  # there may be another one after it, or the rig is busy
        with self._service.crew.keeping(self._rig.name, order.run_id) as is_free:
            if is_free and self._lease.is_held():
                self._take(order)

    def _why_not_written(self) -> str | None:
        """Why nothing that a run measures could be kept; None where it could."""
        try:
            self._store.spool.require_room()
        except StoreError as error:
            if self.trouble is None:
                log.error("rig %s takes no orders: %s", self._rig.name, error)
            return f"its spool cannot be written: {error}"
        return None

    def _take(self, order: Pending) -> None:
        with self._link.centre() as centre:
            took = take(centre, order)
        if took is None:
            return  # the centre thought better of it meanwhile
        wish, document = took
        log.info("order %d of run %s taken: %s", order.epoch, order.run_id, wish)
        try:
            self._begin(order.run_id, wish, document)
        except (RunsError, ValueError, KeyError, TypeError) as error:
            self._could_not(order.run_id, document, error)
        self._store.spool.take_order(order.run_id, order.epoch, document)

    def _begin(self, run_id: str, wish: str, document: Document) -> None:
        if self._store.runs.get(run_id) is not None:
            said_deg = document.get("stage_at_deg") if wish == "resume" else None
            self._service.resume(run_id, said_deg)
        elif wish == "resume":
            raise Conflict(NOT_HERE)
        else:
            self._service.begin(self._rig, ordered_run(run_id, document, self._rig))

    def _could_not(self, run_id: str, document: Document, error: Exception) -> None:
        """The run says why it was not begun; what can be mended at the bench leaves it interrupted."""
        said = str(error) if isinstance(error, RunsError) else f"the order cannot be read: {error!r}"
        log.warning("run %s was not begun: %s", run_id, said)
        status: Status = "interrupted" if isinstance(error, Conflict) else "failed"
        run = self._store.runs.get(run_id)
        if run is None:
            self._keep(run_id, document)
        elif run.status != "interrupted":
            return  # somebody at the bench was first
        else:
            status = "interrupted"
        self._end(run_id, status, said)

    def _settle(self) -> None:
        """Orders that were taken, and of which the spool does not know: what became of them is in doubt."""
        with self._link.centre() as centre:
            taken = centre.connection.execute(_TAKEN, (centre.bench, self._rig.name)).fetchall()
        known = self._store.spool.taken_epochs()
        for run_id, epoch in taken:
            if known.get(run_id, 0) < epoch:
                with self._link.centre() as centre:
                    document = order_of(centre, run_id)
                self._leave_interrupted(run_id, epoch, document)

    def _leave_interrupted(self, run_id: str, epoch: int, document: Document) -> None:
        run = self._store.runs.get(run_id)
        if run is None:
            self._keep(run_id, document)
        if run is None or run.status == "interrupted":
            log.warning("run %s: %s", run_id, DOUBT)
            self._end(run_id, "interrupted", DOUBT)
        self._store.spool.take_order(run_id, epoch, document)

    def _keep(self, run_id: str, document: Document) -> None:
        """Stores a run that is not carried out, as far as its order can be read."""
        self._store.runs.create(
            unit=document["unit"],
            rig=self._rig.name,
            plan=document["plan"],
            status="queued",
            provenance=document["provenance"],
            operator=document.get("operator"),
            note=document.get("note"),
            poses_total=document["poses_total"],
            run_id=run_id,
        )

    def _end(self, run_id: str, status: Status, error: str) -> None:
        self._store.runs.update(run_id, status=status, error=error)
        self._service.bus.wake(run_id)
