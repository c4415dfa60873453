"""What the centre makes of a run that a bench has completed: its result by what is in force here, a draft."""

from __future__ import annotations

from collections.abc import Sequence

from calrig.analysis.active_calibration import active_calibration
from calrig.analysis.errors import Conflict
from calrig.analysis.issuing import Fitted, Issuer
from calrig.analysis.results import ending_of, fitted, gyro_of
from calrig.store import Run, Store, StoredPose
from calrig.store.unpacking import Conclusion


def concluded(store: Store, issuer: Issuer, run: Run, stored: Sequence[StoredPose]) -> Conclusion:
    """The result of a completed run and its unit's next revision.

    A bench knows neither which effects are in force nor the units' revisions: its own result serves for what
    it says of the gyro, which is from samples.
    """
    poses, gyro = [one.pose for one in stored if one.excluded is None], gyro_of(run)
    if not poses:
        return None, None
    if run.kind == "verification":
        try:
            applied = active_calibration(store, run.unit, run.rig, run.provenance.get("verifies_revision"))
        except Conflict:  # it was verified by a revision that this store has never had
            return run.result, None
        return applied.result(poses, gyro).to_dict(), None
    accepted = store.effects_in_force(run.unit, run.rig)
    result = fitted(poses, accepted, run.provenance, gyro, ending_of(run))
    excluded = [one.index for one in stored if one.excluded is not None]
    return result.to_dict(), issuer.completing(run, Fitted(poses, result, accepted, excluded))
