"""Where the repository and what lies beside it are, from a test file at any depth."""

from __future__ import annotations

from pathlib import Path

ROOT = next(folder for folder in Path(__file__).parents if (folder / "pyproject.toml").is_file())
DOCS = ROOT / "calrig" / "docs"
SHARED = ROOT.parent / "shared"
"""Material beside the repository: recorded wires, measured data, schemas. What needs it skips without it."""
