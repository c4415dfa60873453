"""The sentences of a certificate: method, plan, limits, deviations, statements."""

from collections.abc import Mapping, Sequence
from typing import Any

from calrig.calibration.uncertainty import significant
from calrig.export.certificate.content import Row
from calrig.model.verdict import Limit
from calrig.store.records import Document, StoredPose

PAPER = (
    "Nirmal et al., Noise modeling and analysis of an IMU-based attitude sensor, "
    "Proc. SPIE 9912, 99126W (2016)"
)
GUIDES = (
    "JCGM 100:2008, Guide to the expression of uncertainty in measurement (GUM)",
    "JCGM 106:2012, The role of measurement uncertainty in conformity assessment",
    "ILAC-G8:09/2019, Guidelines on decision rules and statements of conformity",
)
STATEMENTS = (
    "The results relate only to the item named here, in the condition in which it was calibrated.",
    "This certificate is not to be reproduced except in full, unless the laboratory has approved in writing.",
)
FAULTS = {
    "crc": "packets of the board with a wrong checksum",
    "sequence_gap": "gaps in the board's samples",
    "repeated": "repeated samples",
    "frozen": "samples that stood still",
    "clock_jump": "jumps of the board's clock",
    "unparsed": "lines that could not be read",
    "late_reply": "late replies of a device",
    "retried_pose": "poses measured again",
    "move_mismatch": "moves that the unit felt otherwise than the stage reported",
}
ORDERS = {"sweep": "up and down by turns", "random": "at random", "given": "as given"}


def measurand(document: Document) -> str:
    """What was calibrated."""
    low, high = (f"{end:g}°".replace("-", "−") for end in document["range_deg"])
    what = f"Elevation about the unit's x axis, {low} to {high} (0° is z up)"
    if document["level_known"]:
        return f"{what}."
    return f"{what}, relative to its mean over this range: the level is not known."


def procedure(plan: Document | None, document: Document, n_poses: int) -> tuple[str, ...]:
    """How it was done."""
    how = (
        "A rotary stage tilts the unit to known elevations; at each it dwells, and the unit's reading is the "
        "mean of its Kalman-filtered elevation (two states: angle and gyro bias)."
        if plan is not None
        else "Readings of the unit at known elevations were supplied as a file and imported."
    )
    low, high = (f"{end:g}°".replace("-", "−") for end in document["range_deg"])
    solved = document["provenance"].get("solution")
    if solved is not None:
        return (how, *_solved(document, solved), f"Applying it: {document['model']}.")
    return (
        how,
        f"Bias and scale are least squares over {n_poses} poses between {low} and {high}, beside the effects "
        "accepted; the unit's own effects are part of the calibration, the stage's are taken out.",
        f"Applying it: {document['model']}.",
    )


def _solved(document: Document, solved: Document) -> tuple[str, ...]:
    """How a joint solution came about, and what it takes for granted."""
    provenance = document["provenance"]
    units = ", ".join(provenance["units"])
    said = (
        f"The unit was clamped at several angles. Stage, mounts and units ({units}) were solved together by "
        f"least squares over {len(solved['runs'])} runs, solution {solved['id']} of "
        f"{solved['solved_at'][:10]}: gravity and the full turn are the reference, and the "
        "stage's own angle counts as nominal.",
        "All that the unit does to gravity is in its effects, beside a scale of 1. The stage's error is "
        "taken out by the map of this solution, and the angle of the mount is the one that was found.",
    )
    if not provenance["linear"]:
        return said
    return (*said, "The unit was stated to be linear; no quadratic or cubic term was solved for.")


