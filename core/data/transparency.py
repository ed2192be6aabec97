"""What the transparent pixels of a scene's photos say: that the scene is empty there, or that nobody saw it."""

from core.config import Settings
from core.data.collection import Collection
from core.setting import AUTO


def transparent_may_be_empty(collection: Collection, settings: Settings) -> bool:
    """Whether photos are decoded together with where they are empty;
    not if a dome is asked for, which would fill that."""
    if settings.transparency != AUTO:
        return settings.transparent_is_empty
    return collection.kind == "blender" and settings.sky != "dome"
