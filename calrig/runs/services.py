"""Interface of a run service, for the API: the rigs of this machine, or the benches of a centre."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol

from calrig.analysis.revisions import Issuer
from calrig.model.plan import MountAxis, Plan
from calrig.model.service import RigState
from calrig.runs.follow_up import Designed, FollowUpQuestion
from calrig.runs.presence import BoardCheck
from calrig.runs.recorder import Bus, ServiceMetrics
from calrig.runs.single_flight import SharedTask
from calrig.settings import RigSettings
from calrig.store import Run, Store
from calrig.store.records import Document


class Service(Protocol):
    """`calrig.runs.service.RunService` has the words to each, and `calrig.centre.service.CentreService`."""

    store: Store
    bus: Bus
    meter: ServiceMetrics

    @property
    def maps(self) -> Mapping[str, Document]:
        """What runs keep of the stages' maps that files give, by rig."""

    @property
    def issuer(self) -> Issuer:
        """Makes drafts, releases and withdraws."""

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
        """Starts a run."""

    def follow_up_question(self, run_id: str) -> FollowUpQuestion:
        """Which run would separate what a diagnosis could not."""

    def follow_up(self, asked: FollowUpQuestion, found: Designed, who: str | None = None) -> Run:
        """Starts that run."""

    def run(self, run_id: str) -> Run:
        """The run, or Unknown."""

    def abort(self, run_id: str, who: str | None = None) -> Run:
        """Stops the stage and ends the run."""

    def begin_abort(self, run_id: str, who: str | None = None) -> SharedTask[Run] | None:
        """As `abort`, in a thread of its own; None where there is nobody to ask."""

    def begin_stop(self, rig_name: str, who: str | None = None) -> SharedTask[RigState]:
        """Stops a rig's stage, in a thread of its own."""

    def begin_clamp(self, rig_name: str, mount_deg: float, axis: MountAxis) -> SharedTask[RigState]:
        """Has a rig's clamp turn the unit, in a thread of its own."""

    def look(self, rig_name: str) -> None:
        """Has an idle rig's board looked at for a while."""

    def looks(self) -> dict[str, BoardCheck]:
        """What the last looks at boards gave, by rig; of those that are looked at."""

    def pause(self, run_id: str, who: str | None = None) -> Run:
        """Has a run hold."""

    def resume(self, run_id: str, stage_at_deg: float | None = None, who: str | None = None) -> Run:
        """Has a run go on."""

    def close(self) -> None:
        """Ends what this process carries out."""

    def ports(self) -> list[str]:
        """The ports that are in this process's hands."""

    def known_rig(self, name: str | None) -> RigSettings:
        """A rig's settings; Unknown where there is no such."""
