"""What nobody may release without looking: drafts of simulated runs, over HTTP, whatever `release` says."""

from __future__ import annotations

from contextlib import contextmanager

import pytest
from postgresql_server import store_at
from run_rigs import pass_time, plan
from support import imported, serving

from calrig.plan import Plan
from calrig.runs.service import RunService
from calrig.settings import DEMO_RIG
from calrig.store import Store

THERE_AND_BACK = plan(elevations_deg=[-30, 0, 30])
LEARNING = [-20, -10, 0, 10, 20, 10, 0, -10, -20, -10, 0, 10, 20, 30, 20, 10, 0]
OFFSET_DEG = 0.8
SLIPS_AT_S = 56.0
"""In the move into the fourteenth of these poses."""

SLIPS = {
    "at a turning point": (plan(elevations_deg=[-40, -20, 0, 20, 40], sweeps=2), 78.5),
    "within a move": (plan(elevations_deg=[-40, -20, 0, 20, 40], sweeps=4), 108.7),
}
"""Plans, and when the mount slips in the second run of each, s: +40° is measured twice without a rotation."""


class Lab:
    """A service over the session's store with one rig, and short words for what a program asks of it."""

    def __init__(self, service, client, unit):
        self.service, self.client, self.unit = service, client, unit

    def run(self, chosen=THERE_AND_BACK):
        """A run of the unit, from its start to its end, as the API shows it."""
        body = {"unit": self.unit, "plan": chosen.model_dump(mode="json", exclude_unset=True)}
        begun = self.client.post("/api/runs", json=body).raise_for_status().json()
        self.service.wait(begun["id"], 120)
        ended = self.client.get(f"/api/runs/{begun['id']}").json()
        assert ended["status"] == "completed", ended["error"]
        return ended

    def revisions(self):
        return self.client.get(f"/api/units/{self.unit}/calibrations").json()

    def statuses(self):
        return [one["status"] for one in self.revisions()]

    def document(self, revision="latest"):
        return self.client.get(f"/api/units/{self.unit}/calibration?revision={revision}").json()

    def in_force(self):
        """The revision in force; None without one."""
        return self.client.get(f"/api/units/{self.unit}").json()["revision_in_force"]

    def feed(self, revision):
        entries = self.client.get("/api/calibrations").json()
        return [one for one in entries if (one["unit"], one["revision"]) == (self.unit, revision)]

    def release(self, revision, **body):
        return self.client.post(f"/api/units/{self.unit}/calibrations/{revision}/release", json=body)

    def kinds(self, run):
        return {doubt["kind"] for doubt in run["result"]["doubts"]}

    def stays_a_draft(self, run, *kinds):
        """Asserts that a run's revision is a draft, and that all who show it say why."""
        assert set(kinds) <= self.kinds(run), run["result"]["doubts"]
        newest = self.revisions()[0]
        assert (newest["run_id"], newest["status"]) == (run["id"], "draft")
        says = [doubt["says"] for doubt in run["result"]["doubts"]]
        assert self.document()["warnings"] == newest["warnings"] == says
        for verdict in (run["verdict"], newest["verdict"]):
            assert verdict["reliable"] is False
            assert verdict["says"][: len(says)] == says
        (told,) = self.feed(newest["revision"])
        assert (told["what"], told["warnings"]) == ("drafted", says)
        return newest["revision"]

    def is_in_force(self, run):
        """Asserts that a run's revision was released by itself, without a doubt."""
        assert run["result"]["doubts"] == []
        assert (run["verdict"]["reliable"], self.document()["warnings"]) == (True, [])
        newest = self.revisions()[0]
        assert (newest["run_id"], newest["status"]) == (run["id"], "in_force")
        return newest["revision"]


@pytest.fixture
def store(tmp_path):
    """A store of each test's own: how other units repeat decides what is released."""
    with Store.open(store_at(tmp_path / "calrig.db"), writer="tests") as opened:
        yield opened


@pytest.fixture
def lab(store, request):
    """Opens a lab of a rig, for a unit of the test's own; a stage without homing is opened anew."""
    unit = request.node.name[:60]

    @contextmanager
    def opened(rig, of=unit, **settings):
        known = rig.settings.model_copy(update=settings)
        rig.simulated.stage.reset() if not rig.simulated.settings.stage.homing else None
        service = RunService(store, [known])
        try:
            with serving(service) as client:
                yield Lab(service, client, of)
        finally:
            service.close()

    return opened


