"""Verification of an archive by itself, without the store that it came from.

It is checked against its own hashes, its parts (audit trail, list of revisions, documents) against one
another, and the numbers of each document against a new fit of the archive's poses by this program.
"""

import hashlib
import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from calrig.calibration.effects import effect_of
from calrig.calibration.line import Line, rms
from calrig.calibration.poses import Pose
from calrig.calibration.regression import ApplyError
from calrig.calibration.results import (
    AppliedEffect,
    angles_deg,
    build_result,
    circumstances,
    readings_left_deg,
    unit_slopes,
)
from calrig.calibration.separation import MountedPoses, dial_of, solve, with_map
from calrig.canonical_json import sha256_of
from calrig.export.archive import layout
from calrig.export.archive.opened import DamagedError, Opened, opened
from calrig.export.calibration_document import SCHEMA, calibration_content
from calrig.export.poses_csv import read_poses
from calrig.export.solution_documents import unit_documents
from calrig.model.run import mount_axis
from calrig.store.records import AcceptedEffect, Document, as_applied, doubt_of, filtering_of, map_of
from calrig.store.trail import FIRST, is_chained

Read = Callable[[str], bytes | None]
"""Gives a member; None of one that is known to be damaged or missing."""
RunOf = Callable[[str], tuple[dict[str, Any], list[Pose], list[int]]]
"""Gives a run with its poses and their indices."""
Problem = tuple[str, str]
"""Where, and what is wrong there."""


@dataclass
class Said:
    """What the trail says.

    Attributes:
        revisions: of each, the hash of its document and its state.
        certificates: of each that was issued, by number, the hashes of its bytes.
    """

    revisions: dict[int, tuple[str, str]] = field(default_factory=dict)
    certificates: dict[str, dict[str, str | None]] = field(default_factory=dict)


def said_by_trail(lines: bytes, manifest: Mapping[str, Any]) -> Said:
    """What the unit's entries of the trail say of its revisions and certificates.

    An entry's hash is over the one before it and all that it says. Entries of other units between two of this
    one's are not here, so that the chain is proven within each entry, from one to the next where they follow
    one another, and at the head where that is of this unit; across a gap the store itself can prove it.

    `lines` have an entry each; `manifest` is what the archive's says of the trail.

    Raises:
        DamagedError: an entry is not what was written, or one is missing.
    """
    said = Said()
    seq, before = 0, FIRST
    entries = [json.loads(line) for line in lines.splitlines()]
    for entry in entries:
        where = f"{layout.TRAIL}, entry {entry['seq']}"
        follows = entry["seq"] == seq + 1
        if entry["seq"] <= seq or (follows and entry["before"] != before):
            raise DamagedError(where, "does not go on from the entry before it")
        if not is_chained(entry["before"], entry):
            raise DamagedError(where, "is not what was written: its hash is another")
        seq, before = entry["seq"], entry["sha256"]
        _replay(said, entry)
    head = manifest["head"] or {"seq": 0, "sha256": FIRST}
    if len(entries) != manifest["entries"]:
        raise DamagedError(layout.TRAIL, f"has {len(entries)} entries, and had {manifest['entries']}")
    if head["seq"] < seq or (head["seq"] == seq and head["sha256"] != before):
        raise DamagedError(layout.TRAIL, f"does not lead to its head, entry {head['seq']}")
    return said


def _replay(said: Said, entry: Mapping[str, Any]) -> None:
    what, number, revisions = entry["what"], entry["revision"], said.revisions
    if what == "unit_removed":
        revisions.clear()
    elif what == "drafted":
        revisions[number] = entry["detail"]["sha256"], "draft"
    elif what == "released":
        for other, (sha256, state) in revisions.items():
            if state == "in_force":
                revisions[other] = sha256, "superseded"
        revisions[number] = revisions[number][0], "in_force"
    elif what == "withdrawn":
        revisions[number] = revisions[number][0], "withdrawn"
    elif what == "certificate_issued":
        said.certificates[entry["detail"]["number"]] = dict(entry["detail"]["sha256"])


