"""The one error that bad input raises."""


LONGEST = 2000  # letters of a message: what a file holds is quoted, and may be megabytes


class AssetError(Exception):
    """A file or a value from outside is unusable; the message names file, field, expected and found.

    The command line prints the message as one line and exits with code 1. Control characters, which a file or the text
    of another library may bring along and a terminal would obey, are shown by their codes.
    """

    def __init__(self, message: str):
        if len(message) > LONGEST:
            message = f"{message[:LONGEST]}..."
        plain = (c if c.isprintable() else c.encode("unicode_escape").decode("ascii") for c in message)
        super().__init__("".join(plain))


def unicode_text(text: str) -> str:
    """A text as windows and files take it: bytes of a file's name that are no UTF-8 are shown by their codes."""
    return text.encode("utf-8", "backslashreplace").decode()


def missing_package(package: str | None, extra: str, what: str = "") -> AssetError:
    """The error for a package that an extra of this project installs; `what` needs it. selfscan is in no index."""
    named = f"{what} needs" if what else "needs"
    return AssetError(f"{named} the package {package!r}; in selfscan's checkout: pip install -e '.[{extra}]'")
