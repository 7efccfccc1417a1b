"""Materials of a scene: one table of keys per law, made from what the laws tell about themselves."""

from functools import reduce
from operator import or_
from types import ModuleType
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import BeforeValidator, Discriminator, Field, Tag, create_model, model_validator

from pmpm.physics.materials import LAWS, PLANNED
from pmpm.physics.materials.keys import Key
from pmpm.scene.messages import TAG, Problem, Problems, known_text
from pmpm.scene.part import Part
from pmpm.scene.values import check_word, choice, flag, number


class Material(Part):
    """A law with its parameters; the keys of each law are fields of its own subclass."""

    model: str = Field(description="name of the law")

    @property
    def parameters(self) -> dict[str, Any]:
        """The law's keys and their values, None where an optional key is not given."""
        return {name: value for name, value in self if name != "model"}

    @model_validator(mode="after")
    def check_combination(self) -> "Material":
        given = {name: value for name, value in self.parameters.items() if value is not None}
        message = LAWS[self.model].conflicts(given)
        if message:
            raise Problems(Problem((), f"does not fit together: {message}"))
        return self

    def __reduce__(self):
        # The subclasses are made at import and have no name that pickle could find.
        return material, (self.model_dump(),)


def field_of(key: Key) -> tuple[Any, Any]:
    """Turn a law's key into pydantic's (type, default)."""
    description = key.meaning if key.unit == "-" else f"{key.meaning} ({key.unit})"
    default = ... if key.default is None and not key.optional else key.default
    if isinstance(key.default, bool):
        return Annotated[bool, flag()], Field(default, description=description)
    if key.choices:
        words = choice(key.choices)
        return Annotated[str | None, words], Field(default, description=description)
    bounds = {"above": key.above, "at_least": key.at_least, "below": key.below, "at_most": key.at_most}
    only: Any = key.only
    check = number(key.unit, only=only, **bounds)
    if isinstance(default, int | float):
        default = float(default)
    return Annotated[float | None, check], Field(default, description=description)


def model_of(name: str, law: ModuleType) -> Any:
    """Make the class of a law's materials from its table of keys."""
    model: Any = (Literal[name], Field(name))
    fields: dict[str, Any] = {"model": model} | {key.name: field_of(key) for key in law.KEYS}
    return create_model(name, __base__=Material, **fields)


MODELS: dict[str, Any] = {name: model_of(name, law) for name, law in LAWS.items()}


def material(keys: dict[str, Any]) -> Material:
    """Make a material from its keys, `model` among them."""
    return MODELS[keys["model"]](**keys)


def check_material(value: Any) -> Any:
    """Complain about a material without a model, or of a model that is unknown or not built yet."""
    if isinstance(value, Material):
        return value
    if not isinstance(value, dict):
        raise Problems(Problem((), f"must be a table with a model; {known_text('', MODELS, 'known')}", value))
    if "model" not in value:
        raise Problems(Problem(("model",), f"is missing; {known_text('', MODELS, 'known')}"))
    check_word(value["model"], MODELS, PLANNED, ("model",))
    return value


def material_tag(value: Any) -> str:
    return TAG + (value["model"] if isinstance(value, dict) else value.model)


if TYPE_CHECKING:
    AnyMaterial = Material
else:
    AnyMaterial = Annotated[
        reduce(or_, (Annotated[model, Tag(TAG + name)] for name, model in MODELS.items())),
        Discriminator(material_tag),
        BeforeValidator(check_material),
    ]
