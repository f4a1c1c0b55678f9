"""The authors' released layout: what comes out is the capture that went in, trap by trap."""

import json
import shutil

import numpy as np
import pytest
from foreign_layouts import J0, assert_same_capture, assert_same_head, numbers, object_array, write_weight_grid
from PIL import Image

from avatar.rotation import matrix_from_axis_angle
from avatar.skeleton import joint_transforms
from avatar.skinning import dense_weights
from capture.folder import read_capture
from capture.read.folder import anchored, read_mask
from capture.read.totalselfscan import _frames_of, import_totalselfscan
from command.errors import AssetError
from files.npz import read_npy
from selfscan.__main__ import main


@pytest.fixture
def damaged(authors, tmp_path):
    """A copy of the authors' folder to change."""
    return shutil.copytree(authors, tmp_path / "male-anna")


def changed(path, change):
    """The dict of an object file, changed and saved again."""
    held = read_npy(path, "a test's file")
    change(held if len(held) > 1 else held[0])
    object_array(path, held if len(held) > 1 else held[0])


def refused(root, tmp_path, body, match):
    """One line that names what is wrong, and no folder."""
    with pytest.raises(AssetError, match=match) as error:
        import_totalselfscan(root, tmp_path / "out", body=body)
    assert "\n" not in str(error.value) and str(root) in str(error.value)
    assert not (tmp_path / "out").exists()


def test_the_authors_folder_becomes_the_capture_that_it_was_written_from(
    authors, source, model, body, tmp_path, capsys
):
    assert main(["import", "totalselfscan", str(authors), str(tmp_path / "out"), "--body", str(model)]) == 0
    printed = capsys.readouterr().out
    assert "skin weights: of model" in printed and "selfscan check" in printed and "3 of 3 frames" in printed
    found = assert_same_capture(tmp_path / "out", source)
    assert_same_head(found, source)
    assert "not redistributable" in found.facts["body_licence"] and body.name in found.facts["body_licence"]
    assert found.facts["subject"] == "male-anna" and all(note in printed for note in found.facts["notes"])
    known = json.loads((tmp_path / "out/head/landmarks.json").read_text())
    assert len(known["points"]) >= 12
    for name, vertex in known["vertices"].items():
        np.testing.assert_allclose(known["points"][name], source.subject.vertices[vertex] + J0, atol=1e-7)


def test_without_a_model_the_weights_come_from_the_grid_and_one_of_another_margin_is_refused(damaged, source, tmp_path):
    write_weight_grid(source, damaged / "lbs/bigpose_bw.npy")
    grid = np.load(damaged / "lbs/bigpose_bw.npy")
    numbers(damaged / "lbs/bigpose_bw.npy", grid[3:-3])
    refused(damaged, tmp_path, None, r"bigpose_bw\.npy: expected about .* found")
    write_weight_grid(source, damaged / "lbs/bigpose_bw.npy")
    notes = import_totalselfscan(damaged, tmp_path / "out")
    found = read_capture(tmp_path / "out").subject
    np.testing.assert_allclose(found.vertices, source.subject.vertices, atol=1e-6)
    assert any("bigpose_bw" in note for note in notes)
    apart = np.abs(dense_weights(found.skin) - dense_weights(source.subject.skin)).sum(1)
    away_from_hands = source.subject.part < 2
    assert np.median(apart[away_from_hands]) < 0.08  # a grid of 25 mm blurs; the nearest joint alone is .5 off
    assert (found.part != source.subject.part).mean() < 0.02


@pytest.mark.parametrize("folder, factor, unit", [(".", 1e-3, "millimetres"), ("hand/handl", 1e3, "metres")])
def test_the_wrong_unit_of_a_camera_is_refused(damaged, tmp_path, body, folder, factor, unit):
    path = damaged / folder / "annots.npy"
    changed(path, lambda held: held["cams"].update(T=[factor * held["cams"]["T"][0]]))
    refused(damaged, tmp_path, body, rf"annots\.npy: cams\.T, in {unit}, should place the camera .* places it at")


def test_a_root_inside_poses_turns_about_the_pelvis_first(damaged, source, tmp_path, body):
    for file in (damaged / "params").iterdir():

        def half(held):  # Rh and the root share the turn
            R = matrix_from_axis_angle(held["Rh"][0])
            pelvis = held["Th"][0] + R @ J0
            held["poses"] = np.concatenate([held["Rh"], held["poses"][:, 3:]], 1)
            held["Rh"] = np.zeros((1, 3))
            held["Th"] = (pelvis - J0)[None]

        changed(file, half)
    import_totalselfscan(damaged, tmp_path / "out", body=body)
    assert_same_capture(tmp_path / "out", source)


def test_frame_remove_leaves_out_half_open_ranges_of_indices(damaged, source, tmp_path, body):
    (damaged / "hand/handl/frame_remove.json").write_text('{"bad_frame": [[1, 2], [7, 9]]}')
    notes = import_totalselfscan(damaged, tmp_path / "out", body=body)
    found = read_capture(tmp_path / "out")
    np.testing.assert_array_equal(found.videos["hand_left"].images, source.videos["hand_left"].images[[0, 2]])
    np.testing.assert_allclose(found.videos["hand_left"].root, source.videos["hand_left"].root[[0, 2]], atol=1e-9)
    assert len(found.videos["hand_right"].images) == 3
    assert "hand_left: 1 frames left out by frame_remove.json" in notes


