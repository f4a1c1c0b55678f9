import pytest
from striped_oracle import oracle, small_pictures

from bench.field.drawer import Drawer

__all__ = ["oracle", "small_pictures"]


@pytest.fixture(scope="module")
def drawer(oracle):
    """It draws the oracle's avatar."""
    drawer = Drawer(oracle[1])
    yield drawer
    drawer.release()