def certificate_problems(said: Said, names: Sequence[str], read: Read) -> Iterator[Problem]:
    """What is wrong with the issued certificates."""
    expected = {
        layout.certificate_name(number, form): sha256[form]
        for number, sha256 in said.certificates.items()
        for form in ("pdf", "dcc")
        if sha256[form] is not None
    }
    for name, sha256 in expected.items():
        if name not in names:
            yield layout.TRAIL, f"tells of {name}, which is missing"
        elif (content := read(name)) is not None and hashlib.sha256(content).hexdigest() != sha256:
            yield name, "is not what was issued: the trail has another SHA-256"
    for name in sorted(filter(layout.is_issued, set(names) - expected.keys())):
        if read(name) is not None:
            yield name, "was never issued: the trail does not tell of it"


def document_problems(
    revisions: Sequence[Mapping[str, Any]], said: Said | None, manifest: Mapping[str, Any], read: Read
) -> Iterator[Problem]:
    """What is wrong with the documents, and with the list of them.

    `said` is by the trail, None where that cannot be read; `read` gives a document.
    """
    in_force = [one["revision"] for one in revisions if one["status"] == "in_force"]
    if in_force != [number for number in [manifest["revision_in_force"]] if number is not None]:
        yield layout.REVISIONS, f"has {in_force} in force, and the manifest {manifest['revision_in_force']}"
    for one in revisions:
        where = layout.document_name(one["revision"])
        if one["file"] != where:
            yield layout.REVISIONS, f"has revision {one['revision']} in {one['file']!r}"
        if (content := read(where)) is None:
            continue
        document = json.loads(content)
        sha256 = sha256_of(document)
        if not sha256 == document["sha256"] == one["sha256"]:
            yield where, "is not what was issued: its SHA-256 is another"
        stated = {name: document[name] for name in ("unit", "revision", "run_id")}
        if stated != {"unit": manifest["unit"], "revision": one["revision"], "run_id": one["run_id"]}:
            yield where, f"is of {stated}, and the list has it otherwise"
        if said is not None and said.revisions.get(one["revision"]) != (sha256, one["status"]):
            yield where, f"is {one['status']} by the list, and the trail says otherwise"
    listed = {one["revision"] for one in revisions}
    for number in sorted(set() if said is None else said.revisions.keys() - listed):
        yield layout.REVISIONS, f"lacks revision {number}, which the trail tells of"


