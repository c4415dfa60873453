"""`resume`: an interrupted or paused run, taken up again."""

from __future__ import annotations

from contextlib import AbstractContextManager, ExitStack
from pathlib import Path
from typing import TYPE_CHECKING

from calrig.cli.options import Config, Db, Json, Record, Server, StageAt, whole_id
from calrig.cli.running_service import running_service, whole_id_there
from calrig.cli.watch import RunId

if TYPE_CHECKING:
    from calrig.client import Client


def resume(
    run_id: RunId,
    stage_at: StageAt = None,
    as_json: Json = False,
    record: Record = None,
    db: Db = None,
    config: Config = None,
    server: Server = None,
) -> None:
    """Resume an interrupted run, or one that is paused at the service; Ctrl-C aborts it.

    Rig, board and stage have to be the same, and the unit untouched: the last pose is measured once more.
    Of a stage without homing that was on its way, say where it stands (`--stage-at`).
    """
    from calrig.cli.followed_run import FollowedRun
    from calrig.cli.progress import carry_out
    from calrig.cli.run import refuse_own_rigs

    with ExitStack() as stack:
        client = running_service(server, db)
        if client is not None:
            refuse_own_rigs("resume", client, config, record)
        else:
            client = stack.enter_context(_local_client(run_id, record, db, config))
        found = client.run(whole_id_there(client, run_id))

        def resumed() -> FollowedRun:
            found.resume(stage_at_deg=stage_at)
            return FollowedRun(client, found)

        carry_out(resumed, found.unit, as_json=as_json)


def _local_client(
    run_id: str, record: Path | None, db: str | None, config: str | None
) -> AbstractContextManager[Client]:
    """A client of this process with the rig of a run."""
    from calrig.analysis.stored_runs import stored_run
    from calrig.cli.local_service import local_client
    from calrig.cli.run import rig_named
    from calrig.settings import load_settings, store_url
    from calrig.store import Store

    url, settings = store_url(db), load_settings(config)
    with Store.open(url, writer=None) as store:
        run = stored_run(store, whole_id(store, run_id))
    rigs = () if run.rig is None else (rig_named(settings, run.rig),)  # an imported one is refused in words
    return local_client(url, "resume", rigs, settings, record)
