"""One sound capture for all tests of the check."""

import pytest
from turning_capture import turning_capture

from capture.folder import Capture


@pytest.fixture(scope="session")
def turning(tmp_path_factory) -> Capture:
    return turning_capture(tmp_path_factory.mktemp("turning") / "test")
