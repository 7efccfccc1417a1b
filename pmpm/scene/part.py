"""What all parts of a scene have in common: frozen, no unknown keys, complaints in our own words."""

from collections.abc import Mapping
from typing import Any

from pydantic import BaseModel, ConfigDict, ValidationError, model_validator

from pmpm.scene.messages import Problem, Problems, known_text, scene_error


class Part(BaseModel):
    """A table of a scene."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    def __init__(self, /, **keys: Any):
        try:
            super().__init__(**keys)
        except ValidationError as error:
            raise scene_error(error.errors(include_url=False), type(self).__name__.lower()) from None

    # pydantic's mark for an __init__ it need not call for parts inside parts: paths of complaints stay whole.
    __init__.__pydantic_base_init__ = True  # type: ignore[attr-defined]

    @model_validator(mode="before")
    @classmethod
    def check_keys(cls, data: Any) -> Any:
        """Name unknown keys with the nearest known one; only if there are none, missing keys."""
        if isinstance(data, cls):
            return data
        known = tuple(cls.model_fields)
        if not isinstance(data, Mapping):
            raise Problems(Problem((), f"must be a table with the keys {', '.join(known)}", data))
        unknown = [key for key in data if key not in cls.model_fields]
        if unknown:
            raise Problems(*(cls.unknown_key(key, data[key]) for key in unknown))
        fields = cls.model_fields.items()
        missing = [(key, field) for key, field in fields if key not in data and cls.must_give(key, data)]
        if missing:
            raise Problems(*(Problem((key,), f"is missing: {field.description}") for key, field in missing))
        # In Python None says the same as leaving a key out; TOML has no such value.
        return {key: value for key, value in data.items() if value is not None or cls.model_fields[key].is_required()}

    @classmethod
    def must_give(cls, key: str, data: Mapping[Any, Any]) -> bool:
        """Say whether a key must be given, with these others."""
        return cls.model_fields[key].is_required()

    @classmethod
    def unknown_key(cls, key: Any, value: Any) -> Problem:
        return Problem((str(key),), f"is not a known key; {known_text(key, tuple(cls.model_fields), 'known keys')}")
