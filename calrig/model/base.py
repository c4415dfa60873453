"""What all models share."""

from typing import Any

from pydantic import BaseModel, ConfigDict


class Model(BaseModel):
    """Something that calrig stores, sends and receives; it does not change.

    Keys that are not known are left out, so that an older calrig reads what a newer one wrote. A key that
    came later than the first release has a default, so that a newer calrig reads what an older one wrote.

    Dataclasses of the model have no slots: a client keeps there, too, what a newer service adds.
    """

    model_config = ConfigDict(
        frozen=True,
        extra="ignore",
        from_attributes=True,
        defer_build=True,  # a command that validates few of them starts sooner; pydantic locks the build
        serialize_by_alias=True,
        json_schema_extra={"additionalProperties": False},  # an answer has these fields and no others
        json_schema_serialization_defaults_required=True,
    )

    def __getitem__(self, name: str) -> Any:
        """Return a field by its key in JSON, as programs read it that were written for a dictionary.

        Raises:
            KeyError: there is none.
        """
        by_alias = {info.alias: field for field, info in type(self).model_fields.items() if info.alias}
        try:
            return getattr(self, by_alias.get(name, name))
        except AttributeError:
            raise KeyError(name) from None
