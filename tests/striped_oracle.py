"""A small capture with truth: the built-in body in stripes, two novel poses and a T-pose, and its oracle avatar."""

import json

import numpy as np
import pytest
from painted_capture import free_subject

import bench.score.posed_geometry
import synth.truth
import synth.visibility
from avatar.body import builtin_body
from avatar.gltf.avatar_file import Avatar, Level, write_avatar
from avatar.skeleton import BIG_POSE, JOINTS, skin_transforms
from avatar.skinning import SkinWeights, skin_points
from capture.folder import write_subject
from capture.read.template import part_of
from player.draw.raster import Rasteriser
from player.gl.context import open_context
from synth.light import light_of
from synth.photo import Studio
from synth.raw.detector import Mistakes
from synth.subject import SynthSubject
from synth.truth import DetectorOf, take_set, write_rest
from synth.visibility import visible_faces


def byte_weights(skin):
    """Weights as bytes whose rows sum to 255."""
    rows = np.floor(skin.weights * 255).astype(int)
    rows[np.arange(len(rows)), skin.weights.argmax(1)] += 255 - rows.sum(1)
    return rows.astype(np.uint8)


def striped_subject():
    body = builtin_body("male")
    corner = body.faces.ravel()
    uv = body.uv[body.uv_faces.ravel()]
    rows, columns = np.indices((256, 256))
    texture = np.stack([60 + 120 * (rows // 8 % 2), 90 + 100 * (columns // 8 % 2), 0 * rows + 140], -1)
    return SynthSubject(
        name="striped",
        vertices=body.vertices[corner].astype(np.float32),
        faces=np.arange(len(corner)).reshape(-1, 3),
        uv=uv.astype(np.float32),
        material=np.zeros(len(body.faces), np.int64),
        textures=(texture.astype(np.uint8),),
        alpha=(None,),
        skin=SkinWeights(body.skin.joints[corner], body.skin.weights[corner]),
        joints=body.joints,
        part=part_of(body.skin)[corner],
        hair=np.zeros(len(corner), bool),
        licence="CC0-1.0",
    )


def oracle_avatar(subject):
    """The subject's own mesh and texture as an avatar: what a perfect learner would bake."""
    transforms = skin_transforms(BIG_POSE, subject.joints, subject.joints[0], rest=np.zeros((52, 3)))
    canonical = skin_points(subject.vertices, subject.skin, transforms).astype(np.float32)
    count = len(canonical)
    out = np.tile(np.array([0, 0, 1], np.float32), (count, 1))
    joints = np.where(byte_weights(subject.skin) > 0, subject.skin.joints, 0).astype(np.uint8)
    level = Level(
        positions=canonical,
        normals=out,
        uv=subject.uv,
        faces=subject.faces.astype(np.uint32),
        joints=joints,
        weights=byte_weights(subject.skin),
        view_dir=-out,
        view_q=np.tile(np.array([1, 0, 0, 1, 0, 0], np.float32), (count, 1)),
        view_seen=np.zeros(count, np.float32),
        base_color=subject.textures[0],
        features=None,
    )
    facts = {"baked": {"against_field": {"paper_db": 40.0}}}
    return Avatar("striped", subject.joints, BIG_POSE, (level,), None, None, 0.6, "off", facts)


@pytest.fixture(scope="session", autouse=True)
def small_pictures():
    """Held-out pictures of 224 px, and fewer, smaller views to find visible faces by."""
    with pytest.MonkeyPatch.context() as small:
        small.setattr(synth.truth, "SIZE", 224)
        small.setattr(synth.truth, "CANDIDATES", 2)
        small.setattr(synth.visibility, "VIEWS", 20)
        small.setattr(synth.visibility, "VIEW_SIZE", 512)
        samples = {"total": 1500, "head": 500, "left_hand": 400, "right_hand": 400}
        small.setattr(bench.score.posed_geometry, "SAMPLES", samples)
        yield


@pytest.fixture(scope="session")
def oracle(made_once, small_pictures):
    """(capture folder, oracle avatar file, subject); only to read."""
    folder = made_once("oracle", film_oracle)
    return folder / "capture", folder / "oracle.glb", striped_subject()


def film_oracle(folder):
    """Writes the capture with its truth and the avatar."""
    subject = striped_subject()
    capture = folder / "capture"
    capture.mkdir(parents=True)
    facts = {"format": "selfscan-capture", "version": 1, "subject": "striped", "light": "even", "seed": 0}
    (capture / "capture.json").write_text(json.dumps(facts))
    # the body itself as a perfectly registered template
    write_subject(capture / "subject.npz", free_subject("male"))
    context = open_context()
    raster = Rasteriser(context)
    studio = Studio(raster, subject, supersample=2)
    bent = np.zeros((52, 3))
    bent[JOINTS.index("left_elbow")] = 0, -1.2, 0
    bent[JOINTS.index("left_index1")] = 0, 0, -0.8
    bent[JOINTS.index("right_shoulder")] = 0, 0, 0.9
    turned = np.zeros((52, 3))
    turned[0] = 0, 0.7, 0
    light = light_of("even", "body", 0)
    write_rest(capture / "truth", subject, visible_faces(raster, subject.vertices, subject.faces))
    poses = [(bent, np.array([0.1, 0.9, 0.0])), (np.zeros((52, 3)), np.zeros(3))]
    sets = {"novel_pose": poses, "novel_view": [(turned, np.zeros(3))]}
    for name, stands in sets.items():
        looks = DetectorOf(Mistakes(2.0, 0.0, clumsy=False), 0)
        list(take_set(studio, stands, capture / "truth" / name, light, seed=1, looks=looks))
    raster.release()
    context.release()
    write_avatar(folder / "oracle.glb", oracle_avatar(subject))
