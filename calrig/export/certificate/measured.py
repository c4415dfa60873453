"""What a revision rests on: its poses, the standards that they were measured with, and their traceability.

The errors of the poses are given as found and as left, and step by step; standards and equipment are those
that the run's provenance states.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import date, datetime

import numpy as np

from calrig.calibration.effects import effect_of
from calrig.calibration.line import fit_line, rms
from calrig.calibration.poses import Pose
from calrig.calibration.regression import ORIGINS, ApplyError, Origin
from calrig.calibration.results import (
    AppliedEffect,
    angles_deg,
    circumstances,
    corrected_residuals_deg,
    fit_line_with_effects,
    nominal_deg,
    numbers_of,
    own_effect,
    raw_error_deg,
)
from calrig.calibration.uncertainty import places_deg
from calrig.estimation.angles import FloatArray, wrap_deg
from calrig.export.calibration_document import line_of
from calrig.export.certificate.content import (
    EffectFound,
    Point,
    Quantity,
    Residuals,
    Row,
    Standard,
    Step,
    by_itself,
)
from calrig.model.result import Reference, ReferenceFigures
from calrig.store.records import AcceptedEffect, Document, reference_of


@dataclass(frozen=True, slots=True)
class Measured:
    """The poses that a revision rests on, and what takes their errors out.

    Attributes:
        document: CONTRACT section 6.
        came_with: the document of the revision that the unit came with; None where it is found as it reads.
        of_stage: effects of the rig that were taken out in addition to the unit's own.
    """

    poses: Sequence[Pose]
    document: Document
    came_with: Document | None
    of_stage: Sequence[AcceptedEffect]

    def found_deg(self) -> FloatArray:
        """(n,) errors as the unit came: by the calibration that it had, or of its readings."""
        if self.came_with is not None:
            return self._left_deg(self.came_with, _own(self.came_with))
        theta, reading = angles_deg(self.poses)
        bias_deg = self.document["bias_deg"]
        return np.asarray(bias_deg + wrap_deg(reading - theta - bias_deg))

    def left_deg(self) -> FloatArray:
        """(n,) errors with this calibration."""
        return self._left_deg(self.document, _own(self.document))

    def residuals(self) -> Residuals:
        """Uncorrected, by the plain fit, then with more and more effects and the bias and scale beside them.

        The last step is the document's own, so that the RMS errors of the first two and of the last are those
        of the document.
        """
        theta, reading = angles_deg(self.poses)
        bias_deg = self.document["bias_deg"]
        raw_deg = np.array([raw_error_deg(pose, bias_deg=bias_deg) for pose in self.poses])
        steps = [_step("As the unit reads", raw_deg)]
        is_solved = "elevation_std_deg" in self.document  # 0 and 1 are its bias and scale, all is in effects
        effects = [*_of_stage(self.of_stage), *_own(self.document)]
        if not is_solved:
            plain = line_of(self.document)
            if effects:
                one_angle = len({pose.target_deg for pose in self.poses}) == 1
                plain = fit_line(theta, reading, one_angle=one_angle)
            steps.append(_step("Plain fit of bias and scale", plain.left_deg(theta, reading)))
        for k, (name, _) in enumerate(effects, 1):
            is_last = k == len(effects) or is_solved
            left = self._by(self.document if is_last else None, effects[:k])
            steps.append(_step(f"… and {effect_of(name).title.lower()}", left))
        of_run = " of one run of the joint solution" if is_solved else ""
        return Residuals(
            title=f"Residual of each pose{of_run}",
            elevation_deg=tuple(pose.theta_deg for pose in self.poses),
            approach=tuple(pose.approach or 0 for pose in self.poses),
            steps=tuple(step for step in steps if step is not None),
        )

    def points(self, expanded_deg: float | None) -> tuple[Point, ...]:
        """The errors by elevation."""
        theta, _ = angles_deg(self.poses)
        places = places_deg(theta, nominal_deg(self.poses))
        found, left = self.found_deg(), self.left_deg()
        if not self.document["level_known"]:  # as the verdict has it
            left = left - np.mean([left[places == place].mean() for place in np.unique(places)])
        points = []
        for place in np.unique(places):
            here = places == place
            points.append(
                Point(
                    elevation_deg=float(place),
                    n_poses=int(here.sum()),
                    **_spread("found", found[here]),
                    **_spread("left", left[here]),
                    expanded_deg=expanded_deg,
                )
            )
        return tuple(points)

    def _left_deg(self, document: Document, own: Sequence[AppliedEffect]) -> FloatArray:
        """By a document and the stage's effects; by its line alone where the poses lack what they need."""
        for effects in ([*_of_stage(self.of_stage), *own], own, ()):
            left_deg = self._by(document, effects)
            if left_deg is not None:
                return left_deg
        raise AssertionError("a line can always be applied")

    def _by(self, document: Document | None, effects: Sequence[AppliedEffect]) -> FloatArray | None:
        """By a document's bias and scale or, without it, those fitted beside these effects."""
        try:
            if document is not None:
                line = line_of(document)
            else:
                line = fit_line_with_effects(*angles_deg(self.poses), effects, circumstances(self.poses))
            return corrected_residuals_deg(self.poses, line, effects)
        except ApplyError:
            return None


