"""Other rigs' motion on an avatar's own bones, and rigs whose rest pose is nobody's."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from pose_twins import LIMBS, degrees_between, directions

from avatar.body import builtin_body
from avatar.motion.bvh import open_bvh, read_bvh
from avatar.motion.bvh_write import euler_zxy
from avatar.motion.clip import RestSkeleton
from avatar.motion.read import builtin_motion
from avatar.motion.retarget import retarget
from avatar.motion.rig import AnimatedRig
from avatar.rotation import axis_angle_from_matrix, matrix_from_axis_angle, rotation_between
from avatar.skeleton import JOINT_NUMBERS as J
from avatar.skeleton import JOINTS, PARENTS, joint_transforms
from command.errors import AssetError

PEOPLE = ("White_M_1", "White_F_1", "Black_M_2", "Asian_F_2")
MIXAMO = {
    "pelvis": "Hips", "spine1": "Spine", "spine2": "Spine1", "spine3": "Spine2", "neck": "Neck", "head": "Head",
    "hip": "UpLeg", "knee": "Leg", "ankle": "Foot", "foot": "ToeBase", "collar": "Shoulder", "shoulder": "Arm",
    "elbow": "ForeArm", "wrist": "Hand",
}  # fmt: skip


def exporter_name(joint):
    side, _, base = joint.rpartition("_")
    return side.capitalize() + MIXAMO[base]


@dataclass(frozen=True, kw_only=True)
class MadeRig(AnimatedRig):
    """The 22 joints of a body moving, each bone's own axes turned by `axes` against the T-pose's."""

    joints: np.ndarray  # (22, 3)
    rotations: np.ndarray  # (frames, 22, 3, 3), of the T-pose's axes
    places: np.ndarray  # (frames, 22, 3)
    axes: np.ndarray  # (22, 3, 3)

    def transforms(self, frames):
        return self.rotations[frames] @ self.axes, self.places[frames]

    def offsets(self):
        out = np.array(self.joints)
        for k in range(1, 22):
            out[k] = self.axes[PARENTS[k]].T @ (self.joints[k] - self.joints[PARENTS[k]])
        return out

    @property
    def rest_positions(self):
        at = self.offsets()
        for k in range(1, 22):
            at[k] += at[PARENTS[k]]
        return at


def made_rig(joints, rotations, places, axes):
    names, parents = tuple(map(exporter_name, JOINTS[:22])), tuple(int(p) for p in PARENTS[:22])
    return MadeRig(
        path=Path("made.bvh"), names=names, parents=parents, frames=len(places), rate=30.0, joints=joints,
        rotations=rotations, places=places, axes=axes,
    )  # fmt: skip


def moving(name="walking", start=0, stop=48):
    """Joints and motion of the built-in man: rotations and places."""
    clip = builtin_motion(name).read(start, stop)
    joints = builtin_body("male").joints.astype(np.float64)
    G = joint_transforms(clip.axis_angle, joints, clip.root)[:, :22]
    return joints[:22], G[..., :3, :3], G[..., :3, 3]


def unit(v):
    return v / np.linalg.norm(v)


def stick_axes(joints, *, mirrored, rolls):
    """Axes that lie along the bones: x up in the torso, x along each limb, at rolls of its own; with `mirrored` the
    right limbs run along -x and the spine has a quarter turn, as Bandai Namco's."""
    up = np.array([[0.0, 0, 1], [1, 0, 0], [0, 1, 0]])  # columns x, y, z of the bone: up, forward, left
    quarter = matrix_from_axis_angle(np.array([np.pi / 2, 0, 0]))
    axes = np.tile(np.eye(3), (22, 1, 1))
    for name in ("pelvis", "spine1", "spine2", "spine3", "neck", "head"):
        axes[J[name]] = up @ quarter if mirrored and name in ("spine1", "pelvis") else up
    for number, (side, limb) in enumerate((s, part) for s in ("left", "right") for part in ("leg", "arm")):
        chain = ["hip", "knee", "ankle", "foot"] if limb == "leg" else ["collar", "shoulder", "elbow", "wrist"]
        ids = [J[f"{side}_{n}"] for n in chain]
        along = np.array([-1.0 if mirrored and side == "right" else 1.0, 0, 0])
        last = None
        for k, (a, b) in enumerate(zip(ids, [*ids[1:], None], strict=True)):
            way = unit(joints[b] - joints[a]) if b is not None else way
            if last is None:
                turn = matrix_from_axis_angle(along * rolls[number] * (limb == "leg" or k > 0))
                base = rotation_between(along, way) @ turn
            else:
                base = rotation_between(last, way) @ base
            axes[a], last = base, None if limb == "arm" and k == 0 else way
    return axes


def turn_between(a, b):
    """Degrees between rotations."""
    return np.degrees(np.linalg.norm(axis_angle_from_matrix(np.swapaxes(a, -1, -2) @ b), axis=-1))


