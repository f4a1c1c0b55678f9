"""The built-in body in a skirt and with long hair, ways that it goes, and where its loose parts go."""

from dataclasses import replace

import numpy as np

from avatar.baked_avatar import Avatar
from avatar.skeleton import BIG_POSE, joint_transforms
from player.effects.loose_motion import LooseMotion
from player.effects.secondary_motion import SecondaryMotion
from player.scene.mannequin import mannequin

ROWS, ROUND = 14, 48
HEAD = 15


def dressed(*, scale: float = 1.0, skirt: bool = True, hair: bool = True) -> Avatar:
    """scale: of the whole rig."""
    avatar = mannequin("female")
    level = avatar.levels[0]
    at = joint_transforms(np.array(BIG_POSE), avatar.joint_positions.astype(np.float64))[:, :3, 3]
    sheets = [_skirt(at)] * skirt + [_hair(at)] * hair
    fields = {name: [getattr(level, name)] for name in ("positions", "normals", "uv", "joints", "weights")}
    faces, loose, count = [level.faces.astype(np.int64)], [np.zeros(len(level.positions))], len(level.positions)
    for points, shares, own, closed in sheets:
        for side in (1, -1):
            quads = _quads(len(points) // ROWS, closed)[:, ::side] + count
            faces.append(quads)
            normals = np.zeros_like(points)
            local = points[quads - count]
            np.add.at(normals, (quads - count)[:, 0], np.cross(local[:, 1] - local[:, 0], local[:, 2] - local[:, 0]))
            normals += [1e-9, 0, 0]
            fields["positions"].append(points)
            fields["normals"].append(normals / np.linalg.norm(normals, axis=1, keepdims=True))
            fields["uv"].append(np.full((len(points), 2), 0.3))
            joints, weights = shares
            fields["joints"].append(joints)
            fields["weights"].append(weights)
            loose.append(own)
            count += len(points)
    whole = {name: np.concatenate(parts).astype(getattr(level, name).dtype) for name, parts in fields.items()}
    whole["positions"] = whole["positions"] * np.float32(scale)
    q = np.zeros((count, 6), np.float32)
    q[:, [0, 3, 5]] = 1
    dressed = replace(
        level, **whole, faces=np.concatenate(faces).astype(np.uint32), view_dir=-whole["normals"], view_q=q,
        view_seen=np.zeros(count, np.float32), loose=np.concatenate(loose).astype(np.float32),
    )  # fmt: skip
    if not sheets:
        dressed = replace(dressed, loose=None)
    joints = avatar.joint_positions.astype(np.float64) * scale
    return replace(avatar, levels=(dressed,), joint_positions=joints, default_view="off")


def _skirt(at):
    """A bell from the waist to the knees; it moves as pelvis and thighs do."""
    down, angle = np.linspace(0, 1, ROWS), np.linspace(0, 2 * np.pi, ROUND, endpoint=False)
    knee = 0.5 * (at[4, 1] + at[5, 1])
    across = 0.17 + (abs(at[4, 0]) + 0.12 - 0.17) * down
    deep = 0.15 + 0.12 * down
    points = np.stack(
        [across[:, None] * np.cos(angle), np.tile((0.08 + (knee - 0.08) * down)[:, None], ROUND),
         deep[:, None] * np.sin(angle)], -1,
    ).reshape(-1, 3)  # fmt: skip
    left = 1 / (1 + np.exp(-points[:, 0] / 0.06))
    leg = np.repeat(np.clip(1.3 * down, 0, 0.9), ROUND)
    return points, _bytes(np.stack([1 - leg, leg * left, leg * (1 - left)], 1), (0, 1, 2)), _rows(down, ROUND), True


def _hair(at):
    """A sheet that falls from the back of the head to between the shoulder blades; it moves as the head does."""
    down, across = np.linspace(0, 1, ROWS), np.linspace(-1, 1, 20)
    head = at[HEAD]
    wide = 0.08 + 0.06 * down
    points = np.stack(
        [head[0] + wide[:, None] * across, np.tile((head[1] + 0.12 - 0.45 * down)[:, None], 20),
         head[2] - 0.13 - 0.08 * np.sin(2 * down)[:, None] + 0.05 * across**2], -1,
    ).reshape(-1, 3)  # fmt: skip
    return points, _bytes(np.ones((len(points), 1)), (HEAD,)), _rows(down, 20), False


def _rows(down, columns):
    share = np.clip((down - 0.15) / 0.85, 0, 1)
    return np.repeat(share, columns)


def _bytes(shares, joints):
    whole = np.floor(shares * 255 + 1e-6).astype(int)
    whole[np.arange(len(whole)), whole.argmax(1)] += 255 - whole.sum(1)
    weights = np.zeros((len(shares), 4), int)
    weights[:, : shares.shape[1]] = whole
    named = np.zeros((len(shares), 4), int)
    named[:, : shares.shape[1]] = joints
    return np.where(weights > 0, named, 0), weights


def _quads(columns, closed):
    out = []
    for row in range(ROWS - 1):
        for column in range(columns if closed else columns - 1):
            a, b = row * columns + column, row * columns + (column + 1) % columns
            out += [[a, b, a + columns], [b, b + columns, a + columns]]
    return np.array(out)


SETTINGS = SecondaryMotion()


def dance(seconds: float) -> tuple[np.ndarray, np.ndarray]:
    """A pose of a wild dance: turns of the whole body, steps, swinging arms and a nodding head; smooth in time."""
    pose, w = np.zeros((52, 3)), 2 * np.pi * seconds
    pose[0, 1] = 1.6 * np.sin(0.5 * w)
    pose[1, 0], pose[2, 0] = -0.5 - 0.5 * np.sin(0.9 * w), -0.5 + 0.5 * np.sin(0.9 * w)
    pose[4, 0], pose[5, 0] = 0.5 + 0.5 * np.sin(0.9 * w), 0.5 - 0.5 * np.sin(0.9 * w)
    pose[6] = [0.2 * np.sin(0.7 * w), 0.3 * np.sin(0.6 * w), 0.15 * np.sin(0.8 * w)]
    pose[15] = [0.3 * np.sin(1.1 * w), 0.7 * np.sin(0.8 * w), 0.2 * np.sin(0.5 * w)]
    pose[16], pose[17] = [0, 0.6 * np.sin(0.9 * w), -1.0 + 0.4 * np.sin(w)], [0, 0.6 * np.sin(0.9 * w), 1.0]
    pose[18, 1], pose[19, 1] = -0.8 + 0.6 * np.sin(1.2 * w), 0.8 + 0.6 * np.sin(w)
    root = np.array([0.4 * np.sin(0.4 * w), 0.9 + 0.08 * np.sin(1.8 * w), 0.3 * np.sin(0.3 * w)])
    return pose, root


def gently(seconds: float) -> tuple[np.ndarray, np.ndarray]:
    """The dance with joints turned a third as far."""
    axis_angle, root = dance(seconds)
    return 0.3 * axis_angle, root


def danced(renderer, seconds=0.7):
    """The renderer told of a dance; its last pose."""
    for frame in range(int(60 * seconds) + 1):
        renderer.move([dance(frame / 60)], frame / 60)
    return dance(int(60 * seconds) / 60)


def moved(parts, rate, seconds, pose_at, settings=SETTINGS):
    """The motion after so many seconds, and the offsets 30 times a second."""
    motion, offsets = LooseMotion(parts, settings), []
    for frame in range(round(seconds * rate) + 1):
        motion.move(pose_at(frame / rate), frame / rate)
        if frame % round(rate / 30) == 0:
            offsets.append(motion.offsets)
    return motion, np.array(offsets)
