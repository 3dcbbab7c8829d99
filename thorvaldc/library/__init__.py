"""The one finder of module types: the project's own library and the user's folders."""

from thorvaldc.library.finder import OWN, Library, ModuleType, data_folder

__all__ = ["OWN", "Library", "ModuleType", "data_folder"]
