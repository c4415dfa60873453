"""The run service in this process, with its store and the ports of its rigs; a client of it."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, closing, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from calrig.errors import InputError, WorkError

if TYPE_CHECKING:
    from calrig.centre.service import CentreService
    from calrig.client import Client
    from calrig.runs.service import RunService
    from calrig.settings import RigSettings, Settings


@contextmanager
def centre_service(url: str, settings: Settings) -> Iterator[CentreService]:
    """The service of a centre over its database; its rigs are its benches'.

    Raises:
        InputError: rigs are configured here, which no centre carries runs out on.
    """
    from calrig.analysis.mending import issuer_of
    from calrig.settings import DEMO_RIG
    from calrig.store import Store

    if settings.rig != (DEMO_RIG,):
        rigs = ", ".join(repr(rig.name) for rig in settings.rig)
        raise InputError(
            f"{settings.file}: configures rig {rigs}, and a centre has none of its own: move them to the "
            "calrig.toml of a bench, which `calrig agent` runs on the machine with the ports"
        )
    with Store.open(url, writer="serve") as store:
        from calrig.centre.bench_rigs import BenchRigs
        from calrig.centre.service import CentreService

        issuer_of(store, settings, BenchRigs(store).releases())
        with closing(CentreService(store, url)) as service:
            yield service


@contextmanager
def local_service(
    url: str,
    command: str,
    rigs: Sequence[RigSettings],
    settings: Settings,
    record: Path | None,
    *,
    drafts: bool = True,
) -> Iterator[RunService]:
    """The run service over the store; its simulated rigs start beside, for a process takes its time.

    Stages that a dead program may have left moving, of whichever rig is configured, are told to stop first.

    Args:
        url: of the store.
        command: the command that holds the store; other writers are told its name.
        rigs: those that runs may be started on.
        settings: all that is configured.
        record: folder that takes what passes on the wires; None keeps the last minute only.
        drafts: whether completed calibrations make drafts here; a bench leaves them to its centre, as it does
            what waits its turn.
    """
    with ExitStack() as stack:
        with ThreadPoolExecutor(1) as beside:
            starting = beside.submit(lambda: [stack.enter_context(_with_ports(rig)) for rig in rigs])
            from calrig.analysis.limits import keep_configured
            from calrig.analysis.mending import issuer_of
            from calrig.analysis.revisions import NoDrafts, Releases
            from calrig.analysis.stage_maps import configured_maps
            from calrig.runs.run_queue import mark_interrupted, stop_stages
            from calrig.runs.service import RunService
            from calrig.store import Store
            from calrig.store.engines import is_centre, shown

            if is_centre(url):
                raise InputError(
                    f"--db: {shown(url)} is a centre's, whose benches carry runs out: start the run at the "
                    "centre's page, or at the bench of the rig"
                )
            require_drivers(settings, rigs)
            maps = configured_maps(settings)
            configured, troubles = {rig.name: rig for rig in settings.rig}, dict[str, str]()

            def stop(rig_names: Sequence[str]) -> None:
                troubles.update(stop_stages(rig_names, configured))

            store = stack.enter_context(Store.open(url, writer=command, left_by_the_dead=stop))
            mark_interrupted(store, troubles, keeps_queue=drafts)
            if drafts:
                issuer = issuer_of(store, settings, Releases.of(rigs))
            else:
                keep_configured(settings, store)
                issuer = NoDrafts(store)
            powered = starting.result()
        service = RunService(store, powered, record, issuer, maps)
        stack.callback(service.close)
        yield service


@contextmanager
def local_client(
    url: str, command: str, rigs: Sequence[RigSettings], settings: Settings, record: Path | None
) -> Iterator[Client]:
    """A client of the API over a run service in this process; arguments and errors as of `local_service`."""
    with local_service(url, command, rigs, settings, record) as service, _ends_told_once():
        from calrig.api import events, plans, runs
        from calrig.api.in_process import ADDRESS, in_process
        from calrig.client import Client

        with in_process(service, (runs, plans, events)) as through:
            yield Client(ADDRESS, through=through)


@contextmanager
def _ends_told_once() -> Iterator[None]:
    """Keeps the log from telling how a run ends: the command does."""
    log = logging.getLogger("calrig.runs.recorder")
    before = log.level
    log.setLevel(logging.ERROR)
    try:
        yield
    finally:
        log.setLevel(before)


def require_drivers(settings: Settings, rigs: Sequence[RigSettings]) -> None:
    """Raises InputError where a rig names a driver that there is none of."""
    from calrig.instruments.drivers import require_known
    from calrig.instruments.errors import InstrumentError

    for rig in rigs:
        if rig.stage is None or rig.imu is None:  # a simulated one, which knows its own
            continue
        try:
            require_known(rig.stage.driver, rig.imu.driver)
        except InstrumentError as error:
            raise InputError(f"{settings.file}: rig {rig.name!r}: {error}") from error


@contextmanager
def _with_ports(rig: RigSettings) -> Iterator[RigSettings]:
    """Yield the rig; a simulated rig runs in a process of its own and gets the ports of that process."""
    if rig.simulated is None:
        yield rig
        return
    from calrig.settings import BoardSettings, ClampSettings, StageSettings
    from calrig.simulator.launch import LaunchError, launch

    try:
        process = launch(rig.simulated)
    except ValueError as error:
        raise InputError(f"rig {rig.name!r}, simulated: {error}") from error
    except LaunchError as error:
        raise WorkError(f"rig {rig.name!r}: {error}") from error
    with process:
        stage = rig.stage or StageSettings(driver=process.stage_driver, port="")
        imu = rig.imu or BoardSettings(driver=process.imu_driver, port="")
        ports = {
            "stage": stage.model_copy(update={"port": process.stage_port}),
            "imu": imu.model_copy(update={"port": process.imu_port}),
            "clamp": process.clamp and ClampSettings.model_validate(process.clamp),
        }
        yield rig.model_copy(update={**ports, "time_scale": process.time_scale})
