"""A source capture with an articulated, moving person and lenses, and its two foreign layouts, written once."""

from types import SimpleNamespace

import numpy as np
import pytest
from foreign_layouts import write_authors, write_colmap, write_easymocap, write_landmark_pixels
from painted_capture import write_capture
from smplh_model import write_model

from avatar.body import read_body
from avatar.rotation import axis_angle_from_matrix, matrix_from_axis_angle
from capture.folder import read_capture
from capture.read.places import landmark_vertices


@pytest.fixture(scope="session")
def source(tmp_path_factory):
    """The capture that the layouts are written from, with fingers, elbows and places that differ by frame."""
    folder = write_capture(tmp_path_factory.mktemp("source") / "anna", size=32, frames=3)
    rng = np.random.default_rng(4)
    for part in ("body", "hand_left", "hand_right"):
        with np.load(folder / part / "poses.npz") as data:
            poses, trans = data["poses"].copy(), data["trans"].copy()
        with np.load(folder / part / "cameras.npz") as data:
            fields = dict(data)
        # one camera that stands still, as in real videos: the person moves instead
        for i, pose in enumerate(fields["camera_from_world"]):
            world = np.linalg.inv(fields["camera_from_world"][0]) @ pose
            poses[i, :3] = axis_angle_from_matrix(world[:3, :3] @ matrix_from_axis_angle(poses[i, :3]))
            trans[i] = world[:3, :3] @ trans[i] + world[:3, 3]
        fields["camera_from_world"][:] = fields["camera_from_world"][0]
        fields["distortion"][:] = [0.05, -0.02, 0.001, -0.002, 0.003]
        np.savez(folder / part / "cameras.npz", **fields)
        poses[:, 3:] += 0.2 * rng.normal(size=poses[:, 3:].shape)
        trans += [0.05, 0.1, -0.02] + 0.05 * rng.normal(size=trans.shape)
        np.savez(folder / part / "poses.npz", poses=poses, trans=trans)
    return read_capture(folder)


@pytest.fixture(scope="session")
def model(tmp_path_factory):
    """An SMPL+H model file whose body is the source's, its pelvis away from the origin."""
    return write_model(tmp_path_factory.mktemp("model") / "model.npz")


@pytest.fixture(scope="session")
def body(model):
    return read_body(model)


@pytest.fixture(scope="session")
def authors(source, tmp_path_factory):
    return write_authors(source, tmp_path_factory.mktemp("authors") / "male-anna")


@pytest.fixture(scope="session")
def vertices(source):
    return landmark_vertices(source.subject.rest, source.subject.part == 1)


@pytest.fixture(scope="session")
def own(source, body, vertices, tmp_path_factory):
    """EasyMocap, COLMAP, landmarks and masks of the source."""
    root = write_easymocap(source, tmp_path_factory.mktemp("own") / "anna", body)
    return SimpleNamespace(
        root=root,
        head=write_colmap(source, root / "colmap"),
        landmarks=write_landmark_pixels(source, root / "landmarks.json", vertices, named=True),
        masks=root / "masks",
    )