FIGURES = (
    "range_deg",
    "bias_deg",
    "scale",
    "rms_raw_deg",
    "rms_calibrated_deg",
    "temperature_c",
)
"""What follows from poses and effects alone. Uncertainty and covariance are as its program had them."""
Tolerance = tuple[float, float]
"""Relative and absolute difference that rounding may cause."""
EXACT, FITTED, SOLVED = (0.0, 0.0), (1e-6, 1e-9), (1e-4, 1e-6)
"""Of accepted effects, of a line's figures, and of a joint solution, which is found by iteration."""


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

    `basis` is what its draft rested on; `poses` are all of the run, excluded ones too.

    Raises:
        NotRefitted: something that the fit needs is not there.
    """
    _require_known(document)
    counted = _counted(run, poses, indices, basis["excluded"])
    if not counted:
        raise NotRefitted("its run has no poses here")
    accepted = _accepted(basis, effects)
    in_force = map_of(run["provenance"])
    if in_force is not None and in_force.covers(dial_of(counted)[0]).all():
        counted = with_map(counted, in_force)
        accepted = [effect for effect in accepted if effect.unit is not None]  # the rig's are in the map
    with np.errstate(all="ignore"):
        result = build_result(counted, None, as_applied(accepted), doubt=doubt_of(accepted))
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
        with_effects_deg = [again["rms_with_effects_deg"]]
        if (line := result.line_with_effects) is not None:
            with_effects_deg.append(_by_slope_deg(counted, line, as_applied(accepted)))
    yield from _unlike(document, again, FITTED)
    stated = document["rms_with_effects_deg"]
    if not any(_same(stated, one, FITTED) for one in with_effects_deg):
        yield f"rms_with_effects_deg is {stated}, and its poses give {with_effects_deg[0]}"


def _by_slope_deg(poses: Sequence[Pose], line: Line, effects: Sequence[AppliedEffect]) -> float:
    """Return RMS with effects as documents of before have it: by the slope of the curve."""
    theta, _ = angles_deg(poses)
    slopes = unit_slopes(theta, line, effects, circumstances(poses))
    return rms(readings_left_deg(poses, line, effects) / slopes)


def solution_differences(
    document: Document, basis: Document, stale: Sequence[str], run_of: RunOf
) -> Iterator[str]:
    """Solve a joint solution again, and yield what of a unit's document it does not give.

    `basis` is a `calrig.store.records.Basis`; `stale` says what has changed of the runs since.

    Raises:
        NotRefitted: something that the solution needs is not there.
    """
    if document["schema"] != SCHEMA:
        raise NotRefitted(f"this program makes {SCHEMA}, and it is {document['schema']}")
    if len(basis["units"]) > 1:
        raise NotRefitted("its joint solution is of several units, and runs of others are not in an archive")
    if stale:
        raise NotRefitted(f"its joint solution has an outdated basis: {' '.join(stale)}")
    lots: list[MountedPoses] = []
    for run_id in basis["runs"]:
        run, poses, indices = run_of(run_id)
        plan = run["plan"] or {}
        axis = mount_axis(run["plan"], run["provenance"])
        if axis != "x":
            raise NotRefitted("its joint solution is of units clamped by several faces")
        counted = _counted(run, poses, indices, map(int, run["poses"]["excluded"]))
        planned_deg = plan.get("mounts_deg") or [0.0]
        lots += MountedPoses.of_run(
            counted, unit=run["unit"], run_id=run_id, name=run_id, axis=axis, planned_deg=planned_deg
        )
    with np.errstate(all="ignore"):
        solution = solve(
            lots,
            linear=basis["linear"],
            periods_deg=basis["periods_deg"],
            seat_std_deg=basis["seat_std_deg"],
        )
        again = unit_documents(solution, basis["frame"], basis["rig"])[document["unit"]]
    yield from _unlike(document, again, SOLVED)


def _counted(
    run: Document, poses: Sequence[Pose], indices: Sequence[int], excluded: Iterable[int]
) -> list[Pose]:
    """Poses of a run but those excluded, filtered as its plan says."""
    filtering, out = filtering_of(run["provenance"], run["plan"]), set(excluded)
    return [
        replace(pose, filtering=filtering)
        for pose, index in zip(poses, indices, strict=True)
        if index not in out
    ]


def _unlike(document: Document, again: Document, tolerance: Tolerance) -> Iterator[str]:
    """Yield the figures and effects of a document that differ from those fitted again."""
    for name in FIGURES:
        value = again[name]
        if name == "bias_deg":  # documents of before have it within half a turn of 0
            value += 360.0 * round((document[name] - value) / 360.0)
        if name == "rms_raw_deg" and abs(again["bias_deg"]) > 180.0:
            continue  # likewise
        if not _same(document[name], value, tolerance):
            yield f"{name} is {document[name]}, and its poses give {value}"
    stated, found = (
        [(effect["name"], effect["parameters"]) for effect in one["effects"]] for one in (document, again)
    )
    if not _same(stated, found, EXACT if tolerance is FITTED else tolerance):
        yield f"its effects are {_names(stated)}, and those accepted are {_names(found)} with other values"


def _require_known(document: Document) -> None:
    if document["schema"] != SCHEMA:
        raise NotRefitted(f"this program makes {SCHEMA}, and it is {document['schema']}")
    if "elevation_std_deg" in document:
        raise NotRefitted("its joint solution is not in the archive")


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


def _same(stated: Any, again: Any, tolerance: Tolerance) -> bool:
    """Whether two figures, or documents of such, are the same but for rounding."""
    if isinstance(stated, dict) and isinstance(again, dict):
        return stated.keys() == again.keys() and all(
            _same(stated[key], again[key], tolerance) for key in stated
        )
    if isinstance(stated, list | tuple) and isinstance(again, list | tuple):
        pairs = zip(stated, again, strict=False)
        return len(stated) == len(again) and all(_same(*pair, tolerance) for pair in pairs)
    if isinstance(stated, str) or stated is None or again is None:
        return bool(stated == again)
    relative, absolute = tolerance
    return bool(np.isclose(float(stated), float(again), rtol=relative, atol=absolute))


def _names(effects: Sequence[tuple[str, Any]]) -> str:
    return ", ".join(name for name, _ in effects) or "none"


MALFORMED = (KeyError, TypeError, ValueError, AttributeError, IndexError, ArithmeticError, RecursionError)
"""What a document raises that is none of calrig's."""


