"""What is in a unit's archive, by which names, and how large any of it may be."""

import json
import re
from typing import Any

SCHEMA = "calrig.archive/1"
MANIFEST = "manifest.json"
README = "README.txt"
REVISIONS = "revisions.json"
EFFECTS = "effects.json"
RUNS = "runs.json"
TRAIL = "trail.jsonl"

COMMENT_BYTES = 64
"""The zip's comment: SHA-256, in hexadecimal, of every byte before it."""
LARGEST_READ = 64 * 2**20
"""Bytes of a member that is read as a whole: documents, poses, the trail."""
LARGEST_DIRECTORY = 64 * 2**20
MOST_MEMBERS = 200_000
LARGEST_TOTAL = 256 * 2**30
"""Bytes unpacked: a hundred days of samples at 200 Hz."""
LARGEST_RATIO = 100
"""Unpacked to packed; text of measured numbers has 3 to 10."""

_RUN_ID = r"(?:[0-9a-f]{8}(?:-[0-9a-f]{4}){3}-[0-9a-f]{12}|[1-9][0-9]{0,17})"
_NAMES = re.compile(
    rf"{MANIFEST}|{README}|{REVISIONS}|{EFFECTS}|{RUNS}|{TRAIL}"
    r"|revisions/[0-9]{4,10}\.json|certificates/[0-9]{4,10}(?:-[0-9A-F]{12})?\.(?:xml|pdf)"
    rf"|runs/{_RUN_ID}/(?:run\.json|poses\.csv|samples\.csv)",
    re.ASCII,
)

WHAT_IT_IS = """\
This is the archive of one sensor unit, made by calrig. `calrig verify FILE.zip` checks it on any machine.

manifest.json       what is in here: each file's size and SHA-256, and the head of the audit trail
revisions.json      every issued revision of the calibration: state, who, when, why, what it rests on
revisions/N.json    each revision's document, byte for byte as issued
certificates/N.*    each issued certificate as a digital calibration certificate (XML) and, where made, as PDF
effects.json        the accepted effects that revisions rest on
runs.json           every run of the unit
runs/ID/run.json    a run: plan, result, diagnosis, provenance, excluded poses
runs/ID/poses.csv   its poses, one row each in the order of their index
runs/ID/samples.csv its raw samples: which pose, its move or its dwell
trail.jsonl         who did what to the unit, each entry with the hash that chains it to the one before

Angles are in degrees, time in seconds, acceleration in g (9.80665 m/s2), rates in deg/s, temperatures in
degrees Celsius. The zip's comment is the SHA-256 of every byte before it.
"""


def is_member_name(name: str) -> bool:
    """Whether an archive can have a member of that name: none leaves the folder it is unpacked into."""
    return _NAMES.fullmatch(name) is not None


def document_name(revision: int) -> str:
    """Where the document of a revision is."""
    return f"revisions/{revision:04d}.json"


def certificate_name(number: str, form: str) -> str:
    """Where an issued certificate is; `form` is `pdf` or `dcc`."""
    return f"certificates/{number}.{'xml' if form == 'dcc' else form}"


def is_issued(name: str) -> bool:
    """Whether a file is an issued certificate; archives of before have one of each revision instead."""
    return name.startswith("certificates/") and "-" in name


def run_names(run_id: str) -> tuple[str, str, str]:
    """Where a run, its poses and its samples are."""
    return f"runs/{run_id}/run.json", f"runs/{run_id}/poses.csv", f"runs/{run_id}/samples.csv"


def written(document: Any) -> str:
    """JSON of a member: an entry a line where people look, the same text for the same document."""
    return json.dumps(document, indent=1, ensure_ascii=False, allow_nan=False) + "\n"
