"""BVH files, and their motion on our skeleton."""

from functools import cache

import numpy as np
import pytest

from avatar.body import builtin_body
from avatar.hull import body_hull
from avatar.motion.bvh import open_bvh, read_bvh
from avatar.motion.ground import on_ground
from avatar.motion.read import read_motion
from avatar.motion.rig import side_and_base
from avatar.rotation import matrix_from_axis_angle
from avatar.skeleton import JOINT_NUMBERS as J
from avatar.skeleton import JOINTS, PARENTS, joint_transforms
from command.errors import AssetError

# our joint -> joint of the file, written out here by hand: the test's own word on what the names mean
CMU = {"left_hip": "LeftUpLeg", "left_knee": "LeftLeg", "left_ankle": "LeftFoot", "left_shoulder": "LeftArm",
           "left_elbow": "LeftForeArm", "left_wrist": "LeftHand"}  # fmt: skip
MIXAMO = {ours: f"mixamorig:{theirs}" for ours, theirs in CMU.items()}
MIXAMO |= {
    f"left_{f.lower()}{n}": f"mixamorig:LeftHand{f}{n}"
    for f in ("Index", "Middle", "Pinky", "Ring", "Thumb")
    for n in (1, 2, 3)
}
BANK = {"left_hip": "LeftHip", "left_knee": "LeftKnee", "left_ankle": "LeftAnkle", "left_shoulder": "LeftShoulder",
            "left_elbow": "LeftElbow", "left_wrist": "LeftWrist"}  # fmt: skip
MAKEHUMAN = {"left_hip": "UpLeg_L", "left_knee": "LoLeg_L", "left_ankle": "Foot_L", "left_shoulder": "UpArm_L",
             "left_elbow": "LoArm_L", "left_wrist": "Hand_L", "left_index1": "Index1_L",
             "left_index2": "Index2_L"}  # fmt: skip
DAZ = {"left_hip": "lThighBend", "left_knee": "lShin", "left_ankle": "lFoot", "left_shoulder": "lShldrBend",
       "left_elbow": "lForearmBend", "left_wrist": "lHand", "left_middle1": "lMid1",
       "left_middle2": "lMid2"}  # fmt: skip
RIGS = {
    "fairmotion_cmu_01_01": CMU, "pybvh_cmu_12_01_walk": CMU, "pymo_AV_8Walk_Meredith": CMU, "pybvh_example": CMU,
    "geno_stance": CMU, "bvhpython_freebvh": MIXAMO, "bvhpython_mocapbank": BANK, "makehuman_walk1": MAKEHUMAN,
    "bvhjl_DAZ3D": DAZ,
}  # fmt: skip
Z_UP = {"makehuman_walk1", "pybvh_example"}


def other_side(name: str) -> str:
    for a, b in (("Left", "Right"), ("left", "right"), ("_L", "_R")):
        name = name.replace(a, b)
    return "r" + name[1:] if name[0] == "l" else name


@cache
def ours(path):
    """The file's motion on the built-in man, on the ground, and his joints' frames; only to read."""
    clip = on_ground(read_bvh(path), body_hull(builtin_body("male"))).read()
    return clip, joint_transforms(clip.axis_angle, builtin_body("male").joints, clip.root)


@pytest.mark.parametrize("name", RIGS)
def test_limbs_point_where_the_files_own_kinematics_points_them(name, data, within):
    path = data / "bvh" / f"{name}.bvh"
    bvh = open_bvh(path)
    _, at = bvh.transforms(np.arange(bvh.frames))
    _, G = ours(path)
    left = RIGS[name]
    pairs = left | {ours.replace("left", "right"): other_side(theirs) for ours, theirs in left.items()}
    checked = 0
    for joint, theirs in pairs.items():
        parent = JOINTS[PARENTS[J[joint]]]
        if parent not in pairs or (joint.endswith("1") and "wrist" in parent):  # metacarpals: palms differ in shape
            continue
        a = at[:, bvh.names.index(theirs)] - at[:, bvh.names.index(pairs[parent])]
        if name in Z_UP:
            a = np.stack([a[:, 0], a[:, 2], -a[:, 1]], -1)
        b = G[:, J[joint], :3, 3] - G[:, PARENTS[J[joint]], :3, 3]
        sine = np.linalg.norm(np.cross(a, b), axis=-1) / np.linalg.norm(a, axis=-1) / np.linalg.norm(b, axis=-1)
        assert (a * b).sum(-1).min() > 0
        within(np.degrees(np.arcsin(np.clip(sine, 0, 1))).max(), 0.01, "degrees")
        checked += 1
    assert checked >= 8


