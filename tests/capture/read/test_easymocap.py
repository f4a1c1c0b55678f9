"""A user's own videos in EasyMocap's and COLMAP's layouts: what comes out is the capture that went in."""

import json
import shutil
from types import SimpleNamespace

import numpy as np
import pytest
from foreign_layouts import (
    J0,
    assert_same_capture,
    assert_same_head,
    opencv_matrix,
    write_colmap,
    write_easymocap,
    write_landmark_pixels,
)
from PIL import Image

from avatar.body import shaped
from avatar.rotation import matrix_from_axis_angle
from capture.folder import read_capture
from capture.read.easymocap import import_easymocap
from capture.read.opencv_yaml import read_opencv_yaml
from command.errors import AssetError
from selfscan.__main__ import main


def imported(own, out, body, **changes):
    paths = {"source": own.root, "head": own.head, "landmarks": own.landmarks, "masks": own.masks} | changes
    return import_easymocap(paths.pop("source"), out, body=body, most=100, **paths)


@pytest.fixture
def damaged(own, tmp_path):
    """A copy of everything to change."""
    root = shutil.copytree(own.root, tmp_path / "anna")
    return SimpleNamespace(root=root, head=root / "colmap", landmarks=root / "landmarks.json", masks=root / "masks")


def people_changed(root, part, change):
    for file in sorted((root / part / "smpl").iterdir()):
        people = json.loads(file.read_text())
        change(people[0])
        file.write_text(json.dumps(people))


def test_own_videos_become_the_capture_that_they_were_written_from(own, source, body, tmp_path):
    notes = imported(own, tmp_path / "out", body)
    found = assert_same_capture(tmp_path / "out", source)
    assert_same_head(found, source)
    assert "not redistributable" in found.facts["body_licence"]
    assert any("mean added" in note for note in notes)
    assert any(note.startswith("landmarks: 1") and "0.00 pixels" in note and "0.0 mm" in note for note in notes)


def test_own_videos_are_imported_by_the_command(own, source, model, tmp_path, capsys):
    words = ["import", "easymocap", str(own.root), str(tmp_path / "out"), "--body", str(model), "--head", str(own.head),
             "--landmarks", str(own.landmarks), "--masks", str(own.masks), "--frames", "2"]  # fmt: skip
    assert main(words) == 0
    assert "body: 2 of 3 frames, 000500 to 000502" in capsys.readouterr().out
    assert not (tmp_path / "out/body/images/000002.png").exists()


@pytest.mark.parametrize("hands", ["pca", "old", "full"])
def test_the_mean_of_the_hands_is_added_once(source, own, body, tmp_path, hands):
    """Coefficients and offsets get it, full hands have it already."""
    root = write_easymocap(source, tmp_path / "anna", body, hands=hands)
    imported(own, tmp_path / "out", body, source=root)
    found = read_capture(tmp_path / "out").videos["hand_left"]
    expected = source.videos["hand_left"].axis_angle
    np.testing.assert_allclose(found.axis_angle[:, 1:22], expected[:, 1:22], atol=1e-9)
    if hands == "full":
        np.testing.assert_allclose(found.axis_angle, expected, atol=1e-9)
        return
    n = 12 if hands == "pca" else 6
    for side, joints in ((0, slice(22, 37)), (1, slice(37, 52))):
        basis = body.hands.components[side, :n].T
        offset = expected[:, joints].reshape(-1, 45) - body.hands.mean[side]
        wanted = body.hands.mean[side] + offset @ np.linalg.pinv(basis).T @ basis.T
        np.testing.assert_allclose(found.axis_angle[:, joints].reshape(-1, 45), wanted, atol=1e-9)


@pytest.mark.parametrize(
    "axis_angle", [(np.pi / 2, 0, 0), (np.pi, 0, 0), (0, 0, -np.pi / 2)], ids=["z up", "y down", "x up"]
)
def test_a_world_of_another_up_axis_is_turned_with_its_cameras(source, own, body, tmp_path, axis_angle):
    turn = matrix_from_axis_angle(np.array(axis_angle))
    root = write_easymocap(source, tmp_path / "anna", body, turn=turn)
    notes = imported(own, tmp_path / "out", body, source=root)
    found = assert_same_capture(tmp_path / "out", source, raw=False)
    for frame in range(3):
        up = matrix_from_axis_angle(found.videos["body"].axis_angle[frame, 0])[:, 1]
        assert up[1] > 0.8
    assert any("turned to y" in note for note in notes)