def plan_rows(plan: Document | None) -> tuple[Row, ...]:
    """A run's plan, in words."""
    if plan is None:
        return ()
    given = plan.get("elevations_deg")
    turns = plan.get("kind") == "sweep"
    steps = "read on the move, in stretches of" if turns else "in steps of"
    at_ends = ", at the ends" if turns else ""
    rows = [
        (
            "Elevations",
            ", ".join(f"{angle:g}°" for angle in given)
            if given is not None
            else f"{plan['start_deg']:g}° to {plan['stop_deg']:g}° {steps} {plan['step_deg']:g}°",
        ),
        ("Sweeps", f"{plan['sweeps']}, {ORDERS[plan['order']]}"),
        ("Settling", f"{plan['settle_s']:g} s{at_ends}"),
        ("Dwell", f"{plan['dwell_s']:g} s{at_ends}"),
        ("Sampling rate", f"{plan['rate_hz']} Hz"),
    ]
    if turns and plan.get("velocity_dps") is None:
        rows.append(("Speed of the stage", f"{plan['step_deg'] / plan['dwell_s']:g} °/s"))
    if plan.get("jitter_deg"):
        rows.append(("Jitter of the elevations", f"±{plan['jitter_deg']:g}°"))
    if plan.get("target_std_deg") is not None:
        rows.append(("Standard error aimed at", f"{plan['target_std_deg']:g}°"))
    if plan.get("velocity_dps") is not None:
        rows.append(("Speed of the stage", f"{plan['velocity_dps']:g} °/s"))
    if plan.get("wait_s"):
        rows.append(("Wait before each sweep", f"{plan['wait_s']:g} s"))
    if plan.get("wait_temperature_c") is not None:
        rows.append(("Temperature waited for", f"{plan['wait_temperature_c']:g} °C"))
    mounts = plan.get("mounts_deg")
    if mounts and list(mounts) != [0]:
        about = plan.get("mount_axis", "x")
        angles = ", ".join(f"{angle:g}°" for angle in mounts)
        rows.append(("Clamped in turn at", f"{angles}, its {about} axis along the stage's"))
    return tuple((name, text.replace("-", "−")) for name, text in rows)


def deviations(
    *,
    plan: Document | None,
    provenance: Document,
    faults: Mapping[str, int],
    excluded: Sequence[StoredPose],
    at_other_mounts: int,
) -> tuple[str, ...]:
    """What was not as the method has it."""
    said = []
    if provenance.get("simulated"):
        said.append(
            "The rig is a simulation: no item was measured, and this document shows what one looks like."
        )
    if plan is None:
        said.append("The poses were not measured by this program: they were imported from a file.")
    if at_other_mounts and "solution" not in provenance:
        said.append(
            f"{at_other_mounts} poses at further mounts do not count here: they are for the joint solution "
            "of stage, mounts and unit."
        )
    for pose in excluded:
        angle = f"{pose.pose.target_deg:g}°".replace("-", "−")
        said.append(f"Pose {pose.index} at {angle} does not count: {pose.excluded or 'excluded'}")
    for one in provenance.get("interruptions", ()):
        why = f" ({one['reason']})" if one.get("reason") else ""
        said.append(f"Interrupted after pose {one['after_poses']}{why}; resumed {one['resumed_at']}.")
    for kind, count in faults.items():
        if count:
            said.append(f"{count} {FAULTS.get(kind, kind.replace('_', ' '))}; none entered a reading.")
    said += provenance.get("warnings", ())
    return tuple(said)


def asks(limit: Limit | None) -> tuple[str, ...]:
    """What a limit asks, a sentence each."""
    if limit is None:
        return ()
    said = []
    if limit.max_error_deg is not None:
        said.append(f"largest error of a calibrated elevation: at most {significant(limit.max_error_deg)}°")
    if limit.bias_deg is not None:
        said.append(f"bias: {limit.bias_deg[0]:g}° to {limit.bias_deg[1]:g}°".replace("-", "−"))
    if limit.scale is not None:
        said.append(f"scale: {limit.scale[0]:g} to {limit.scale[1]:g}")
    if limit.rms_deg is not None:
        said.append(f"RMS of what is left: at most {significant(limit.rms_deg)}°")
    if limit.expanded_uncertainty_deg is not None:
        said.append(f"expanded uncertainty: at most {significant(limit.expanded_uncertainty_deg)}°")
    return tuple(said)


def software(version: str) -> tuple[str, ...]:
    """Return the evidence that the program is correct: the names of the tables that it is tested against."""
    return (
        f"calrig {version} is tested as a whole before each change of it: against independent programs "
        "(noise, filters, uncertainty), simulated rigs of known truth, and public logs of real devices.",
        "How often effects are found and rightly named, on poses held out, is in the tables of its documents "
        "calrig/docs/validation/performance.md, measured-logs.md and diagnosis.md beside it, each with the "
        "command that makes it again.",
    )


def flattened(value: Any, name: str = "") -> tuple[Row, ...]:
    """A JSON value, key by key: nested names joined by dots, numbers as JSON has them."""
    import json

    if isinstance(value, Mapping) and value:
        return tuple(
            row
            for key, item in value.items()
            for row in flattened(item, f"{name}.{key}" if name else str(key))
        )
    if isinstance(value, list) and any(isinstance(item, Mapping) for item in value):
        return tuple(row for k, item in enumerate(value) for row in flattened(item, f"{name}[{k}]"))
    return ((name, value if isinstance(value, str) else json.dumps(value, ensure_ascii=False)),)
