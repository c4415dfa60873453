"""Interface of a run service, for the API: the rigs of this machine, or the benches of a centre."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from types import MappingProxyType

from calrig.analysis.imports import check_serial
from calrig.analysis.revisions import Issuer
from calrig.analysis.stored_runs import stored_run
from calrig.model.plan import MountAxis, Plan
from calrig.model.service import RigState
from calrig.runs.assignment import NewRun, rig_followed_up_on
from calrig.runs.follow_up import Designed, FollowUpQuestion
from calrig.runs.presence import BoardCheck
from calrig.runs.recorder import Bus, ServiceMetrics
from calrig.runs.single_flight import SharedTask
from calrig.settings import RigSettings
from calrig.store import Run, Store
from calrig.store.records import Document


class Service(ABC):
    """Starts runs and passes requests on to them. Thread-safe.

    `calrig.runs.service.RunService` and `calrig.centre.service.CentreService` have the words to what is
    abstract here.

    Attributes:
        maps: what runs keep of the stages' maps that files give, by rig.
    """

    store: Store
    bus: Bus
    meter: ServiceMetrics
    maps: Mapping[str, Document] = MappingProxyType({})

    @property
    @abstractmethod
    def issuer(self) -> Issuer:
        """Makes drafts, releases and withdraws."""

    @abstractmethod
    def rigs(self) -> list[RigState]:
        """Every rig and what it is doing."""

    def start(
        self,
        *,
        unit: str,
        plan: Plan,
        rig: str | None = None,
        operator: str | None = None,
        note: str | None = None,
        stage_at_deg: float | None = None,
        queue: bool = False,
    ) -> Run:
        """Starts a run on a rig (the first one there is where none is named) and returns it at once.

        `stage_at_deg` is a person's word for the elevation at which a stage without homing stands; `queue`
        has the run wait its turn where the rig is busy, or its bench away.

        Raises:
            Invalid: the serial number or an elevation of the plan is out of bounds; nothing was stored.
            Unknown: there is no such rig.
            Conflict: the rig is busy, or its bench is away.
            Refused: the rig is busy, at a centre.
        """
        check_serial(unit)
        wanted = NewRun(
            unit=unit, plan=plan, operator=operator, who=operator, note=note, stage_at_deg=stage_at_deg
        )
        return self.start_on(rig, wanted, waits=queue)

    @abstractmethod
    def start_on(self, rig: str | None, wanted: NewRun, *, waits: bool = False) -> Run:
        """Starts a run on a rig; errors as of `start`."""

    def follow_up_question(self, run_id: str) -> FollowUpQuestion:
        """Which run would separate what the diagnosis of a run, and those before it, could not.

        Raises Unknown where there is no such run, Conflict where it was imported or one has not ended.
        """
        run = stored_run(self.store, run_id)
        return FollowUpQuestion.of(self.store, run, self.known_rig(rig_followed_up_on(run)).limits_deg)

    def follow_up(self, asked: FollowUpQuestion, found: Designed, who: str | None = None) -> Run:
        """Starts that run; Conflict where nothing can be separated on the rig, and why, or it is busy."""
        return self.start_on(rig_followed_up_on(asked.last), NewRun.following(asked, found, who))

    def run(self, run_id: str) -> Run:
        """The run, or Unknown."""
        return stored_run(self.store, run_id)

    @abstractmethod
    def abort(self, run_id: str, who: str | None = None) -> Run:
        """Stops the stage and ends the run."""

    @abstractmethod
    def begin_abort(self, run_id: str, who: str | None = None) -> SharedTask[Run] | None:
        """As `abort`, in a thread of its own; None where there is nobody to ask."""

    def stop(self, rig_name: str) -> RigState:
        """As `begin_stop`; returns once the stage was seen to stand."""
        return self.begin_stop(rig_name).result()

    @abstractmethod
    def begin_stop(self, rig_name: str, who: str | None = None) -> SharedTask[RigState]:
        """Stops a rig's stage, in a thread of its own."""

    @abstractmethod
    def begin_clamp(self, rig_name: str, mount_deg: float, axis: MountAxis) -> SharedTask[RigState]:
        """Has a rig's clamp turn the unit, in a thread of its own."""

    @abstractmethod
    def look(self, rig_name: str) -> None:
        """Has an idle rig's board looked at for a while."""

    @abstractmethod
    def looks(self) -> dict[str, BoardCheck]:
        """What the last looks at boards gave, by rig; of those that are looked at."""

    @abstractmethod
    def pause(self, run_id: str, who: str | None = None) -> Run:
        """Has a run hold."""

    @abstractmethod
    def resume(self, run_id: str, stage_at_deg: float | None = None, who: str | None = None) -> Run:
        """Has a run go on."""

    @abstractmethod
    def close(self) -> None:
        """Ends what this process carries out."""

    @abstractmethod
    def ports(self) -> list[str]:
        """The ports that are in this process's hands."""

    @abstractmethod
    def known_rig(self, name: str | None) -> RigSettings:
        """A rig's settings; Unknown where there is no such."""
