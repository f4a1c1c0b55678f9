"""A small capture of a real person: registration, masks, the head's frame, files, seeds."""

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from avatar.camera import Camera, look_at, project, read_cameras
from avatar.rotation import matrix_from_axis_angle
from avatar.similarity import similarity_from_landmarks
from avatar.skeleton import JOINTS, PARTS, skin_transforms
from avatar.skinning import SkinWeights, skin_points
from capture.folder import CaptureSubject
from capture.folder import read_subject as read_template
from capture.held_out import read_held_out
from synth.command import SynthConfig, synth
from synth.cutout import cut_out
from synth.film import plan_videos
from synth.head_frame import LANDMARK_NOISE, cameras_in_head_frame, seeded_similarity
from synth.light import light_of
from synth.photo import Studio
from synth.subject import SynthSubject, read_subject
from synth.truth import novel_poses, novel_views, take_set

CONFIG = SynthConfig(size=128, frames=5, truth=False, pose_noise=1.0, seed=3)


@pytest.fixture(scope="module")
def person(data) -> Path:
    return data / "characters" / "White_M_1_Casual.glb"


@pytest.fixture(scope="module")
def capture(person, made_once) -> Path:
    return made_once("real_person", lambda folder: synth(str(person), folder, CONFIG))


@pytest.fixture(scope="module")
def subject(person) -> SynthSubject:
    return read_subject(person)


@pytest.fixture(scope="module")
def studio(rasteriser, subject) -> Studio:
    return Studio(rasteriser, subject, supersample=1)


@pytest.fixture(scope="module")
def template(capture) -> CaptureSubject:
    return read_template(capture / "subject.npz")


def test_the_template_lies_on_the_surface_and_keeps_the_subjects_own_joints(capture, subject, template):
    registration = json.loads((capture / "capture.json").read_text())["registration"]
    assert registration["surface_cm"] < 0.21  # notes/ceiling.md reached .21, hands .06; measured here .16, .04, .05
    assert registration["hands_cm"] < 0.06
    assert registration["head_cm"] < 0.08
    np.testing.assert_array_equal(template.joints, subject.joints.astype(np.float64))


def overlap(drawn, path):
    """Of what is drawn and the person of a mask, the share that is both."""
    mask = np.asarray(Image.open(path)) > 127
    return (drawn & mask).sum() / (drawn | mask).sum()


@pytest.mark.parametrize("part", ["body", "hand_left", "hand_right"])
def test_the_posed_template_fills_the_masks(capture, template, rasteriser, studio, part):
    """With the true poses: the written ones carry a degree of noise on purpose."""
    shots = plan_videos(studio, CONFIG.frames, CONFIG.size)[part]
    both = []
    for i, camera in enumerate(read_cameras(capture / part / "cameras.npz")):
        transforms = skin_transforms(shots.axis_angle[i], template.joints, shots.root[i], rest=np.zeros((52, 3)))
        drawn = rasteriser.draw(skin_points(template.rest, template.skin, transforms), template.faces, camera).face >= 0
        both.append(overlap(drawn, capture / part / "masks" / f"{i:06d}.png"))
    assert np.mean(both) > 0.95  # of masks 15 pixels wide at a shin; .975 at 256 pixels


def test_the_template_in_the_head_frame_fills_the_masks(capture, template, rasteriser):
    similarity = seeded_similarity(CONFIG.seed)
    in_head = template.rest @ similarity[:3, :3].T + similarity[:3, 3]
    cameras = read_cameras(capture / "head" / "cameras.npz")
    drawn = [rasteriser.draw(in_head, template.faces, camera).face >= 0 for camera in cameras]
    masks = sorted((capture / "head" / "masks").iterdir())
    assert np.mean(list(map(overlap, drawn, masks))) > 0.97