def test_the_shape_of_the_fits_shapes_template_and_pelvis(damaged, body, tmp_path):
    betas = np.array([1.5, -0.8])
    people_changed(damaged.root, "body", lambda p: p.update(shapes=[betas.tolist()]))
    people_changed(damaged.root, "hand_left", lambda p: p.update(shapes=[(0.5 * betas).tolist()]))
    # the head of another shape no longer meets the landmarks of this one to the micron
    imported(damaged, tmp_path / "out", body)
    found = read_capture(tmp_path / "out")
    person = shaped(body, betas)
    np.testing.assert_allclose(found.subject.rest, person.vertices, atol=1e-7)
    np.testing.assert_allclose(found.subject.joints, person.joints, atol=1e-9)
    assert np.abs(person.origin - J0).max() > 0.003
    for k, file in enumerate(sorted((damaged.root / "body/smpl").iterdir())):
        fit = json.loads(file.read_text())[0]
        R = matrix_from_axis_angle(np.array(fit["Rh"][0]))
        np.testing.assert_allclose(found.videos["body"].root[k], fit["Th"][0] + R @ person.origin, atol=1e-9)


def test_a_hand_of_another_shape_keeps_its_wrist(damaged, body, tmp_path):
    from avatar.skeleton import joint_transforms

    betas = np.array([2.0, -1.0])
    people_changed(damaged.root, "hand_right", lambda p: p.update(shapes=[betas.tolist()]))
    imported(damaged, tmp_path / "out", body)
    found = read_capture(tmp_path / "out")
    own, video = shaped(body, betas), found.videos["hand_right"]
    for k, file in enumerate(sorted((damaged.root / "hand_right/smpl").iterdir())):
        fit = json.loads(file.read_text())[0]
        pelvis = np.array(fit["Th"][0]) + matrix_from_axis_angle(np.array(fit["Rh"][0])) @ own.origin
        theirs = joint_transforms(video.axis_angle[k], own.joints, pelvis)[21, :3, 3]
        ours = joint_transforms(video.axis_angle[k], found.subject.joints, video.root[k])[21, :3, 3]
        np.testing.assert_allclose(ours, theirs, atol=1e-9)
        assert np.linalg.norm(pelvis - video.root[k]) > 1e-3


def test_a_model_in_text_and_annots_and_rodrigues_are_read_alike(source, damaged, body, tmp_path):
    head = write_colmap(source, tmp_path / "opencv", model="OPENCV")
    for file in sorted((damaged.root / "body/smpl").iterdir()):
        file.write_text(json.dumps({"annots": json.loads(file.read_text())}))
    (damaged.root / "hand_left/output/smpl").mkdir(parents=True)
    (damaged.root / "hand_left/smpl").rename(damaged.root / "hand_left/output/smpl/smpl")
    lines = (damaged.root / "body/extri.yml").read_text().split("Rot_01:")
    rest = lines[1].split("T_01:")[1]
    (damaged.root / "body/extri.yml").write_text(f"{lines[0]}T_01:{rest}")
    imported(damaged, tmp_path / "out", body, head=head)
    assert_same_head(assert_same_capture(tmp_path / "out", source), source)


def test_landmarks_of_own_names_need_their_vertices(source, own, body, vertices, tmp_path):
    renamed = {f"mole_{i}": v for i, v in enumerate(vertices.values())}
    path = write_landmark_pixels(source, tmp_path / "own.json", renamed, named=False)
    imported(own, tmp_path / "out", body, landmarks=path)
    assert_same_head(read_capture(tmp_path / "out"), source)
    without = json.loads(path.read_text())
    without.pop("vertices")
    path.write_text(json.dumps(without))
    with pytest.raises(AssetError, match=r"own\.json: pixels\.mole_0: expected one of nose_tip, .* or its vertex"):
        imported(own, tmp_path / "other", body, landmarks=path)


def edited(path, old, new):
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))


def landmarks_changed(own, change):
    content = json.loads(own.landmarks.read_text())
    change(content["pixels"])
    own.landmarks.write_text(json.dumps(content))


def swap_sides(pixels):
    for name in [name for name in pixels if name.startswith("left_")]:
        other = name.replace("left", "right")
        pixels[name], pixels[other] = pixels[other], pixels[name]


