"""The OpenAPI document that is kept with the source; `python -m calrig.api.openapi` writes it anew."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from calrig.api.app import api

KEPT = Path(__file__).parent.parent / "docs" / "openapi.json"


def document() -> dict[str, Any]:
    """The document of the application as it is now."""
    return api().openapi()


def main() -> None:
    """Writes the document to where it is kept."""
    KEPT.write_text(json.dumps(document(), indent=2, ensure_ascii=False) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
