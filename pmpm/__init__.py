"""pmpm: a distributed Material Point Method solver. The public names are loaded when they are first used."""

from importlib import import_module

__version__ = "0.1.0"
PUBLIC = {
    "Law": "pmpm.physics.materials.own_law",
    "Errors": "pmpm.accuracy",
    "Scene": "pmpm.scene.schema",
    "SceneError": "pmpm.scene.errors",
    "Simulation": "pmpm.simulation",
    "NumericalFailure": "pmpm.failure",
    "load": "pmpm.output.reader",
    "study": "pmpm.studies.study",
}
__all__ = ["Errors", "Law", "NumericalFailure", "Scene", "SceneError", "Simulation", "load", "study"]


def __getattr__(name):
    if name in PUBLIC:
        return getattr(import_module(PUBLIC[name]), name)
    raise AttributeError(f"module 'pmpm' has no attribute {name!r}")


def __dir__():
    return sorted([*globals(), *PUBLIC])
