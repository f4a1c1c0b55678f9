import pytest
from capsules import make_run

from bake.bake import BakeOptions


@pytest.fixture(scope="session")
def sheen_run():
    return make_run(sheen=0.5)


@pytest.fixture(scope="session")
def small():
    """Everything the real bake does, at a size for tests."""
    return BakeOptions(faces=2000, texture=256, body_step=0.012, fine_step=0.006, samples=6000, steps=150, image=128)
