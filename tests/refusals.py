"""Bad input ends in one clear error."""

from collections.abc import Callable

import pytest


def refused(error: type[BaseException], message: str, act: Callable, *given, **named) -> str:
    """What act(*given, **named) is refused with: this error, whose words match the pattern `message`."""
    __tracebackhide__ = True
    with pytest.raises(error, match=message) as caught:
        act(*given, **named)
    return str(caught.value)