def metres_to_millimetres(own):
    matrices = read_opencv_yaml(own.root / "hand_left/extri.yml")
    text = (own.root / "hand_left/extri.yml").read_text().split("T_01:")[0]
    (own.root / "hand_left/extri.yml").write_text(text + opencv_matrix("T_01", 1000 * matrices["T_01"]))


BAD = {
    "results twice": (
        lambda o: shutil.copytree(o.root / "body/smpl", o.root / "body/output/smplfull"),
        r"body: expected EasyMocap's results in one of smpl/, .* found \['output/smplfull', 'smpl'\]",
    ),
    "millimetres for metres": (
        metres_to_millimetres,
        r"hand_left/extri\.yml: T and Th of .*smpl should place the camera .* check millimetres",
    ),
    "a matrix that is too short": (
        lambda o: edited(o.root / "body/extri.yml", "rows: 3\n   cols: 1", "rows: 4\n   cols: 1"),
        r"extri\.yml: R_01 should have 4 x 1 numbers, has 3",
    ),
    "frames of different sizes": (
        lambda o: Image.new("RGB", (30, 32)).save(o.root / "body/images/01/000501.png"),
        r"000501\.png: should be \(32, 32\) pixels .* is \(30, 32\)",
    ),
    "head frames of another size": (
        lambda o: Image.new("RGB", (30, 32)).save(o.root / "head/images/000001.png"),
        r"head/images/000001\.png: should be \(32, 32\) pixels as its camera .* is \(30, 32\)",
    ),
    "another video's model": (
        lambda o: [p.rename(p.with_name(f"x{p.name}")) for p in sorted((o.root / "head/images").iterdir())],
        r"colmap: expected at least 3 images of .* found 0; the model has \['000000\.png'",
    ),
    "a failed fit": (
        lambda o: people_changed(o.root, "body", lambda p: p.update(shapes=[[40.0, 0]])),
        r"000500\.json: shapes should lie within 10, hold 40: the fit failed",
    ),
    "SMPL-X": (
        lambda o: people_changed(o.root, "body", lambda p: p.update(poses=[[0.0] * 165], handl=[[]], handr=[[]])),
        r"000500\.json: poses should be of SMPL or SMPL\+H as .* is, has 165 numbers, SMPL-X's",
    ),
}
MOVED = [
    ("hand_left", "hand", r"anna: expected folders body, .* found no hand_left"),
    ("masks/head", "masks/face", r"masks: expected folders .* found no head"),
    ("masks/body/000501.png", "gone", r"masks/body/000501\.png: no such mask"),
    ("body/smpl/000502.json", "gone", r"poses of each of 3 images, found 2; the first without is 000502\.png"),
    ("body/smpl/000502.json", "body/smpl/000503.json", r"000502\.png: expected poses .*000502\.json, found none"),
    ("body/smpl", "body/fits", r"body: expected EasyMocap's results in one of smpl/, .* found none"),
    ("body/extri.yml", "gone", r"extri\.yml: no such file"),
]
LANDMARKS = [
    (lambda p: [p.pop(n) for n in list(p)[5:]], r"landmarks\.json: expected at least 6 landmarks, found 5"),
    (lambda p: p["chin"].update({"000009.png": [1, 2]}), r"landmarks\.json: pixels\.chin: 000009\.png is no image"),
    (swap_sides, r"landmarks\.json: landmarks"),
    (lambda p: p["chin"].update({"000000.png": [31.0, 1.0]}), r"chin should be one place in all its pictures"),
]
BAD |= {
    message: (lambda o, a=source, b=target: (o.root / a).rename(o.root / b), message)
    for source, target, message in MOVED
}
BAD |= {message: (lambda o, c=change: landmarks_changed(o, c), message) for change, message in LANDMARKS}


@pytest.mark.parametrize("case", BAD)
def test_bad_folders_are_refused_in_one_line(damaged, tmp_path, body, case):
    change, message = BAD[case]
    change(damaged)
    with pytest.raises(AssetError, match=message) as error:
        imported(damaged, tmp_path / "out", body)
    assert "\n" not in str(error.value) and not (tmp_path / "out").exists()


def test_masks_that_show_no_one_are_refused_under_the_name_asked_for(damaged, tmp_path, body):
    for file in (damaged.masks / "head").iterdir():
        Image.new("L", (32, 32)).save(file)
    with pytest.raises(AssetError, match=r"out/head/masks: no pixel of any frame shows the person"):
        imported(damaged, tmp_path / "out", body)
    assert list(tmp_path.glob("*out*")) == []
