"""What several tests of training share."""

import pytest
import torch


@pytest.fixture
def one_thread():
    """Sums of floats are of one order, so that two trainings can be equal to the last bit."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(threads)