def effects_found(
    effects: Sequence[Document], stds: Mapping[tuple[str, str, float], float] | None = None
) -> tuple[EffectFound, ...]:
    """Effects of a document, or of the rig, in the catalogue's words.

    `effects` have `name` and `parameters`; `stds` are standard errors by effect, parameter and its value, as
    far as they are known.
    """
    return tuple(
        _effect_found(one["name"], one.get("origin"), one["parameters"], stds or {}) for one in effects
    )


def _effect_found(
    name: str,
    origin: Origin | None,
    parameters: Mapping[str, float | None],
    stds: Mapping[tuple[str, str, float], float],
) -> EffectFound:
    effect = effect_of(name)
    if origin is None:  # of a unit's document, where a term of the angle is the sensor's
        origin = effect.origin if effect.scope == "unit" else "sensor"
    known = {parameter.name: parameter for parameter in effect.parameters}
    figures = []
    for key, value in parameters.items():
        if value is None:
            continue
        parameter = known.get(key)
        unit = (
            "" if parameter is None else (effect.covariate.unit if parameter.unit is None else parameter.unit)
        )
        title = key if parameter is None else f"{parameter.title} ({key})"
        figures.append(Quantity(key, title, value, unit, std=stds.get((name, key, value))))
    return EffectFound(name, effect.title_of(origin), effect.formula, ORIGINS[origin], tuple(figures))


def _own(document: Document) -> list[AppliedEffect]:
    return [own_effect(effect["name"], effect["parameters"]) for effect in document["effects"]]


def _of_stage(effects: Sequence[AcceptedEffect]) -> list[AppliedEffect]:
    return [(effect.name, numbers_of(effect.parameters)) for effect in effects]


def _step(title: str, left_deg: FloatArray | None) -> Step | None:
    if left_deg is None or not np.isfinite(left_deg).all():
        return None
    return Step(title, tuple(left_deg.tolist()), rms(left_deg))


def _spread(of: str, error_deg: FloatArray) -> dict[str, float]:
    return {
        f"{of}_deg": float(error_deg.mean()),
        f"{of}_low_deg": float(error_deg.min()),
        f"{of}_high_deg": float(error_deg.max()),
    }


ROLES = (
    ("reference", "Angle of the stage"),
    ("thermometer", "Temperature"),
    ("time_base", "Time"),
)
"""Keys of a rig's settings, and what each is the standard of."""
WITHOUT = {
    "thermometer": "the sensor's own die thermometer",
    "time_base": "the board's own clock",
}
"""What measures where nothing else is stated; of imported poses it is unknown."""


def standards_of(document: Document, measured_at: datetime | None) -> tuple[Standard, ...]:
    """The standards that a calibration document rests on; what was not stated of them is None.

    `document` is of CONTRACT section 6; due dates are compared with `measured_at`, when it was measured.
    """
    provenance = document["provenance"]
    rig = provenance.get("rig") or {}
    stated = tuple(
        _standard(key, role, rig, provenance, measured_at)
        for key, role in ROLES
        if key not in WITHOUT or rig.get(key) or "imported_from" not in provenance
    )
    if "elevation_std_deg" in document:
        return (_gravity(document), *stated[1:])
    by_map = document["uncertainty"].get("reference")
    return stated if by_map is None else (_map(by_map), *stated)


