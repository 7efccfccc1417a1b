"""Materials of a scene: one table of keys per law, made from what the laws tell about themselves."""

from collections.abc import Iterable, Iterator, Mapping
from functools import cache, reduce
from operator import or_
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

from pydantic import Discriminator, Field, Tag, ValidationError, create_model, model_validator

from pmpm.physics.materials import LAWS, law_of, own_law, python_law
from pmpm.physics.materials.keys import Key
from pmpm.physics.materials.own_law import Law
from pmpm.scene import functions
from pmpm.scene.messages import TAG, Problem, Problems, known_text, problems_in
from pmpm.scene.part import Part
from pmpm.scene.values import Checked, Told, check_word, choice, flag, number

RESERVED = ("law", "sound_speed")  # names that a function cannot give to its parameters


class Material(Part):
    """A law with its parameters; the keys of each law are fields of its own subclass."""

    model: str = Field(description="name of the law")

    @property
    def parameters(self) -> dict[str, Any]:
        """The law's keys and their values, None where an optional key is not given; a Python law's `function` too."""
        return {name: value for name, value in self if name != "model"}

    @model_validator(mode="after")
    def check_combination(self) -> "Material":
        given = {name: value for name, value in self.parameters.items() if value is not None}
        message = law_of(self.model).conflicts(given)
        if message:
            raise Problems(Problem((), f"does not fit together: {message}"))
        return self

    def __reduce__(self):
        # The subclasses are made from tables of keys and have no name that pickle could find.
        return material, (self.model_dump(),)

    def wrong_law(self, dim: int) -> Iterator[Problem]:
        """Yield what can be said against the law only once the number of dimensions is known."""
        return iter(())

    def complete(self, dim: int) -> "Material":
        """Fill in what depends on the number of dimensions."""
        return self

    def table(self, dim: int) -> dict[str, Any]:
        """Return the material as it stands in a scene file."""
        return self.model_dump(exclude_none=True)


class PythonMaterial(Material):
    """A law given from Python; the parameters of its functions are fields of a subclass made for the law."""

    law: ClassVar[Law]
    density: float
    sound_speed: float | None

    @property
    def parameters(self) -> dict[str, Any]:
        return super().parameters | {"law": type(self).law}

    @property
    def numbers(self) -> tuple[float, ...]:
        """What the functions take besides F and the state."""
        return tuple(getattr(self, name) for name in type(self).law.parameters)

    def __reduce__(self):
        return material, (self.model_dump() | {"model": type(self).law},)

    def wrong_law(self, dim: int) -> Iterator[Problem]:
        law = type(self).law
        size = dim * dim + law.own_size
        if size > functions.MOST_NUMBERS:
            text = f"keeps {size} numbers in {dim}-D, {dim * dim} of F and {law.own_size} of its state; kernels know up to "
            yield functions.unfit_problem(law.stress, f"{text}{functions.MOST_NUMBERS}")
            return
        try:
            functions.check_calls(law, dim, self.numbers)
            least = functions.speed_at_rest(law, dim, self.numbers, self.density)
        except functions.Unfit as complaint:
            yield functions.unfit_problem(law.stress, complaint)
            return
        told = functions.told_speed_at_rest(law, dim, self.numbers)
        low = (1.0 - functions.WITHIN) * (least or 0.0)
        if told is not None and self.sound_speed is not None:
            yield Problem(
                ("sound_speed",), f"does not go with the wave_speed function of {law.title}", self.sound_speed
            )
        elif told is not None and told < low:
            text = f"has a wave_speed function that gives {told:.6g} m/s at rest, where waves run at {least:.6g} m/s"
            yield functions.unfit_problem(law.stress, text)
        elif told is None and least is None and self.sound_speed is None:
            text = f"is missing: {law.title} has no stiffness at rest from which to find it (m/s)"
            yield Problem(("sound_speed",), text)
        elif self.sound_speed is not None and self.sound_speed < low:
            text = f"m/s must be at least {least:.6g} m/s, the speed of waves at rest"
            yield Problem(("sound_speed",), text, self.sound_speed)

    def complete(self, dim: int) -> "Material":
        law = type(self).law
        if self.sound_speed is not None or law.wave_speed is not None:
            return self
        found = functions.speed_at_rest(law, dim, self.numbers, self.density)
        return self.model_copy(update={"sound_speed": found})

    def table(self, dim: int) -> dict[str, Any]:
        return super().table(dim) | {"model": f"{self.model}:{functions.digest(type(self).law, dim)}"}


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


