"""What several tests of training share."""

import pytest
import torch

from capture.folder import read_capture


@pytest.fixture(scope="module")
def capture(tiny_capture):
    return read_capture(tiny_capture)


@pytest.fixture
def one_thread():
    """Sums of floats are of one order, so that two trainings can be equal to the last bit."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(threads)