def test_head_cameras_show_what_the_world_cameras_show(studio, subject):
    shots = plan_videos(studio, 4, 128)["head"]
    similarity = seeded_similarity(9)
    head = subject.vertices[subject.skin.weights[:, 0] * (subject.skin.joints[:, 0] == JOINTS.index("head")) == 1]
    in_head = head.astype(np.float64) @ similarity[:3, :3].T + similarity[:3, 3]
    moved = cameras_in_head_frame(shots, subject.joints, similarity)
    for i, camera in enumerate(moved):
        turn = matrix_from_axis_angle(shots.axis_angle[i, 0])
        world, _ = project(shots.cameras[i], head @ turn.T + shots.root[i])
        np.testing.assert_allclose(project(camera, in_head)[0], world, atol=1e-4)  # float32 vertices


def test_landmarks_give_the_similarity_back(capture, template):
    stored = json.loads((capture / "head" / "landmarks.json").read_text())
    assert len(stored["points"]) >= 6 and stored["points"].keys() == stored["vertices"].keys()
    source = template.rest[list(stored["vertices"].values())]
    found = similarity_from_landmarks(source, np.array(list(stored["points"].values())))
    off = np.linalg.inv(seeded_similarity(CONFIG.seed)) @ found.transform
    scale = np.cbrt(np.linalg.det(off[:3, :3]))
    assert abs(scale - 1) < 0.02
    assert np.degrees(np.arccos((np.trace(off[:3, :3] / scale) - 1) / 2)) < 2
    # root of the mean square of three coordinates, in the head's unit
    unit = np.cbrt(np.linalg.det(found.transform[:3, :3]))
    assert 0.5 * LANDMARK_NOISE < found.residual / unit / np.sqrt(3) < 1.5 * LANDMARK_NOISE


@pytest.mark.slow
def test_the_same_seed_writes_the_same_bytes(capture, person, tmp_path):
    synth(str(person), tmp_path / "second", CONFIG)
    # the mark of the folder holds the times of its files
    names, others = (
        {p.relative_to(folder) for p in folder.rglob("*") if p.is_file() and p.name != ".selfscan"}
        for folder in (capture, tmp_path / "second")
    )
    assert names == others
    assert not [name for name in names if (capture / name).read_bytes() != (tmp_path / "second" / name).read_bytes()]


def test_noise_is_on_written_poses_alone_and_held_out_views_were_not_filmed(capture, studio):
    shots = plan_videos(studio, CONFIG.frames, CONFIG.size)["body"]
    with np.load(capture / "body" / "poses.npz") as written:
        noisy = matrix_from_axis_angle(written["poses"].reshape(-1, 52, 3))
        np.testing.assert_array_equal(written["trans"], shots.root)
    turn = np.swapaxes(matrix_from_axis_angle(shots.axis_angle), -1, -2) @ noisy
    angle = np.degrees(np.arccos(np.clip((np.trace(turn, axis1=-2, axis2=-1) - 1) / 2, -1, 1)))
    assert abs(np.sqrt((angle**2).mean() / 3) - CONFIG.pose_noise) < 0.1
    poses = novel_poses(0)
    assert len(poses) == 20 and len(novel_views(0)) == 10
    stacked = np.stack([pose[1:] for pose, _ in poses])
    assert np.abs(stacked).max(axis=(1, 2)).min() > 0.3  # none is the T-pose
    assert np.ptp(stacked[:, 21:], axis=0).max(1).min() > 0.02  # every finger joint moves
    np.testing.assert_array_equal(novel_poses(0)[13][0], poses[13][0])


def test_head_and_hand_pixels_are_two_millimetres_or_less(capture):
    scale = json.loads((capture / "capture.json").read_text())["head_units_per_metre"]
    for part in PARTS[1:]:
        camera = read_cameras(capture / part / "cameras.npz")[0]
        similarity = seeded_similarity(CONFIG.seed)
        target, unit = (similarity[:3, 3], scale) if part == "head" else (np.zeros(3), 1.0)
        # the head turns about its own middle, less than a metre from the origin of pose 0
        distance = 1.0 if part == "head" else np.linalg.norm(camera.eye - target) / unit
        assert distance / camera.K[0, 0] <= 0.002


