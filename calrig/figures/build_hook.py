"""The build of the wheel: cuts the page's chart script out of plotly's, which nobody needs after that."""

from __future__ import annotations

import runpy
from importlib.metadata import files
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

SCRIPT = "web/vendor/plotly-partial.min.js"


class ChartScript(BuildHookInterface):
    """Writes the script into the page's folder, where a wheel and an editable install both find it."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:  # noqa: ARG002 (hatchling's)
        """Called by hatchling before it gathers the files."""
        bundle = runpy.run_path(str(Path(self.root) / "calrig" / "figures" / "plotly_bundle.py"))
        (wheels,) = [file for file in files("plotly") or () if file.name == "plotly.min.js"]
        script = wheels.read_text(encoding="utf-8")
        try:
            script = bundle["partial_bundle"](script)
        except bundle["BundleError"] as error:
            self.app.display_warning(f"{error}: the page gets all of plotly.js, four times the size")
        target = Path(self.root) / SCRIPT
        target.parent.mkdir(exist_ok=True)
        target.write_text(script, encoding="utf-8")
