"""After a program died: every stage it may have left moving is told to stop, then its runs are marked."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor

from calrig.instruments.errors import InstrumentError
from calrig.instruments.standing import CUT
from calrig.runs.queue import HELD, waits_its_turn
from calrig.runs.rig import stop_stage
from calrig.runs.stage_place import is_lost_since, resumed_by
from calrig.settings import RigSettings
from calrig.store import Run, Store

log = logging.getLogger(__name__)

DIED = "the program that carried it out ended before the run did; the run can be resumed"
STAGES_AT_ONCE = 8


def stop_stages(names: Sequence[str], rigs: Mapping[str, RigSettings]) -> dict[str, str]:
    """Tells the stages of rigs that a dead program used to stop, side by side, and sees that they stand.

    Args:
        names: of the rigs.
        rigs: all that are configured, by name.

    Returns:
        What a person must know, by rig, where a stage could not be told.
    """
    if not names:
        return {}
    with ThreadPoolExecutor(min(len(names), STAGES_AT_ONCE)) as stages:
        said = stages.map(lambda name: _stopped(name, rigs.get(name)), names)
        return {name: trouble for name, trouble in zip(names, said, strict=True) if trouble is not None}


def mark_interrupted(store: Store, troubles: Mapping[str, str], *, keeps_queue: bool = False) -> list[str]:
    """Marks the runs that a dead program left unfinished as `interrupted`; returns their ids.

    For a writer that has just opened the store: then no living program carries any of them out. With
    `keeps_queue` those that only waited their turn stay `queued`, and say what they wait for now.
    """
    left = []
    for run in store.unfinished():
        if keeps_queue and waits_its_turn(run):
            store.update_run(run.id, error=HELD)
            continue
        left.append(run)
        trouble = troubles.get(run.rig or "")
        log.warning("run %s was interrupted: %s", run.id, trouble or "its stage stands")
        said = [DIED, *([trouble] if trouble else []), *_where_it_stands(store, run)]
        store.update_run(run.id, status="interrupted", error="; ".join(said))
    return [run.id for run in left]


def _where_it_stands(store: Store, run: Run) -> list[str]:
    """What resuming a run needs to be told whose stage has no homing and was on its way."""
    if not is_lost_since(store, run):
        return []
    return [f"its stage has no homing, and where it stands is not known: {resumed_by(run.id)}"]


def _stopped(name: str, rig: RigSettings | None) -> str | None:
    """Stops the stage of a rig; what a person must know where that cannot be done."""
    if rig is None:
        return f"its rig {name!r} is not configured any more: see for yourself that the stage stands"
    if rig.simulated is not None:
        return None  # its devices went with the program
    try:
        stop_stage(rig)
    except InstrumentError as error:
        advice = "" if CUT in str(error) else f", or {CUT}"
        return f"its stage could not be told to stop ({error}): see that it stands{advice}"
    return None