@pytest.mark.parametrize("name", [n for n in RIGS if n != "bvhjl_DAZ3D"])
def test_no_joint_turns_faster_than_in_the_file(name, data):
    """A flip would be a turn that the file does not have: one constant rotation lies between its bones and ours."""
    path = data / "bvh" / f"{name}.bvh"
    bvh = open_bvh(path)
    R, _ = bvh.transforms(np.arange(bvh.frames))
    _, G = ours(path)
    left = RIGS[name]
    for joint, theirs in (left | {o.replace("left", "right"): other_side(t) for o, t in left.items()}).items():
        mine, file = G[:, J[joint], :3, :3], R[:, bvh.names.index(theirs)]
        mine = np.trace(np.swapaxes(mine[:-1], 1, 2) @ mine[1:], axis1=1, axis2=2)
        file = np.trace(np.swapaxes(file[:-1], 1, 2) @ file[1:], axis1=1, axis2=2)
        np.testing.assert_allclose(mine, file, atol=1e-9)


@pytest.mark.parametrize("name", RIGS)
def test_the_body_stands_upright_on_its_feet_with_knees_and_sides_right(name, data):
    clip, G = ours(data / "bvh" / f"{name}.bvh")
    head, pelvis = G[:, J["head"], :3, 3], G[:, 0, :3, 3]
    assert np.median(head[:, 1] - pelvis[:, 1]) > 0.3  # metres; one file is gymnastics
    toes = G[:, [J["left_foot"], J["right_foot"]], 1, 3].min(1)
    assert -0.06 < np.percentile(toes, 5) < 0.08  # metres; the ball of the foot is 3 cm above the sole
    assert clip.axis_angle[:, [J["left_knee"], J["right_knee"]], 0].min() > -0.05
    left = ((G[:, J["left_shoulder"], :3, 3] - G[:, J["right_shoulder"], :3, 3]) * G[:, 0, :3, 0]).sum(-1)
    assert left.min() > 0.2
    elbows = clip.axis_angle[:, [J["left_elbow"], J["right_elbow"]], 1]  # left bends about -y, right about +y
    assert np.median(elbows[:, 0]) < 0.05 and np.median(elbows[:, 1]) > -0.05


def test_the_walk_goes_forward_at_walking_speed_with_bending_knees(data):
    clip, G = ours(data / "bvh" / "pybvh_cmu_12_01_walk.bvh")
    speed = np.gradient(clip.root, axis=0)[1:] * clip.rate
    forward = G[1:, 0, :3, 2]
    assert 0.7 < (speed * forward).sum(-1).mean() < 1.6  # metres per second
    assert clip.axis_angle[:, J["left_knee"], 0].max() > 0.8
    ankles = G[1:, [J["left_ankle"], J["right_ankle"]], 1, 3]
    assert ankles.min() > 0.04 and np.median(ankles.min(1)) < 0.12


def test_notes_say_scale_up_axis_hands_and_calibration_frame(data):
    notes = "\n".join(read_bvh(data / "bvh" / "fairmotion_cmu_01_01.bvh").notes)
    for word in ("scale: leg 14.8 units -> 0.867 m", "up: +y", "no separate fingers", "frame 0", "17 degrees off"):
        assert word in notes
    assert "up: +z" in "\n".join(read_bvh(data / "bvh" / "pybvh_example.bvh").notes)
    assert "left_foot" in "\n".join(read_bvh(data / "bvh" / "bvhpython_mocapbank.bvh").notes)


def test_stretches_equal_the_whole_also_for_frames_wrapped_over_lines(data):
    motion = read_motion(data / "bvh" / "pymo_AV_8Walk_Meredith.bvh")
    whole = motion.read()
    for start, stop in [(0, 1), (63, 66), (1000, 1064), (3, 3)]:
        part = motion.read(start, stop)
        np.testing.assert_array_equal(part.axis_angle, whole.axis_angle[start:stop])
        np.testing.assert_array_equal(part.root, whole.root[start:stop])


