"""Whether an archive is what was written: by itself, without the store that it came from."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from calrig.calibration.poses import Pose
from calrig.canonical_json import sha256_of
from calrig.export.archive import layout
from calrig.export.archive.kept import Problem, Said, document_problems, said_by_trail
from calrig.export.archive.opened import DamagedError, Opened, opened
from calrig.export.archive.refit import NotRefitted, differences
from calrig.export.poses_csv import read_poses
from calrig.store.records import AcceptedEffect

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
        """A member; of one that was told to be damaged or missing no second thing is told."""
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
        """What goes wrong with a part is told, and the others are looked at."""
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
