"""Array files of others: numbers come back, objects are rebuilt by files/unpickle.py."""

import os

import numpy as np
import pytest

from command.errors import AssetError
from files.npz import read_npy


def saved(path, value, **options):
    np.save(path, value, **options)
    return path


@pytest.mark.parametrize(
    "array",
    [
        np.arange(6.0).reshape(2, 3),
        np.asfortranarray(np.arange(6).reshape(2, 3)),
        np.arange(3, dtype=">i4"),
        np.float32(2),
        np.zeros((0, 3)),
        np.array(["a", "bc"]),
        np.array([True, False]),
    ],
)
def test_numbers_and_text_come_back_equal(tmp_path, array):
    found = read_npy(saved(tmp_path / "a.npy", array), "numbers")
    assert found.shape == array.shape and found.dtype == array.dtype.newbyteorder("=")
    np.testing.assert_array_equal(found, array)


def test_objects_come_as_the_list_of_what_they_hold(tmp_path):
    record = {"K": [np.eye(3)], "ims": [{"ims": ["images/000500.jpg"]}]}
    (found,) = read_npy(saved(tmp_path / "a.npy", np.array(record, object), allow_pickle=True), "a record")
    assert found["ims"] == record["ims"]
    np.testing.assert_array_equal(found["K"][0], np.eye(3))
    several = np.empty(2, object)
    several[:] = [{"R": np.ones((1, 3))}, {"R": np.zeros((1, 3))}]
    found = read_npy(saved(tmp_path / "b.npy", several, allow_pickle=True), "records")
    assert [item["R"].sum() for item in found] == [3, 0]


class Bomb:
    def __init__(self, place):
        self.place = place

    def __reduce__(self):
        return (os.mkdir, (self.place,))


def test_code_in_an_array_is_not_run(tmp_path):
    place = str(tmp_path / "executed")
    path = saved(tmp_path / "a.npy", np.array({"cams": Bomb(place)}, object), allow_pickle=True)
    with pytest.raises(
        AssetError, match=r"a\.npy: expected cameras, found: .*the name '(posix|nt)\.mkdir'.*nothing was run"
    ):
        read_npy(path, "cameras")
    assert not os.path.exists(place)