def model_of(name: str, keys: Iterable[Key], base: type[Material] = Material, about: str | None = None) -> Any:
    """Make the class of a law's materials from its table of keys; `about`: what its JSON schema says of it."""
    model: Any = (Literal[name], Field(name))
    fields: dict[str, Any] = {"model": model} | {key.name: field_of(key) for key in keys}
    return create_model(name, __base__=base, __doc__=about, **fields)


def summary(law: Any) -> str:
    """Return the first sentence of what a law says of itself."""
    return " ".join(law.__doc__.strip().split("\n\n")[0].split()).split(". ")[0].rstrip(".") + "."


MODELS: dict[str, Any] = {name: model_of(name, law.KEYS, about=summary(law)) for name, law in LAWS.items()}


@cache
def model_of_law(law: Law) -> Any:
    """Make the class of the materials of a law. Raises Problems if it gives a parameter a name that is taken."""
    own = {name: default for name, default in law.parameters.items() if name != "density"}
    for name in own:
        if name in RESERVED or name.startswith(("_", "model")) or hasattr(PythonMaterial, name):
            raise Problems(Problem(("model",), f"must not call a parameter {name}: the name is taken", law.stress))
    keys = [Key(name, "-", f"parameter of {law.title}", default) for name, default in own.items()]
    model = model_of(python_law.PREFIX + law.title, [*python_law.KEYS, *keys], PythonMaterial)
    model.law = law
    return model


def python_material(keys: Mapping[str, Any]) -> PythonMaterial:
    """Make a material whose `model` is a function or a Law. Raises Problems."""
    law = own_law.of_model(keys["model"])
    functions.check_law(law)
    model = model_of_law(law)
    try:
        return model.model_validate({**keys, "model": model.model_fields["model"].default})
    except ValidationError as error:
        raise Problems(*problems_in(error.errors(include_url=False))) from None


def of_python(model: Any) -> bool:
    """Say whether a model is given from Python."""
    return callable(model) or isinstance(model, Law)


def material(keys: dict[str, Any]) -> Material:
    """Make a material from its keys, `model` among them."""
    return python_material(keys) if of_python(keys["model"]) else MODELS[keys["model"]](**keys)


def check_material(value: Any) -> Any:
    """Complain about a material without a model, or of a model that is unknown or not built yet."""
    if isinstance(value, Material):
        return value
    if not isinstance(value, dict):
        raise Problems(Problem((), f"must be a table with a model; {known_text('', MODELS, 'known')}", value))
    if "model" not in value:
        raise Problems(Problem(("model",), f"is missing; {known_text('', MODELS, 'known')}"))
    if of_python(value["model"]):
        return python_material(value)
    if isinstance(value["model"], str) and value["model"].startswith(python_law.PREFIX):
        name = value["model"].split(":")[1]
        text = f"is a Python function, which a file does not hold: give {name} as the model, from Python"
        raise Problems(Problem(("model",), text, value["model"]))
    check_word(value["model"], MODELS, path=("model",))
    return value


def of_files(told: Told) -> Told:
    """Take the laws from Python out of the JSON schema of all: a file does not hold them."""
    return {"oneOf": [one for one in told["oneOf"] if PythonMaterial.__name__ not in one["$ref"]]}


def material_tag(value: Any) -> str:
    if isinstance(value, PythonMaterial):
        return TAG + python_law.PREFIX
    return TAG + (value["model"] if isinstance(value, dict) else value.model)


if TYPE_CHECKING:
    AnyMaterial = Material
else:
    AnyMaterial = Annotated[
        reduce(
            or_,
            (
                Annotated[model, Tag(TAG + name)]
                for name, model in (MODELS | {python_law.PREFIX: PythonMaterial}).items()
            ),
        ),
        Discriminator(material_tag),
        Checked(check_material, told=of_files),
    ]
