"""The house's own rules: the walls between packages hold, and CI runs the README's command."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parent.parent


def test_the_walls_between_packages_hold():
    command = [
        sys.executable,
        "-c",
        "from importlinter.cli import lint_imports_command; lint_imports_command()",
    ]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr


def test_no_thread_of_a_test_keeps_its_process_from_ending():
    """One that waits for what a failed test has not sent would."""
    started = re.compile(r"threading\.Thread\((?:[^()]|\([^()]*\))*\)")
    files = [path for path in (ROOT / "tests").rglob("*.py") if path != Path(__file__)]
    threads = [(path.name, thread) for path in files for thread in started.findall(path.read_text("utf-8"))]
    assert len(threads) > 10
    assert [one for one in threads if "daemon=True" not in one[1]] == []


def test_ci_runs_the_readmes_test_command_first():
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    quick_start = readme.split("```sh")[1].split("```")[0].strip().splitlines()
    assert len(quick_start) == 2
    script = (ROOT / ".ci" / "run").read_text(encoding="utf-8")
    assert f"readme() {{\n  {quick_start[1]}\n}}\n" in script
    steps = [line for line in script.splitlines() if line.startswith("step ")]
    assert steps[1].endswith(" readme")
