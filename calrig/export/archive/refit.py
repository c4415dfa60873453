"""Whether an archive's poses give the numbers of a document: the same fit once more, by today's program."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from calrig.calibration.effects import effect_of
from calrig.calibration.poses import Pose
from calrig.calibration.regression import ApplyError
from calrig.calibration.results import build_result, numbers_of
from calrig.calibration.separation import dial_of, with_map
from calrig.export.calibration_file import SCHEMA
from calrig.export.calibration_json import calibration_content
from calrig.store.records import AcceptedEffect, Document, filtering_of, map_of

FIGURES = (
    "range_deg",
    "bias_deg",
    "scale",
    "covariance",
    "rms_raw_deg",
    "rms_calibrated_deg",
    "rms_with_effects_deg",
    "temperature_c",
)
"""What follows from poses and effects alone. The uncertainty is as the program of its day had it."""
RELATIVE, ABSOLUTE = 1e-6, 1e-9
"""Another machine's linear algebra, and nothing that a reader of the document could see."""


class NotRefitted(Exception):  # noqa: N818 (an answer, not a fault)
    """The fit cannot be repeated from what is in the archive; the message says why."""


def differences(
    document: Document,
    basis: Document,
    effects: Mapping[int, AcceptedEffect],
    run: Document,
    poses: Sequence[Pose],
    indices: Sequence[int],
) -> Iterator[str]:
    """What of a document is not what the poses give, a sentence each.

    Args:
        document: CONTRACT section 6.
        basis: what its draft rested on: ids of effects, indices of excluded poses.
        effects: those accepted, by id.
        run: that it is of, with plan and provenance.
        poses: all of the run.
        indices: of each pose.

    Raises:
        NotRefitted: something that the fit needs is not there.
    """
    _require_known(document)
    filtering = filtering_of(run["provenance"], run["plan"])
    excluded = set(basis["excluded"])
    counted = [
        replace(pose, filtering=filtering)
        for pose, index in zip(poses, indices, strict=True)
        if index not in excluded
    ]
    if not counted:
        raise NotRefitted("its run has no poses here")
    accepted = _accepted(basis, effects)
    in_force = map_of(run["provenance"])
    if in_force is not None and in_force.covers(dial_of(counted)[0]).all():
        counted = with_map(counted, in_force)
        accepted = [effect for effect in accepted if effect.unit is not None]  # the rig's are in the map
    applied = [(effect.name, numbers_of(effect.parameters)) for effect in accepted]
    with np.errstate(all="ignore"):
        result = build_result(counted, None, applied)
        if result.scale is None:
            yield "its poses give no scale"
            return
        again = calibration_content(
            unit=document["unit"],
            rig=document["rig"],
            poses=counted,
            result=result,
            accepted=accepted,
        )
    for name in FIGURES:
        if not _same(document[name], again[name]):
            yield f"{name} is {document[name]}, and its poses give {again[name]}"
    stated, found = (
        [(effect["name"], effect["parameters"]) for effect in one["effects"]] for one in (document, again)
    )
    if stated != found:
        yield f"its effects are {_names(stated)}, and those accepted are {_names(found)} with other values"


def _require_known(document: Document) -> None:
    if document["schema"] != SCHEMA:
        raise NotRefitted(f"this program makes {SCHEMA}, and it is {document['schema']}")
    if "elevation_std_deg" in document:
        raise NotRefitted("it is of a joint solution of several runs")


def _accepted(basis: Document, effects: Mapping[int, AcceptedEffect]) -> list[AcceptedEffect]:
    accepted = []
    for key, name in basis["effects"].items():
        effect = effects.get(int(key))
        if effect is None or effect.name != name:
            raise NotRefitted(f"effect {key} ({name}) is not in the archive")
        try:
            effect_of(name)
        except ApplyError as error:
            raise NotRefitted(str(error)) from error
        accepted.append(effect)
    return accepted


def _same(stated: Any, again: Any) -> bool:
    """Whether two figures, or documents of such, are the same but for rounding."""
    if isinstance(stated, dict) and isinstance(again, dict):
        return stated.keys() == again.keys() and all(_same(stated[key], again[key]) for key in stated)
    if isinstance(stated, list | tuple) and isinstance(again, list | tuple):
        return len(stated) == len(again) and all(map(_same, stated, again))
    if stated is None or again is None:
        return stated is again
    return bool(np.isclose(float(stated), float(again), rtol=RELATIVE, atol=ABSOLUTE))


def _names(effects: Sequence[tuple[str, Any]]) -> str:
    return ", ".join(name for name, _ in effects) or "none"
