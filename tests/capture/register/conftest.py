import pytest
from painted_ball import filmed, head

from capture.folder import CaptureSubject, PartVideo


@pytest.fixture(scope="module")
def case() -> tuple[CaptureSubject, PartVideo]:
    """A painted ball for a head, and its video."""
    subject = head()
    return subject, filmed(subject)