@dataclass
class Checked:
    """What is wrong with an archive, and what of it is in order.

    Attributes:
        problems: where and what, one each.
        unit: whose it is; None where not even that is known.
        trail: as the manifest has it: `entries`, `head` (`seq`, `sha256`), `broken_at`.
        refitted: revisions whose numbers its poses give.
        not_refitted: those that cannot be fitted again here, and why.
    """

    problems: list[Problem] = field(default_factory=list)
    unit: str | None = None
    as_of: str | None = None
    calrig: str | None = None
    files: int = 0
    revisions: int = 0
    runs: int = 0
    trail: dict[str, Any] | None = None
    refitted: list[int] = field(default_factory=list)
    not_refitted: dict[int, str] = field(default_factory=dict)

    def to_dict(self) -> dict[str, Any]:
        """Ready for JSON."""
        plain = ("unit", "as_of", "calrig", "files", "revisions", "runs", "trail", "refitted")
        return {
            "intact": not self.problems,
            **{name: getattr(self, name) for name in plain},
            "not_refitted": [{"revision": n, "why": why} for n, why in self.not_refitted.items()],
            "problems": [{"where": where, "what": what} for where, what in self.problems],
        }


def check_archive(path: Path) -> Checked:
    """Looks through an archive.

    Raises:
        InputError: it is no zip file, or cannot be read.
    """
    found = Checked()
    try:
        with opened(path) as (archive, wrong):
            found.problems += [(one.where, one.what) for one in wrong]
            _Look(archive, found).at_all()
    except DamagedError as error:
        found.problems.append((error.where, error.what))
    return found