@pytest.fixture
def open_loop(make_rig, request):
    """A stepper without a switch, switched on at its zero."""
    stage = {"driver": "grbl", "homing": False}
    return make_rig(request.node.name[:60], stage=stage, mechanics={"power_up_deg": 0.0})


def turned_by(store, rig, deg):
    """Turns the table by hand, as the store would see it: what it remembers is wrong by as much."""
    name = rig.settings.name
    store.positions.save(name, store.positions.of(name).stage_deg - deg)


def clamp_anew(rig, mount_deg):
    """Clamps the unit once more, at an angle; how well it is seated is drawn each time."""
    with rig.simulated.bench.lock:
        until_s = rig.simulated.bench.clamp(rig.now_s, mount_deg, "x")
    pass_time(rig, until_s - rig.now_s)


@pytest.mark.parametrize(("chosen", "slips_at_s"), SLIPS.values(), ids=SLIPS)
def test_a_run_with_a_slip_does_not_displace_a_good_calibration(make_rig, lab, chosen, slips_at_s):
    rig = make_rig(mount={"slip_deg": 0.6, "slip_at_s": slips_at_s})
    with lab(rig) as here:
        good = here.is_in_force(here.run(SLIPS["at a turning point"][0]))
        slipped = here.run(chosen)
        here.stays_a_draft(slipped, "residual")
        if slips_at_s == SLIPS["at a turning point"][1]:
            here.stays_a_draft(slipped, "move_mismatch")
        (says,) = (doubt["says"] for doubt in slipped["result"]["doubts"] if doubt["kind"] == "residual")
        assert f"that of revision {good} in force is 0.012°" in says
        assert here.in_force() == good


@pytest.mark.parametrize("release", ["auto", "pass"])
def test_a_slip_that_was_noticed_is_released_by_nobody_but_a_person_with_a_reason(make_rig, lab, release):
    rig = make_rig(mount={"slip_deg": 0.6, "slip_at_s": SLIPS_AT_S})
    with lab(rig, release=release) as here:
        run = here.run(plan(elevations_deg=LEARNING, order="given"))
        assert run["faults"]["move_mismatch"] == 1
        revision = here.stays_a_draft(run, "move_mismatch")
        assert here.in_force() is None
        before = here.document()
        for body in ({}, {"reason": " "}):
            refused = here.release(revision, **body)
            assert (refused.status_code, "reason" in refused.json()["detail"]) == (422, True)
        assert here.in_force() is None
        released = here.release(revision, reason="within what we need").raise_for_status().json()
        assert (released["status"], released["warnings"]) == ("in_force", before["warnings"])
        assert here.document(revision) == before
        assert [one["what"] for one in here.feed(revision)] == ["drafted", "released"]
        header = here.client.get(f"/api/units/{here.unit}/calibration?format=c-header").text
        assert "WARNING: Not to be relied on" in header


def test_a_table_turned_by_hand_between_two_runs_makes_drafts_alone(open_loop, lab, store):
    """By 6°, on a stage without homing; before and after three repeats tell what remounting adds."""
    for repeats in range(5):
        with lab(open_loop) as here:
            good = here.is_in_force(here.run())
        if repeats not in (0, 4):
            continue
        turned_by(store, open_loop, 6.0)
        with lab(open_loop) as here:
            wrong = here.run()
            assert wrong["result"]["bias_deg"] == pytest.approx(OFFSET_DEG + 6.0, abs=0.1)
            here.stays_a_draft(wrong, "changed", "unmeasured_position", "clamping")
            assert here.in_force() == good
            here.client.post(f"/api/runs/{wrong['id']}/void", json={"reason": "turned"}).raise_for_status()
        turned_by(store, open_loop, -6.0)


def test_a_wrong_bias_is_not_what_the_unit_should_read_in_the_next_run(open_loop, lab, store):
    """9° are let pass, as a draft; 14° from what the unit is known to read are not."""
    with lab(open_loop) as here:
        here.is_in_force(here.run())
    turned_by(store, open_loop, 9.0)
    with lab(open_loop) as here:
        here.stays_a_draft(here.run(), "changed")
    turned_by(store, open_loop, 5.0)
    with lab(open_loop) as here:
        begun = here.client.post("/api/runs", json={"unit": here.unit, "plan": {"sweeps": 1}}).json()
        here.service.wait(begun["id"], 120)
        refused = here.client.get(f"/api/runs/{begun['id']}").json()
    assert refused["status"] == "failed"
    assert "nothing was moved" in refused["error"]


