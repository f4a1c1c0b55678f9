"""The program without effects draws what the bare scene draws, with the same calls."""

from dataclasses import replace

import numpy as np

from avatar.camera import orbit_camera
from avatar.motion.read import builtin_motion
from experiments.bare_program import BareProgram
from player.scene.effects import PLAIN, STUDIO
from player.scene.mannequin import mannequin
from player.scene.renderer import Renderer


def test_the_program_without_effects_draws_the_bare_scenes_picture(context):
    """Else the time beside it would say nothing."""
    avatar, size = mannequin(), (160, 120)
    camera = orbit_camera(avatar.joint_positions.mean(0), 2.6, 0.4, 0.1, size)
    clip = builtin_motion("walking").read(20, 21)
    pose = clip.axis_angle[0].astype(np.float64), np.zeros(3)
    renderer = Renderer(context, [avatar], size, effects=replace(PLAIN, view="off"), background=STUDIO)
    expected = renderer.draw([pose], camera)
    program = BareProgram(context, avatar, size, STUDIO.color)
    program.draw(pose, camera)
    assert np.array_equal(program.picture(), expected) and len(np.unique(expected)) > 50
    program.release()
    renderer.release()


def test_the_bare_scene_makes_the_calls_of_the_program_and_no_more(context):
    avatar, size = mannequin(), (96, 96)
    camera = orbit_camera(avatar.joint_positions.mean(0), 2.6, 0.4, 0.1, size)
    poses = [(np.full((52, 3), 0.01 * k), np.zeros(3)) for k in range(4)]
    renderer = Renderer(context, [avatar], size, effects=replace(PLAIN, view="off"), background=STUDIO)
    program = BareProgram(context, avatar, size, STUDIO.color)
    target, calls = renderer.target, []
    for draw in (lambda pose: renderer.draw_into(target, [pose], camera), lambda pose: program.draw(pose, camera)):
        draw(poses[0])
        before, sent, objects = context.counts.calls.copy(), context.counts.uploaded, context.counts.objects()
        for pose in poses[1:]:
            draw(pose)
        assert context.counts.objects() == objects
        calls.append((context.counts.calls - before, context.counts.uploaded - sent))
    assert calls[0] == calls[1] and calls[0][0]["draw"] == 3
    program.release()
    renderer.release()
