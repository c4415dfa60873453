"""Diagnose the measured logs beside this repository, as a table: `python -m tests.studies.measured`."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Any

from repository import SHARED

from calrig.calibration.diagnosis.tracing import diagnose, document
from calrig.export.poses_csv import read_poses

DATA = Path(os.environ.get("CALRIG_DATA", SHARED / "data"))
HEAD = "| log | found | bias and scale | with effects | held out, interleaved | held out, in blocks |"


def _words(effect: dict[str, Any]) -> str:
    """An effect, what it is confused with, and the parameters that were fitted."""
    name = f"{effect['name']} of {effect['covariate']}" if effect["name"] == "unnamed" else effect["name"]
    if effect["confusable_with"]:
        name = f"{{{', '.join([name, *effect['confusable_with']])}}}"
    fitted = [
        f"{key} {one['value']:.4g} ± {one['std']:.2g}"
        for key, one in effect["parameters"].items()
        if one is not None and one["std"]
    ]
    return f"{name} ({', '.join(fitted)})" if fitted else name


def _row(path: Path) -> str:
    said = document(diagnose([read_poses(path.read_bytes()).poses]), [path.stem])
    before, after = said["base"], said["final"]
    found = "; ".join(map(_words, said["effects"])) or "nothing"
    errors = [
        f"{before['fit_rms_deg']:.5f}°",
        f"{after['fit_rms_deg']:.5f}°",
        f"{before['held_out_rms_deg']:.5f}° → {after['held_out_rms_deg']:.5f}°",
        f"{before['blocked_rms_deg']:.5f}° → {after['blocked_rms_deg']:.5f}°",
    ]
    return f"| {path.stem.removesuffix('_poses')} | {found} | {' | '.join(errors)} |"


def main() -> None:
    """Prints the table."""
    logs = sorted(DATA.glob("*_poses.csv"))
    if not logs:
        sys.exit(f"measured logs are not here: {DATA}")
    sys.stdout.write(f"{HEAD}\n|{' --- |' * 6}\n")
    for path in logs:
        sys.stdout.write(f"{_row(path)}\n")
        sys.stdout.flush()


if __name__ == "__main__":
    main()
