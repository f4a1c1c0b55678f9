"""face.json of a capture: written and read back, refused by name."""

import json

import numpy as np
import pytest
from refusals import refused

from capture.own_face import OWN_FACE, OwnFace, believed, read_own_face
from command.errors import AssetError

OWN = OwnFace(np.linspace(0.5, 1.4, 10), np.linspace(-0.2, 0.25, 10), np.array([1.1, 1.2, 1.3]), None)


def test_what_a_film_of_a_face_said_is_read_back(tmp_path):
    (tmp_path / OWN_FACE).write_text(json.dumps(OWN.json()))
    found = read_own_face(tmp_path / OWN_FACE)
    for name in ("gains", "offsets", "teeth"):
        np.testing.assert_allclose(getattr(found, name), getattr(OWN, name), atol=5e-5)
    assert found.red is None
    # teeth in a dark face are many times its cheeks' blue; a color beyond belief is none
    dark, strange = np.array([205, 195, 178]) / [60, 40, 30], np.array([1.0, 1, 40])
    found = believed(OWN.gains, np.full(10, -3.0), dark, strange)
    assert found.teeth is not None and found.red is None
    (tmp_path / OWN_FACE).write_text(json.dumps(found.json()))
    assert (read_own_face(tmp_path / OWN_FACE).offsets == -1).all()


@pytest.mark.parametrize(
    ("keys", "value", "said"),
    [
        (("version",), 2, r"expected format 'selfscan-face' version 1, found 'selfscan-face' version 2"),
        (("shapes",), [], r"shapes should be an object, is \[\]"),
        (("shapes", "jawOpen"), None, r"jawOpen should be an object, is None"),
        (("shapes", "tongueOut"), {}, r"expected shapes jawOpen, .*; found \['tongueOut'\]"),
        (("shapes", "jawOpen", "gain"), 40, r"shapes.jawOpen.gain should be 0.3 to 2, is 40"),
        (("shapes", "jawOpen", "gain"), True, r"shapes.jawOpen.gain should be 0.3 to 2, is True"),
        (("shapes", "browDownLeft", "offset"), "0", r"shapes.browDownLeft.offset should be -1 to 1, is '0'"),
        (("colors", "teeth"), [1, 1], r"colors.teeth should be three numbers, is \[1, 1\]"),
        (("colors", "teeth"), [1, 1, -1], r"colors.teeth should be 0.05 to 15, is -1"),
    ],
)
def test_what_is_no_face_is_refused_by_file_and_field(tmp_path, keys, value, said):
    content = OWN.json()
    at = content
    for key in keys[:-1]:
        at = at[key]
    at[keys[-1]] = value
    (tmp_path / OWN_FACE).write_text(json.dumps(content))
    refused(AssetError, rf"^\S+{OWN_FACE}: {said}$", read_own_face, tmp_path / OWN_FACE)