def test_held_out_pictures_read_back(rasteriser, studio, subject, tmp_path):
    stand = 0.1 * np.random.default_rng(0).standard_normal((52, 3)), np.array([0.5, 0, -2])
    names = list(take_set(studio, [stand], tmp_path / "truth" / "novel_pose", light_of("even", "body", 0), 0))
    views = read_held_out(tmp_path, "novel_pose")
    assert [view.name for view in views] == names
    vertices = studio.posed(*stand)
    for view in views:
        parts = view.parts()
        np.testing.assert_array_equal(parts > 0, view.mask())
        fragments = rasteriser.draw(vertices, subject.faces, view.camera)
        np.testing.assert_array_equal(fragments.face >= 0, view.mask())
        if view.view != "body":
            assert (parts == 1 + PARTS.index(view.view)).mean() > 0.1


def textured_quad(vertices, texture, alpha=None):
    """Two triangles that show the whole texture upright, and nothing else of a subject."""
    vertices, faces = np.array(vertices, np.float32), np.array([[0, 1, 2], [0, 2, 3]], np.int32)
    skin = SkinWeights(np.zeros((4, 4), np.int64), np.eye(1, 4, dtype=np.float32).repeat(4, 0))
    uv, part = np.array([[0, 1], [1, 1], [1, 0], [0, 0]], np.float32), np.zeros(4, np.uint8)
    return SynthSubject("quad", vertices, faces, uv, np.zeros(2, np.int32), (texture,), (alpha,), skin,
                        np.zeros((52, 3), np.float32), part, np.zeros(4, bool), "none")  # fmt: skip


def test_a_cut_out_quad_keeps_its_opaque_half_and_a_textured_one_is_drawn_texel_by_texel(rasteriser):
    alpha = np.zeros((64, 64), np.uint8)
    alpha[:, 32:] = 255
    corners = [[0, 0, 0], [0.1, 0, 0], [0.1, 0.1, 0], [0, 0.1, 0]]
    quad = textured_quad(corners, np.zeros((64, 64, 3), np.uint8), alpha)
    cut = cut_out(quad)
    corners = cut.vertices[cut.faces]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1).sum() / 2
    assert abs(area - 0.005) < 0.0001
    assert corners[..., 0].min() > 0.045
    texture = np.random.default_rng(0).integers(0, 256, (8, 8, 3), dtype=np.uint8)
    quad = textured_quad([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], texture)
    camera = Camera(np.array([[16.0, 0, 4], [0, 16, 4], [0, 0, 1]]), look_at([0, 0, 4], [0, 0, 0]), (8, 8))
    photo = Studio(rasteriser, quad, 1).take(quad.vertices.astype(np.float64), camera, light_of("even", "body", 0))
    assert np.abs(photo.image.astype(int) - texture).max() <= 1  # pixel centres fall on texel centres
    assert (photo.mask == 255).all() and (photo.parts == 1).all()


def test_a_picture_in_the_room_keeps_mask_and_parts_and_is_darker_on_the_far_side(studio):
    """Studio with a room: the window is at the picture's left, the body's right half is darker than its left one."""
    shots = plan_videos(studio, 4, 64)["body"]
    vertices = studio.posed(shots.axis_angle[0], shots.root[0])
    even = studio.take(vertices, shots.cameras[0], light_of("even", "body", 0))
    room = studio.take(vertices, shots.cameras[0], light_of("room", "body", 0))
    np.testing.assert_array_equal(room.mask, even.mask)
    np.testing.assert_array_equal(room.parts, even.parts)
    assert (room.image[even.mask == 0] == even.image[even.mask == 0]).all()
    column = np.nonzero(even.mask)[1]
    ratio = room.image[even.mask > 0].sum(1) / np.maximum(even.image[even.mask > 0].sum(1, dtype=float), 1)
    assert ratio[column < 32].mean() > 1.1 * ratio[column >= 32].mean()
    shining = Studio(studio.rasteriser, studio.subject, 1, 0.5)
    sheen = shining.take(vertices, shots.cameras[0], light_of("room", "body", 0))
    assert (sheen.image.astype(int) - room.image).min() >= 0 < (sheen.image.astype(int) - room.image).max()
