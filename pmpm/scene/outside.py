"""Files that a scene names, such as meshes and height maps: found beside the scene file, and recognised again by a checksum."""

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field, model_validator

from pmpm.scene.messages import Problem, Problems
from pmpm.scene.part import Part
from pmpm.scene.values import checked, text

PIECE = 1 << 20  # bytes that are read at a time
folder_of_scene: ContextVar[Path | None] = ContextVar("folder_of_scene", default=None)


@contextmanager
def beside(folder: Path | None) -> Iterator[None]:
    """Let relative paths count from a folder, not from where the process runs."""
    token = folder_of_scene.set(folder)
    try:
        yield
    finally:
        folder_of_scene.reset(token)


def check_path(value: Any) -> str:
    """Return the absolute path of a file that can be read; raises Problems."""
    if not isinstance(value, str | Path) or not str(value):
        raise Problems(Problem((), "must be the path of a file in quotes", value))
    path = Path(folder_of_scene.get() or ".", Path(value).expanduser()).absolute()
    try:
        is_file, is_directory = path.is_file(), path.is_dir()
        if is_file:
            path.open("rb").close()
    except (OSError, ValueError) as error:
        text = f"cannot be read: {getattr(error, 'strerror', None) or error}"
        raise Problems(Problem((), text, str(value))) from None
    if not is_file:
        raise Problems(Problem((), "is a directory" if is_directory else f"no such file: {path}", str(value)))
    return str(path)


def checksum(path: str) -> str:
    """Return the xxh3-64 checksum of a file's bytes, in hexadecimal."""
    import xxhash

    found = xxhash.xxh3_64()
    with open(path, "rb") as file:
        while piece := file.read(PIECE):
            found.update(piece)
    return found.hexdigest()


class OutsideFile(Part):
    """What any part of a scene that reads a file has in common: the path, and what tells that the file is still the same."""

    file: Annotated[str, checked(check_path, {"type": "string", "minLength": 1})] = Field(
        description="path of the file; a relative one counts from the scene file's folder"
    )
    checksum: Annotated[str | None, text()] = Field(
        default=None, description="of the file's bytes (xxh3-64), filled in; if given, the file must have it"
    )

    @model_validator(mode="after")
    def recognise(self) -> "OutsideFile":
        """Fill in the checksum, or refuse a file that has another one."""
        found = checksum(self.file)
        if self.checksum not in (None, found):
            raise Problems(
                Problem(("file",), f"is not the file it was: its checksum is {found}, not {self.checksum}", self.file)
            )
        object.__setattr__(self, "checksum", found)
        return self
