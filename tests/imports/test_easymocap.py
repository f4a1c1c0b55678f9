"""A user's own videos in EasyMocap's and COLMAP's layouts: what comes out is the capture that went in."""

import json

import numpy as np
import pytest
from capture_agreement import assert_same_capture, assert_same_head
from foreign_layouts import copied, write_easymocap

from avatar.errors import AssetError
from train.imports.easymocap import import_easymocap


def imported(own, out, body, **changes):
    paths = {"head": own.head, "landmarks": own.landmarks, "masks": own.masks} | changes
    return import_easymocap(paths.pop("root", own.root), out, body=body, **paths)


def test_own_videos_become_the_capture_that_they_were_written_from(own, source, body, tmp_path):
    notes = imported(own, tmp_path / "out", body)
    found = assert_same_capture(tmp_path / "out", source)
    assert_same_head(found, source)
    assert "not redistributable" in found.facts["body_licence"]
    assert any("mean added" in note for note in notes)
