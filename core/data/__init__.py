"""Photo collections: whichever kind is found on disk becomes a Collection, and its photos become pixels."""

from core.data.collection import Collection, Photo
from core.data.load import find_kind, find_photos, load_collection

__all__ = ["Collection", "Photo", "find_kind", "find_photos", "load_collection"]