@pytest.mark.parametrize("mirrored", [False, True])
@pytest.mark.parametrize("rolls", [(0, 0, 0, 0), (np.pi / 2, -np.pi / 2, np.pi, np.pi), (0.7, 2.1, -1.3, 0.4)])
@pytest.mark.parametrize("name, start, stop", [("walking", 0, 48), ("counting", 0, 300)])
def test_a_stick_along_x_moves_as_its_twin_in_t_pose(name, start, stop, mirrored, rolls, within):
    """Bone directions to rounding; turns about the bones, which only the motion tells, within 12 degrees."""
    joints, R, at = moving(name, start, stop)
    other = builtin_body("female")
    skeleton = RestSkeleton(other.joints.astype(np.float64), 0.9)
    twin = retarget(made_rig(joints, R, at, np.tile(np.eye(3), (22, 1, 1))), skeleton, up_known=True)
    stick = retarget(
        made_rig(joints, R, at, stick_axes(joints, mirrored=mirrored, rolls=rolls)), skeleton, up_known=True
    )
    assert any("no person's" in note for note in stick.notes)
    a, b = twin.read(), stick.read()
    A, B = (joint_transforms(c.axis_angle, skeleton.joints, c.root) for c in (a, b))
    within(degrees_between(*(directions(G[..., :3, 3], LIMBS) for G in (A, B))), 1e-4, "degrees")
    off = turn_between(A[:, :22, :3, :3], B[:, :22, :3, :3]).max(0)
    within(off, 12.0, "degrees")
    np.testing.assert_allclose(a.root, b.root, atol=0.01)


def write_stick(path, rig):
    """The rig as a BVH file: bones along x, three rotations a joint."""
    local = rig.rotations @ rig.axes
    world = local.copy()
    local[:, 1:] = np.swapaxes(world[:, PARENTS[1:22]], -1, -2) @ world[:, 1:]
    angles = np.degrees(euler_zxy(local, np.zeros((22, 3))))
    lines, order, offsets = ["HIERARCHY"], [], rig.offsets()

    def write(joint):
        order.append(joint)
        kind = "ROOT" if joint == 0 else "JOINT"
        channels = "6 Xposition Yposition Zposition" if joint == 0 else "3"
        lines.append(f"{kind} {rig.names[joint]}\n{{\nOFFSET {' '.join(f'{x:.6f}' for x in offsets[joint])}")
        lines.append(f"CHANNELS {channels} Zrotation Xrotation Yrotation")
        children = np.flatnonzero(PARENTS[:22] == joint)
        for child in children:
            write(int(child))
        if not len(children):
            lines.append("End Site\n{\nOFFSET 0.05 0 0\n}")
        lines.append("}")

    write(0)
    lines.append(f"MOTION\nFrames: {rig.frames}\nFrame Time: {1 / rig.rate:.6f}")
    for k in range(rig.frames):
        row = [*rig.places[k, 0], *angles[k, order].reshape(-1)]
        lines.append(" ".join(f"{x:.7f}" for x in row))
    path.write_text("\n".join(lines) + "\n")


def test_a_stick_in_a_file_is_read_with_bending_knees_and_flat_feet(tmp_path, within):
    joints, R, at = moving()
    write_stick(
        tmp_path / "stick.bvh", made_rig(joints, R, at, stick_axes(joints, mirrored=True, rolls=(0.3, 2, 1, -1)))
    )
    bvh = open_bvh(tmp_path / "stick.bvh")
    order = [bvh.names.index(exporter_name(JOINTS[k])) for k in range(22)]
    np.testing.assert_allclose(bvh.transforms(np.arange(48))[1][:, order], at, atol=1e-4)
    clip, source = read_bvh(tmp_path / "stick.bvh").read(), builtin_motion("walking").read()
    knees = clip.axis_angle[:, [J["left_knee"], J["right_knee"]]]
    assert knees[..., 0].max() > 0.8 and knees[..., 0].min() > -0.05
    # the tilt of the soles is the source's own
    joints = builtin_body("male").joints
    feet = [J["left_ankle"], J["right_ankle"]]
    mine, theirs = (joint_transforms(c.axis_angle, joints)[:48, feet, :3, 1] for c in (clip, source))
    within(np.degrees(np.arccos(np.clip((mine * theirs).sum(-1), -1, 1))), 6.0, "degrees")


