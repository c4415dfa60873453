"""`resume`: an interrupted or paused run, taken up again."""

from __future__ import annotations

from typing import TYPE_CHECKING

from calrig.cli.options import Config, Db, Json, Record, Server, StageAt, whole_id
from calrig.cli.running_service import running_service, whole_id_there
from calrig.cli.watch import RunId

if TYPE_CHECKING:
    from calrig.client import Run


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
    from calrig.cli.progress import carry_out

    there = running_service(server, db)
    if there is not None:
        from calrig.cli.run import refuse_own_rigs
        from calrig.cli.run_there import RunThere

        refuse_own_rigs("resume", there, config, record)

        def resumed(found: Run) -> Run:
            found.resume(stage_at_deg=stage_at)
            return found

        found = there.run(whole_id_there(there, run_id))
        carry_out(lambda: RunThere(there, resumed(found)), found.unit, as_json=as_json)
        return

    from calrig.analysis.stored_runs import stored_run
    from calrig.cli.local_service import local_service
    from calrig.cli.run import rig_named
    from calrig.cli.run_here import RunHere, ends_told_once
    from calrig.settings import load_settings, store_url
    from calrig.store import Store

    url, settings = store_url(db), load_settings(config)
    with Store.open(url, writer=None) as store:
        run = stored_run(store, whole_id(store, run_id))
    rigs = () if run.rig is None else (rig_named(settings, run.rig),)  # an imported one is refused in words
    with ends_told_once(), local_service(url, "resume", rigs, settings, record) as service:
        carry_out(lambda: RunHere(service, service.resume(run.id, stage_at)), run.unit, as_json=as_json)
