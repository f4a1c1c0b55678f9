import pytest
from capsules import make_run


@pytest.fixture(scope="session")
def run():
    return make_run()