class _Look:
    """A look through the members of an archive."""

    def __init__(self, archive: Opened, found: Checked) -> None:
        self._archive, self._found = archive, found
        self._sound: set[str] = set()

    def at_all(self) -> None:
        """Files first: of a damaged one nothing more is said."""
        manifest: dict[str, Any] | None = None
        with self._told(layout.MANIFEST):
            manifest = self._manifest()
        if manifest is None:
            return
        self._files(manifest["files"])
        said: Said | None = None
        with self._told(layout.TRAIL):
            said = said_by_trail(self._read(layout.TRAIL), manifest["trail"])
            names = self._archive.names
            self._found.problems += certificate_problems(said, names, self._known)
        revisions: list[dict[str, Any]] = []
        with self._told(layout.REVISIONS):
            revisions = json.loads(self._read(layout.REVISIONS))
            self._found.revisions = len(revisions)
            self._found.problems += document_problems(revisions, said, manifest, self._known)
        with self._told(layout.RUNS):
            self._runs()
        with self._told(layout.EFFECTS):
            self._refit(revisions)

    def _manifest(self) -> dict[str, Any]:
        manifest = json.loads(self._archive.read(layout.MANIFEST))
        if manifest["schema"] != layout.SCHEMA:
            said = f"is of {manifest['schema']!r}, and this program checks {layout.SCHEMA}"
            raise DamagedError(layout.MANIFEST, said)
        if sha256_of(manifest) != manifest["sha256"]:
            raise DamagedError(layout.MANIFEST, "is not what was written: its SHA-256 is another")
        if not all(isinstance(one["path"], str) for one in manifest["files"]):
            raise TypeError("a path is no text")
        found = self._found
        found.unit, found.as_of, found.calrig = (manifest[name] for name in ("unit", "as_of", "calrig"))
        found.files, found.trail = len(manifest["files"]), manifest["trail"]
        if (broken_at := manifest["trail"]["broken_at"]) is not None:
            said = f"the store's own was broken at entry {broken_at} when the archive was made"
            found.problems.append((layout.TRAIL, said))
        return dict(manifest)

    def _files(self, files: Sequence[Mapping[str, Any]]) -> None:
        """Each file by size and hash; nothing extra, nothing missing."""
        listed = {one["path"]: one for one in files}
        for name in self._archive.names:
            if name != layout.MANIFEST and name not in listed:
                self._found.problems.append((name, "is not in the manifest"))
        for name, one in listed.items():
            with self._told(name):
                self._file(name, one["size"], one["sha256"])
                self._sound.add(name)

    def _file(self, name: str, size: int, sha256: str) -> None:
        if name not in self._archive.names:
            raise DamagedError(name, "is missing")
        content, n_bytes = hashlib.sha256(), 0
        for piece in self._archive.pieces(name):
            content.update(piece)
            n_bytes += len(piece)
        if n_bytes != size:
            raise DamagedError(name, f"has {n_bytes} bytes, and had {size}")
        if content.hexdigest() != sha256:
            raise DamagedError(name, "is not what was written: its SHA-256 is another")

    def _read(self, name: str) -> bytes:
        """Return a member; one reported as damaged or missing is not reported again."""
        if name not in self._sound:
            raise _ToldAlready
        return self._archive.read(name)

    def _known(self, name: str) -> bytes | None:
        return self._archive.read(name) if name in self._sound else None

    def _runs(self) -> None:
        listed = json.loads(self._read(layout.RUNS))
        self._found.runs = len(listed)
        expected = {name for one in listed for name in layout.run_names(one["run_id"])}
        of_runs = {name for name in self._archive.names if name.startswith("runs/")}
        for name in sorted(expected - of_runs):
            self._found.problems.append((layout.RUNS, f"lists a run whose {name} is missing"))
        for name in sorted(of_runs - expected):
            self._found.problems.append((name, "is of a run that is not listed"))
        for one in listed:
            name = layout.run_names(one["run_id"])[0]
            with self._told(name):
                run = json.loads(self._read(name))
                if (run["id"], run["unit"], run["status"]) != (one["run_id"], one["unit"], one["status"]):
                    raise DamagedError(name, "is not what the list of runs says")

    def _refit(self, revisions: Sequence[Mapping[str, Any]]) -> None:
        listed = [AcceptedEffect(**one) for one in json.loads(self._read(layout.EFFECTS))]
        effects = {int(one.id): one for one in listed if one.id is not None}
        for one in sorted(revisions, key=lambda one: str(one["run_id"])):
            number = one["revision"]
            name = layout.document_name(number)
            with self._told(name):
                try:
                    document = json.loads(self._read(name))
                    if one.get("solution") is not None:
                        wrong = list(solution_differences(document, one["solution"], one["stale"], self._run))
                    else:
                        run, poses, indices = self._run(one["run_id"])
                        wrong = list(differences(document, one["basis"], effects, run, poses, indices))
                except NotRefitted as error:
                    self._found.not_refitted[number] = str(error)
                    continue
                self._found.problems += [(name, what) for what in wrong]
                if not wrong:
                    self._found.refitted.append(number)
        self._found.refitted.sort()

    def _run(self, run_id: str) -> tuple[dict[str, Any], list[Pose], list[int]]:
        """A run with its poses and their indices; of the last one asked for from memory."""
        names = layout.run_names(run_id)
        if any(name not in self._archive.names for name in names):
            raise NotRefitted(f"its run {run_id} is not in the archive")
        if self._archive.size(names[1]) > layout.LARGEST_READ:
            raise NotRefitted(f"the poses of its run {run_id} are too many to be read at once")
        run = json.loads(self._read(names[0]))
        poses = read_poses(self._read(names[1])).poses
        spans = run["poses"]["indices"]
        if sum(last - first + 1 for first, last in spans) != len(poses):
            raise DamagedError(names[1], f"has {len(poses)} poses, and the run others")
        return run, poses, [index for first, last in spans for index in range(first, last + 1)]

    @contextmanager
    def _told(self, where: str) -> Iterator[None]:
        """Report an error in one part, and check the others."""
        try:
            yield
        except _ToldAlready:
            pass
        except DamagedError as error:
            self._found.problems.append((error.where, error.what))
        except MALFORMED as error:
            what = f"is not what calrig writes ({type(error).__name__}: {error})"
            self._found.problems.append((where, what))


class _ToldAlready(Exception):  # noqa: N818 (an answer, not a fault)
    """What a part was wanted for cannot be looked at, and why has been said."""