def test_frames_are_the_authors_where_the_video_is_as_long_else_evenly_spread():
    frames = _frames_of(1400, "body", 100, [])
    assert (frames[0], frames[-1], len(frames)) == (500, 1390, 90)
    assert _frames_of(1000, "body", 4, []).tolist() == [0, 333, 666, 999]
    assert len(_frames_of(1400, "body", None, [])) == 90 and len(_frames_of(1000, "body", None, [])) == 100
    assert _frames_of(1400, "body", 2, []).tolist() == [500, 1390]


def test_masks_are_labels_or_0_and_1_and_jpeg_rings_are_no_person(tmp_path):
    person = np.zeros((40, 40), bool)
    person[8:32, 10:30] = True
    for name, values, any_value in [
        ("a.png", 13, True),
        ("b.png", 1, True),
        ("c.png", 1, False),
        ("d.png", 255, False),
    ]:
        Image.fromarray((person * values).astype(np.uint8)).save(tmp_path / name)
        np.testing.assert_array_equal(read_mask(tmp_path / name, (40, 40), any_value=any_value), person)
    Image.fromarray((person * 255).astype(np.uint8)).save(tmp_path / "e.jpg", quality=60)
    assert (np.asarray(Image.open(tmp_path / "e.jpg"))[~person] > 0).any()  # nonzero would be wrong
    np.testing.assert_array_equal(read_mask(tmp_path / "e.jpg", (40, 40), any_value=True), person)
    with pytest.raises(AssetError, match=r"a\.png: should be \(20, 40\) pixels .* is \(40, 40\)"):
        read_mask(tmp_path / "a.png", (20, 40), any_value=True)


def test_a_wrist_stays_where_its_own_skeleton_had_it(source):
    video, joints = source.videos["hand_left"], source.subject.joints
    other = 1.07 * joints
    root = anchored(video.axis_angle, video.root, other, joints, "hand_left")
    ours = joint_transforms(video.axis_angle, joints, root)[:, 20, :3, 3]
    theirs = joint_transforms(video.axis_angle, other, video.root)[:, 20, :3, 3]
    np.testing.assert_allclose(ours, theirs, atol=1e-12)
    assert np.linalg.norm(root - video.root, axis=1).min() > 0.02


def in_millimetres(root):
    for name in ("joints", "bigpose_vertices"):
        numbers(root / f"lbs/{name}.npy", 1000 * np.load(root / f"lbs/{name}.npy"))


BAD = {
    "three of four videos": (
        lambda r: (r / "hand/handr").rename(r / "hand/other"),
        r"expected four videos, found no hand_right \(hand/handr\)",
    ),
    "no masks": (lambda r: (r / "mask_cihp").rename(r / "masks"), r"000500\.png: no mask; expected one of .*mask_cihp"),
    "no face mask": (lambda r: (r / "face/masks/0001.png").unlink(), r"face/masks/0001\.png: no such mask"),
    "poses shorter than frames": (lambda r: (r / "params/000502.npy").unlink(), r"params/000502\.npy: no such file"),
    "fewer face cameras than images": (
        lambda r: object_array(r / "face/new_cameras.npy", read_npy(r / "face/new_cameras.npy", "x")[:2]),
        r"new_cameras\.npy: expected a camera for each of 3 images, found 2",
    ),
    "a body in millimetres": (
        in_millimetres,
        r"bigpose_vertices\.npy: the body should be .* tall .* is 1\d{3}.*: millimetres\?",
    ),
    "all frames removed": (
        lambda r: (r / "frame_remove.json").write_text('{"bad_frame": [[0, 99]]}'),
        r"bad_frame leaves no frame",
    ),
}
OBJECTS = [
    ("params/000500", lambda p: p.update(Th=p["Th"] + [0.2, 0, 0]), r"vertices should lie within 3 cm .* are \d"),
    ("params/000501", lambda p: p.update(poses=np.zeros((1, 72))), r"poses should be \(156,\), is \(1, 72\)"),
    ("annots", lambda a: a.pop("cams"), r"annots\.npy: cams should be a dict"),
    ("annots", lambda a: a["ims"][1].update(ims=["../../a.png"]), r"annots\.npy: ims\[1\] should be a path within the"),
    ("face/new_cameras", lambda c: c[1].update(R=c[1]["R"][0]), r"camera 1: R should be finite with a leading axis"),
]
ARRAYS = [
    ("face/tvertices_face", lambda v: v + [0, 0.3, 0], r"the face should lie within 3 cm .* is \d+(\.\d+)? cm away"),
    ("lbs/joints", lambda v: np.zeros((24, 3)), r"joints\.npy: joints should be \(52, 3\), is \(24, 3\)"),
    ("lbs/joints", lambda v: v * np.nan, r"joints\.npy: joints is not finite"),
    ("lbs/parents", lambda v: np.arange(52) - 1, r"parents\.npy: expected SMPL\+H's 52 joints"),
    ("lbs/bigpose_vertices", lambda v: v[:-5], r"expected 13380 vertices as model, found 13375"),
]
BAD |= {message: (lambda r, n=name, e=edit: changed(r / f"{n}.npy", e), message) for name, edit, message in OBJECTS}
BAD |= {
    message: (lambda r, n=name, e=edit: numbers(r / f"{n}.npy", e(np.load(r / f"{n}.npy"))), message)
    for name, edit, message in ARRAYS
}


@pytest.mark.parametrize("case", BAD)
def test_bad_folders_are_refused_in_one_line(damaged, tmp_path, body, case):
    change, message = BAD[case]
    change(damaged)
    refused(damaged, tmp_path, body, message)