def test_a_real_walk_on_bones_along_x_is_the_walk(data, within):
    """CMU's walk, its limbs re-expressed with bones along x: turns about the bones come from knees and elbows.

    CMU's elbows bend about an axis 30 degrees off the vertical of its T-pose, so upper arms turn by that much.
    """
    source = read_bvh(data / "bvh" / "pybvh_cmu_12_01_walk.bvh").read(1)
    joints = builtin_body("male").joints.astype(np.float64)[:22]
    G = joint_transforms(source.axis_angle, builtin_body("male").joints, source.root)[:, :22]
    axes = stick_axes(joints, mirrored=False, rolls=(0, 0, 0, 0))
    back = retarget(made_rig(joints, G[..., :3, :3], G[..., :3, 3], axes)).read()
    mine = joint_transforms(back.axis_angle, builtin_body("male").joints)[:, :22, :3, :3]
    off = turn_between(G[..., :3, :3], mine)
    within(off[:, [J["pelvis"], J["spine3"], J["head"]]], 1e-3, "degrees")
    legs = [J[f"{side}_{name}"] for side in ("left", "right") for name in ("hip", "knee", "ankle")]
    within(off[:, legs], 6.0, "degrees")
    arms = [J[f"{side}_{name}"] for side in ("left", "right") for name in ("shoulder", "elbow", "wrist")]
    within(off[:, arms], 32.0, "degrees")


def test_a_rig_that_shows_no_sides_is_refused_in_one_line():
    joints, R, at = moving()
    flat = joints * [0, 1, 1]
    places = joint_transforms(np.zeros((4, 52, 3)), np.concatenate([flat, np.zeros((30, 3))]))[:, :22, :3, 3]
    rig = made_rig(flat, np.tile(np.eye(3), (4, 22, 1, 1)), places, np.tile(np.eye(3), (22, 1, 1)))
    with pytest.raises(AssetError, match=r"made\.bvh: hips or hips and head rest at the same place"):
        retarget(rig)


@pytest.fixture(scope="module")
def people(data):
    from synth.subject import read_subject

    return {name: read_subject(data / "characters" / f"{name}_Casual.glb").joints for name in PEOPLE}


@pytest.mark.parametrize("person", PEOPLE)
@pytest.mark.parametrize("file", ["fairmotion_cmu_01_01", "bvhpython_mocapbank", "pymo_AV_8Walk_Meredith"])
def test_bones_of_real_people_point_where_the_files_bones_point(person, file, people, data, within):
    """It was solved for the built-in man's bones: upper arm 7.4, forearm 5.8, thigh 3.9 degrees off on these."""
    bvh = open_bvh(data / "bvh" / f"{file}.bvh")
    _, theirs = bvh.transforms(np.arange(min(bvh.frames, 300)))
    joints = people[person].astype(np.float64)
    clip = read_bvh(bvh.path, RestSkeleton(joints, 0.95)).read(0, len(theirs))
    G = joint_transforms(clip.axis_angle, joints, clip.root)
    own = file == "bvhpython_mocapbank"
    names = {n: n.capitalize() if own else MIXAMO[n] for n in ("hip", "knee", "ankle", "shoulder", "elbow", "wrist")}
    placed = np.zeros((len(theirs), 52, 3))
    for joint in {name for pair in LIMBS for name in pair}:
        side, _, name = joint.partition("_")
        placed[:, J[joint]] = theirs[:, bvh.names.index(side.capitalize() + names[name])]
    within(degrees_between(directions(G[..., :3, 3], LIMBS), directions(placed, LIMBS)), 0.01, "degrees")


@pytest.mark.parametrize("heading", [0.0, 1.0, np.pi / 2])
def test_who_crawls_is_not_stood_up_and_who_walks_in_a_z_up_world_is(heading, within):
    """The rig rests along +y: so is the crawler's world, whose trunk lies along the way."""
    joints, R, at = moving()
    H, Q = (matrix_from_axis_angle(np.array(v)) for v in ([0, heading, 0], [np.pi / 2, 0, 0]))
    walk = retarget(made_rig(joints, Q @ H @ R, at @ (Q @ H).T, np.tile(np.eye(3), (22, 1, 1)))).read()
    within(turn_between(H @ R[:, 0], matrix_from_axis_angle(walk.axis_angle[:, 0])), 1e-4, "degrees")
    pose = np.zeros((52, 3))
    # on hands and knees
    pose[[0, 1, 2, 16, 17]] = np.pi / 2 * np.array([[1.0, 0, 0], [-1, 0, 0], [-1, 0, 0], [0, -1, 0], [0, 1, 0]])
    G = joint_transforms(pose, builtin_body("male").joints)[:22]
    places = G[:, :3, 3] + np.linspace(0, 2, 48)[:, None, None] * np.array([0, 0, 1])
    made = made_rig(joints, np.tile(H @ G[:, :3, :3], (48, 1, 1, 1)), places @ H.T, np.tile(np.eye(3), (22, 1, 1)))
    motion = retarget(made)
    assert any("the body crawls" in note for note in motion.notes)
    within(turn_between(H @ Q, matrix_from_axis_angle(motion.read().axis_angle[:, 0])), 1e-4, "degrees")