def _map(by_map: Document) -> Standard:
    """The stage's map that elevations rest on, which has no certificate but what it was solved from."""
    return Standard(
        role="Error of the stage",
        what=by_map["says"],
        uncertainty=f"standard uncertainty {by_itself(by_map['std_deg'])}°, {by_map['distribution']}",
        file="the map",
        sha256=by_map["sha256"],
    )


def _gravity(document: Document) -> Standard:
    """What the angles of a joint solution rest on, which no certificate is needed for."""
    worth = by_itself(document["uncertainty"]["reference_deg"])
    return Standard(
        role="Angle",
        what="gravity and the full turn, by stage, mounts and unit solved together",
        uncertainty=f"standard uncertainty {worth}°, normal",
    )


def traceable(document: Document) -> str:
    """To what the angles of a calibration document are traceable, a sentence."""
    if "elevation_std_deg" in document:
        return (
            "Angles rest on gravity and the full turn, by a joint solution of several mounts: on no "
            "certificate of the stage."
        )
    by_map = document["uncertainty"].get("reference")
    if by_map is not None:
        return f"Angles rest on {by_map['says']}: on gravity and the full turn, by several mounts."
    stated = (document["provenance"].get("rig") or {}).get("reference") or {}
    if stated.get("certificate") is None:
        return "No certificate of the stage is stated: angles are traceable no further than the stage's own."
    by = f" of {stated['issued_by']}" if stated.get("issued_by") else ""
    return f"Angles are traceable to the certificate {stated['certificate']}{by}."


def stated_reference(document: Document) -> Reference | None:
    """Return the reference of a calibration document; None if not stated, or in a joint solution."""
    by_map = document["uncertainty"].get("reference")
    if by_map is not None:
        return ReferenceFigures.model_validate(by_map).reference
    if "elevation_std_deg" in document:
        return None
    return reference_of(document["provenance"])


def _standard(
    key: str, role: str, rig: Document, provenance: Document, measured_at: datetime | None
) -> Standard:
    stated = rig.get(key) or {}
    due = _day(stated.get("due"))
    return Standard(
        role=role,
        what=stated.get("name") or WITHOUT.get(key) or _stage(provenance),
        uncertainty=_uncertainty(stated),
        certificate=stated.get("certificate"),
        file=stated.get("file"),
        sha256=stated.get("sha256"),
        issued_by=stated.get("issued_by"),
        issued_on=_day(stated.get("issued_at")),
        due=due,
        overdue=None if due is None or measured_at is None else measured_at.date() > due,
    )


def _stage(provenance: Document) -> str:
    stage = provenance.get("stage")
    if stage is None:
        return "the stage that the imported poses were taken on"
    return " ".join(str(part) for part in (stage["driver"], stage.get("firmware")) if part)


def _uncertainty(stated: Document) -> str | None:
    if stated.get("std_deg") is None:
        return None
    distribution = stated.get("distribution", "rectangular")
    return f"standard uncertainty {by_itself(stated['std_deg'])}°, {distribution}"


def _day(value: str | date | None) -> date | None:
    return date.fromisoformat(value) if isinstance(value, str) else value


def equipment_of(provenance: Document) -> tuple[Row, ...]:
    """The devices that measured, as they said who they are."""
    rig, stage, board = (provenance.get(key) or {} for key in ("rig", "stage", "board"))
    rows = [("Rig", rig.get("name"))]
    rows += [(f"Stage, {key.replace('_', ' ')}", stage.get(key)) for key in ("driver", "firmware")]
    rows += [(f"Board, {key.replace('_', ' ')}", board.get(key)) for key in ("driver", "firmware", "chip")]
    rows += [
        ("Accelerometer range (g)", board.get("accel_range_g")),
        ("Gyro range (°/s)", board.get("gyro_range_dps")),
        ("Computer", provenance.get("host")),
        ("Imported from", provenance.get("imported_from")),
    ]
    return tuple((name, str(value)) for name, value in rows if value not in (None, ""))
