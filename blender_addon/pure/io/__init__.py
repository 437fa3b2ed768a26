"""File formats of the add-on, with numpy and the standard library only: nothing here imports bpy or gof."""


class FileFormatError(ValueError):
    """A file or folder is not what it should be. The message names the path, the field and what to do."""