@pytest.mark.parametrize(
    "name, expected",
    [("mixamorig:LeftUpLeg", ("left", "upleg")), ("lThighBend", ("left", "thighbend")), ("UpLeg_L", ("left", "upleg")),
     ("RThumb", ("right", "thumb")), ("left_hip", ("left", "hip")), ("LowerBack", ("", "lowerback")),
     ("upper_arm.R", ("right", "upperarm")), ("LoLeg_L", ("left", "loleg")), ("lowerJaw", ("", "lowerjaw")),
     ("Rib", ("", "rib"))],
)  # fmt: skip
def test_sides_are_told_from_names(name, expected):
    assert side_and_base(name) == expected


TINY = """HIERARCHY
ROOT a
{
  OFFSET 0 0 0
  CHANNELS 6 Xposition Yposition Zposition Yrotation Zrotation Xrotation
  JOINT b
  {
    OFFSET 1 0 0
    CHANNELS 3 Zrotation Xrotation Yrotation
    End Site
    {
      OFFSET 0 2 0
    }
  }
}
MOTION
Frames: 2
Frame Time: 0.5
1 2 3 90 0 0 90 0 0
0 0 0 10 20 30
40 50 60
"""


def test_channels_compose_in_the_order_written_and_frames_may_wrap(tmp_path):
    (tmp_path / "t.bvh").write_text(TINY)
    bvh = open_bvh(tmp_path / "t.bvh")
    assert (bvh.frames, bvh.rate, bvh.ends) == (2, 2.0, ((1, (0.0, 2.0, 0.0)),))
    R, at = bvh.transforms(np.arange(2))

    def turn(axis, degrees):
        return matrix_from_axis_angle(np.eye(3)["XYZ".index(axis)] * np.radians(degrees))

    np.testing.assert_allclose(at[0], [[1, 2, 3], [1, 2, 2]], atol=1e-14)
    np.testing.assert_allclose(R[0, 1], turn("Y", 90) @ turn("Z", 90), atol=1e-14)
    root = turn("Y", 10) @ turn("Z", 20) @ turn("X", 30)
    np.testing.assert_allclose(R[1, 1], root @ turn("Z", 40) @ turn("X", 50) @ turn("Y", 60), atol=1e-14)


@pytest.mark.parametrize(
    "old, new, message",
    [
        ("HIERARCHY", "hello", "line 1: expected HIERARCHY"),
        ("Frames: 2", "Frames: 0", "line 17: 0 frames"),
        ("Frames: 2", "Frames: 3", "promises 3 frames"),
        ("Frames: 2", "Frames: 1", "more than the 1 frames"),
        ("Frame Time: 0.5", "Frame Time: 0", "line 18: Frame Time should be positive"),
        ("Frame Time: 0.5", "Frame Time: nan", "line 18: Frame Time"),
        ("CHANNELS 3 Zrotation", "CHANNELS 4 Zrotation", "line 9: CHANNELS promises 4"),
        ("Zrotation Xrotation Yrotation", "Zrotation Zrotation Yrotation", "line 9: CHANNELS should be different"),
        ("OFFSET 1 0 0", "OFFSET 1 zero 0", "line 8: OFFSET"),
        ("    OFFSET 1 0 0\n", "", "has no OFFSET"),
        ("  }\n}\nMOTION", "  }\nMOTION", "before the hierarchy is closed"),
        ("0 0 0 10 20 30\n", "0 0 0 10 20 30 40\n", "should have 9 numbers, has 10"),
    ],
)
def test_broken_files_are_refused_with_file_and_line(tmp_path, old, new, message):
    assert old in TINY
    (tmp_path / "t.bvh").write_text(TINY.replace(old, new, 1))
    with pytest.raises(AssetError, match=message) as caught:
        open_bvh(tmp_path / "t.bvh")
    assert "t.bvh" in str(caught.value)


@pytest.mark.parametrize("word, message", [("nan", "line 20: frame 1, joint a is not finite"), ("x", "frame 1")])
def test_numbers_are_checked_when_their_frame_is_read(tmp_path, word, message):
    (tmp_path / "t.bvh").write_text(TINY.replace("0 0 0 10 20 30", f"0 0 0 {word} 20 30"))
    bvh = open_bvh(tmp_path / "t.bvh")
    bvh.values(0, 1)
    with pytest.raises(AssetError, match="frame 1"):
        bvh.values(0, 2)
