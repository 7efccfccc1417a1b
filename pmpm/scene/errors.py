"""Complaints about a scene: what the door shows before anything is run (exit status 2)."""


class SceneError(Exception):
    """The scene is wrong; the text is the whole message for the user, one complaint per line."""


class NotBuilt(SceneError):  # noqa: N818
    """The scene asks only for things that are promised but not built yet."""
