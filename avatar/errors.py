"""The one error that bad input raises."""


class AssetError(Exception):
    """A file or a value from outside is unusable; the message names file, field, expected and found.

    The command line prints the message as one line and exits with code 1.
    """
