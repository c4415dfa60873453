"""What benches deliver appears at the centre as it was measured: once, in order, whatever came how often."""

from __future__ import annotations

import logging
from copy import deepcopy

import numpy as np
import pytest
from support import wait_for
from table_bench import Measured, TableBench

from calrig.centre.service import CentreService
from calrig.run_ids import new_run_id
from calrig.store import AcceptedEffect


def _is_as_measured(centre: CentreService, run_id: str, measured: Measured) -> None:
    run = centre.wait(run_id, 60)
    wait_for(lambda: not centre.store.parcels.are_waiting(), "empty mailbox")
    assert run.status == "completed"
    assert centre.store.events.after(run_id) == measured.events
    assert centre.store.poses.of(run_id) == measured.poses
    np.testing.assert_array_equal(centre.store.samples.of(run_id).time_s, measured.samples.time_s)
    np.testing.assert_array_equal(centre.store.samples.of(run_id).gyro_dps, measured.samples.gyro_dps)


def test_a_run_begun_at_its_bench_is_at_the_centre_as_it_was_measured(
    centre: CentreService, bench: TableBench, measured: Measured
):
    bench.deliver(measured.run.id, measured.parcels)

    wait_for(lambda: centre.store.runs.get(measured.run.id), "run")
    _is_as_measured(centre, measured.run.id, measured)
    run = centre.run(measured.run.id)
    known = run.model_copy(update={"limit": None, "provenance": measured.run.provenance})
    assert known == measured.run.model_copy(update={"limit": None})
    acts = [(entry.what, entry.who) for entry in centre.store.trail.entries()]
    assert acts == [("started", "Ada"), ("drafted", "Ada"), ("released", "Ada")]
    assert centre.store.trail.broken_link() is None


def test_what_comes_twice_or_after_what_follows_it_is_there_once(
    centre: CentreService, bench: TableBench, measured: Measured
):
    bench.deliver(measured.run.id, measured.parcels[:4])
    wait_for(lambda: centre.store.runs.get(measured.run.id), "run")
    bench.deliver(measured.run.id, measured.parcels)  # the bench never heard that the first ones had come
    _is_as_measured(centre, measured.run.id, measured)
    bench.deliver(measured.run.id, measured.parcels)  # nor of these

    _is_as_measured(centre, measured.run.id, measured)
    assert [one.revision for one in centre.store.revisions.of("A")] == [1]


def test_runs_that_come_mixed_do_not_wait_for_one_another(
    centre: CentreService, bench: TableBench, measured: Measured
):
    other = new_run_id()
    for parcel in measured.parcels:
        bench.deliver(other, [parcel])
        bench.deliver(measured.run.id, [parcel])

    for run_id in (measured.run.id, other):
        wait_for(lambda run_id=run_id: centre.store.runs.get(run_id), "run")
        _is_as_measured(centre, run_id, measured)
    assert sorted(one.revision for one in centre.store.revisions.of("A")) == [1, 2]


def test_a_damaged_parcel_is_kept_and_said_and_keeps_no_other_run(
    make_centre, bench: TableBench, measured: Measured, caplog: pytest.LogCaptureFixture
):
    spoilt = new_run_id()
    bench.deliver(spoilt, measured.parcels)
    bench.spoil(spoilt)
    bench.deliver(measured.run.id, measured.parcels)

    with caplog.at_level(logging.ERROR):
        centre = make_centre()
        wait_for(lambda: centre.store.runs.get(measured.run.id), "run")
        centre.wait(measured.run.id, 60)
        wait_for(lambda: bench.waiting() == len(measured.parcels), "mailbox with the damaged run's")
        wait_for(lambda: "not what was stored" in caplog.text, "word of it, which follows")
    assert spoilt in caplog.text
    assert centre.store.runs.get(spoilt) is None


def test_a_run_is_not_over_before_all_of_it_has_come(
    centre: CentreService, bench: TableBench, measured: Measured
):
    *most, _samples, end = measured.parcels
    bench.deliver(measured.run.id, most)
    wait_for(lambda: bench.waiting() == 0, "empty mailbox")
    assert centre.run(measured.run.id).status == "running"

    ahead = new_run_id()
    bench.deliver(ahead, [measured.parcels[0], end])  # what is between has been lost on the way
    wait_for(lambda: centre.store.runs.get(ahead), "run")
    wait_for(lambda: bench.waiting() == 1, "parcel that waits")
    assert centre.run(ahead).status == "running"
    bench.deliver(ahead, measured.parcels[1:])
    _is_as_measured(centre, ahead, measured)


def test_a_bench_delivers_its_own_runs_only(
    centre: CentreService, bench: TableBench, url: str, plan, measured: Measured
):
    run_id = centre.start(unit="A", plan=plan).id
    bench.deliver(run_id, measured.parcels)  # it has not taken the order
    other = TableBench(url, "hall-3", "bench-2")
    other.deliver(run_id, measured.parcels)  # whose it is not

    wait_for(lambda: run_id in centre.stuck, "refusal")
    assert centre.run(run_id).status == "queued"
    assert bench.waiting() == 2 * len(measured.parcels)
    other.close()


def test_a_bench_tells_of_no_rig_that_is_another_bench_s(
    centre: CentreService, bench: TableBench, measured: Measured, url: str, caplog: pytest.LogCaptureFixture
):
    stranger = TableBench(url, "hall-9", rig="bench-9")
    stranger.deliver(measured.run.id, measured.parcels)
    with caplog.at_level(logging.ERROR):
        wait_for(lambda: "which bench hall-2 has" in caplog.text, "refusal")
    stranger.close()

    assert centre.store.runs.get(measured.run.id) is None


def test_the_centre_makes_the_result_and_the_revision_by_what_is_in_force_there(
    centre: CentreService, bench: TableBench, measured: Measured
):
    bench.deliver(measured.run.id, measured.parcels)
    wait_for(lambda: centre.store.revisions.in_force("A"), "revision")
    assert centre.run(measured.run.id).result == measured.run.result
    effect = AcceptedEffect(
        measured.run.id, "A", None, "accelerometer_offset", "sensor", {"y_mg": 2.0, "z_mg": 0.0}
    )
    centre.store.effects.accept(measured.run.id, [effect])

    again = new_run_id()
    bench.deliver(again, measured.parcels)
    wait_for(lambda: centre.store.runs.get(again), "run")
    centre.wait(again, 60)

    result = centre.run(again).result
    assert result.rms_with_effects_deg is not None
    assert result.gyro == measured.run.result.gyro
    in_force = centre.store.revisions.in_force("A")
    assert (in_force.revision, in_force.run_id) == (2, again)
    assert [one["name"] for one in in_force.document["effects"]] == ["accelerometer_offset"]


def test_a_parcel_of_a_newer_calrig_waits_for_one(
    centre: CentreService, bench: TableBench, measured: Measured
):
    document, data = deepcopy(measured.parcels[0])
    bench.deliver(measured.run.id, [({**document, "v": 2}, data)])

    wait_for(lambda: "v: " in centre.stuck.get(measured.run.id, ""), "refusal")
    assert centre.store.runs.get(measured.run.id) is None
