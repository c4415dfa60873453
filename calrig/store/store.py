"""The store: its repositories over one database."""

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from typing import Self, TypeVar

from calrig.store.amendments import AcceptedEffects, Amendments
from calrig.store.batches import Batches
from calrig.store.benches import Benches, Commands, Orders
from calrig.store.certificates import Certificates
from calrig.store.database import BUSY_TIMEOUT_S, Database
from calrig.store.engines import open_database
from calrig.store.enrolment import Enrolment
from calrig.store.event_log import EventLog
from calrig.store.fleet import Findings, Fleet, Studies
from calrig.store.issued import Revisions
from calrig.store.limits import Limits
from calrig.store.parcels import Spool
from calrig.store.poses import Poses, Samples
from calrig.store.records import Size
from calrig.store.rigs import CheckStandards, RigSummaries, StageMaps, StagePositions
from calrig.store.runs import Runs
from calrig.store.solutions import Solutions
from calrig.store.trail import Trail
from calrig.store.units import Items, Units
from calrig.store.unpacking import Parcels
from calrig.store.users import Users
from calrig.store.verdicts import Verdicts
from calrig.store.webhook import Deliveries

T = TypeVar("T")


class Store:
    """An open store, shared by threads: one repository for each subject.

    Each method of a repository is one transaction, on the disk when it returns; `transaction` makes one of
    several. A run that does not exist raises `NotFound` unless the method says otherwise; a failure of the
    database raises `StoreError`; a document with a NaN raises ValueError (an unknown value is None).

    Attributes:
        url: by which it was opened, with its password if it has one.
    """

    def __init__(self, database: Database, url: str) -> None:
        self.url = url
        self._database = database
        self.runs = Runs(database)
        self.poses = Poses(database)
        self.samples = Samples(database)
        self.events = EventLog(database)
        self.verdicts = Verdicts(database)
        self.amendments = Amendments(database)
        self.effects = AcceptedEffects(database)
        self.units = Units(database)
        self.items = Items(database)
        self.revisions = Revisions(database)
        self.certificates = Certificates(database)
        self.limits = Limits(database)
        self.solutions = Solutions(database)
        self.rigs = RigSummaries(database)
        self.positions = StagePositions(database)
        self.check_standards = CheckStandards(database)
        self.stage_maps = StageMaps(database)
        self.batches = Batches(database)
        self.trail = Trail(database)
        self.users = Users(database)
        self.deliveries = Deliveries(database)
        self.studies = Studies(database)
        self.fleet = Fleet(database)
        self.findings = Findings(database)
        self.benches = Benches(database)
        self.enrolment = Enrolment(database)
        self.orders = Orders(database)
        self.commands = Commands(database)
        self.parcels = Parcels(database)
        self.spool = Spool(database)

    @classmethod
    def open(
        cls,
        url: str,
        *,
        writer: str | None,
        busy_timeout_s: float = BUSY_TIMEOUT_S,
        left_by_the_dead: Callable[[Sequence[str]], None] = lambda _: None,
    ) -> Self:
        """Opens a store; a writer makes it where there is none and brings an older one up to date.

        Args:
            url: SQLAlchemy URL of a SQLite file or a PostgreSQL database, as `calrig.settings.store_url`
                gives it.
            writer: what the writer does (`serve`, `run`, `import`), told to whoever finds the store taken
                (PostgreSQL takes any number of writers); None opens it for reading, which always may.
            busy_timeout_s: how long to wait for another process's lock.
            left_by_the_dead: is told by the one writer of a file which rigs have unfinished runs, which no
                living program carries out, before anything else is done: looking through a large file can
                take a while.

        Raises:
            StoreError: another writer holds it; it is absent (for a reader), older (for a reader), newer,
                not SQLite, another program's, unreadable, read-only, or the disk is full.
        """
        return cls(open_database(url, writer, busy_timeout_s, left_by_the_dead), url)

    def transaction(self) -> AbstractContextManager[None]:
        """Make one transaction of what this thread does until the block ends; nothing is stored if it raises.

        Other writers wait until it ends, so that nothing in it may take seconds.
        """
        return self._database.transaction()

    def size(self) -> Size:
        """What the store takes of its disk."""
        return self._database.size()

    def answers_at(self, address: str) -> None:
        """Says to commands that find a file taken at which address its holder does their work for them."""
        self._database.answers_at(address)

    def close(self) -> None:
        """Closes the file and lets another writer in."""
        self._database.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def with_store(url: str, work: Callable[[Store], T]) -> T:
    """Return what the work gives for a store, opened for reading and closed again.

    `url` is as `Store.open` takes it; `work` is of a module, or a `partial` of one, so that another process
    can be given it.

    Raises:
        StoreError: as of `Store.open`.
    """
    with Store.open(url, writer=None) as store:
        return work(store)