def test_a_run_made_while_the_clamp_still_stood_elsewhere_stays_a_draft(make_rig, lab):
    rig = make_rig()
    with lab(rig) as here:
        good = here.is_in_force(here.run())
        clamp_anew(rig, 240.0)
        here.stays_a_draft(here.run(), "changed", "clamping")
        assert here.in_force() == good
    with lab(rig, of=f"{here.unit}-new") as here:
        here.stays_a_draft(here.run(), "clamping")


def test_good_units_of_a_queue_that_are_clamped_anew_are_released_by_themselves(make_rig, lab):
    """Three units, each clamped three times within a fraction of a degree."""
    rig = make_rig(mount={"seat_std_deg": 0.2})
    with lab(rig) as here:
        for _ in range(3):
            for unit in ("one", "two", "three"):
                clamp_anew(rig, 0.0)
                here.unit = f"queue-{unit}"
                here.is_in_force(here.run())


def test_runs_of_a_rig_with_four_effects_are_released_by_themselves(make_rig, lab):
    """The first of the README's flow, then a narrow one, a wide one and one from one side."""
    rig = make_rig(**DEMO_RIG.simulated)
    with lab(rig) as here:
        for chosen in (Plan(), *(chosen for chosen, _ in SLIPS.values()), Plan(sweeps=1)):
            run = here.run(chosen)
            assert run["verdict"]["left"] == "more_than_noise"
            here.is_in_force(run)


def test_repeats_of_a_unit_that_stayed_in_its_clamp_do_not_tell_what_remounting_adds(make_rig, lab):
    rig = make_rig()
    with lab(rig) as here:
        first = here.unit
        for _ in range(5):
            here.is_in_force(here.run())
        here.unit = f"{first}-other"
        here.is_in_force(here.run())
        here.unit = first
        clamp_anew(rig, 0.3)
        here.is_in_force(here.run())
        clamp_anew(rig, 0.8)
        here.stays_a_draft(here.run(), "changed")


def test_where_few_repeats_tell_the_rigs_remount_limit_decides(make_rig, lab):
    rig = make_rig()
    for limit_deg, mount_deg, released in ((1.0, 0.7, True), (0.5, 0.0, False), (1.0, 0.0, True)):
        with lab(rig, remount_limit_deg=limit_deg) as here:
            if not here.client.get(f"/api/units/{here.unit}").is_success:
                here.is_in_force(here.run())
            clamp_anew(rig, mount_deg)
            run = here.run()
            here.is_in_force(run) if released else here.stays_a_draft(run, "changed")


def test_a_person_releases_what_is_in_no_doubt_without_a_reason(bench, lab):
    with lab(bench, release="manual") as here:
        run = here.run()
        assert (run["verdict"]["reliable"], here.document()["warnings"]) == (True, [])
        assert here.statuses() == ["draft"]
        assert here.release(1).json()["status"] == "in_force"


def test_of_what_is_doubtful_nothing_is_decided_unless_it_fails(make_rig, lab):
    """By its limits: `undecided`, and `fail` where a limit is missed however doubtful the run is."""
    rig = make_rig(mount={"slip_deg": 0.6, "slip_at_s": SLIPS_AT_S})
    with lab(rig) as here:
        run = here.run(plan(elevations_deg=LEARNING, order="given"))
        for most_deg, answer in ((5.0, "undecided"), (0.001, "fail")):
            limit = {"name": "doubtful", "units": here.unit, "max_error_deg": most_deg}
            here.client.put("/api/limits", json=[limit]).raise_for_status()
            verdict = here.client.get(f"/api/runs/{run['id']}").json()["verdict"]
            assert (verdict["answer"], verdict["reliable"]) == (answer, False)
        found = here.client.get("/api/runs?verdict=fail").json()["items"]
        assert run["id"] in {one["id"] for one in found}
        here.client.put("/api/limits", json=[]).raise_for_status()


def test_an_import_is_compared_with_what_is_in_force_as_a_run_is(bench, lab):
    poses = "target_deg,reading_deg\n" + "".join(f"{x},{x + 0.5}\n" for x in (-40, -20, 0, 20, 40))
    with lab(bench) as here:
        imported(here.client, here.unit, poses)
        imported(here.client, here.unit, poses.replace(".5", ".6"))
        far = imported(here.client, here.unit, "target_deg,reading_deg\n-40,-41.5\n0,0.5\n40,42.5\n")
        here.stays_a_draft(far, "changed")
        assert here.statuses() == ["draft", "in_force", "superseded"]
