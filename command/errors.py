"""The one error that bad input raises."""


class AssetError(Exception):
    """A file or a value from outside is unusable; the message names file, field, expected and found.

    The command line prints the message as one line and exits with code 1.
    """


def missing_package(package: str | None, extra: str, what: str = "") -> AssetError:
    """The error for a package that an extra of this project installs; `what` needs it. selfscan is in no index."""
    named = f"{what} needs" if what else "needs"
    return AssetError(f"{named} the package {package!r}; in selfscan's checkout: pip install -e '.[{extra}]'")
