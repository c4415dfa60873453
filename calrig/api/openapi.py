"""The OpenAPI document that is kept with the source; `python -m calrig.api.openapi` regenerates it."""

import json
from typing import Any

from calrig.api.app import DOCUMENT, api


def document() -> dict[str, Any]:
    """The document of the application as it is now."""
    return api().openapi()


def main() -> None:
    """Writes the document to where it is kept."""
    DOCUMENT.write_text(json.dumps(document(), indent=2, ensure_ascii=False) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
