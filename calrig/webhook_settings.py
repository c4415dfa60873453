"""Where another program is told of each run's end: `[webhook]` of calrig.toml."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Self

from pydantic import Field, model_validator

from calrig.laboratory import Strict


class WebhookSettings(Strict):
    """Where another program is told of each run's end, and what its key is kept in: a file or a variable."""

    url: Annotated[str, Field(pattern=r"^https?://[^\s/@]+(/\S*)?$", max_length=2000)]
    secret_file: Path | None = None
    secret_env: Annotated[str, Field(pattern=r"^\w+$", max_length=200)] | None = None

    @model_validator(mode="after")
    def _has_one_key(self) -> Self:
        if (self.secret_file is None) == (self.secret_env is None):
            raise ValueError(
                "a webhook needs secret_file or secret_env, one of them: what it sends is signed"
            )
        return self
