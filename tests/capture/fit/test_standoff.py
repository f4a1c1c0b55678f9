"""Outlines draw no vertex farther than clothes that lie close, or short hair, stand off."""

from dataclasses import replace

import numpy as np
from turning_twin import in_clothes, turning_twin

from capture.fit.offsets import dressed
from capture.fit.outline_term import Outlines
from capture.fit.points import body_points
from capture.fit.standoff import LIMBS, SCALP, body_standoff, scalp_standoff
from capture.keypoints.record import FACE
from geometry.mesh import vertex_normals


def test_outlines_move_no_point_of_the_face_and_no_hand_or_neck_by_the_bodys_video():
    points = body_points()
    face = [vertex for name in (*FACE, "left_ear", "right_ear") for vertex in points[name].vertices if name in points]
    assert (scalp_standoff()[face] == 0).all() and (body_standoff()[face] == 0).all()
    assert scalp_standoff().max() == SCALP and (scalp_standoff() > 0).sum() > 200
    tips = [vertex for name, point in points.items() if name.endswith("_tip") for vertex in point.vertices]
    assert (body_standoff()[tips] == 0).all()


def test_a_wide_skirt_is_not_filled_by_the_legs():
    truth, footage = turning_twin(6, 200, seed=1)
    vertices = truth.person.vertices(truth.g)
    normals = vertex_normals(vertices, truth.person.body.faces)
    # 15 cm off the thighs, all round, nothing elsewhere
    thighs = (vertices[:, 1] < -0.12) & (vertices[:, 1] > -0.45) & (np.abs(vertices[:, 0]) < 0.35)
    footage = in_clothes(truth, footage, np.where(thighs, 0.15, 0.0))
    bare = replace(truth, person=truth.person.with_offsets(0 * normals))

    def found(standoff):
        every = np.ones(len(normals), bool) if standoff is None else standoff > 0
        offsets = dressed(bare, footage, Outlines(footage, standoff), every).person.offsets
        return np.abs((offsets * normals).sum(1))

    own, free = found(body_standoff()), found(None)
    assert own[thighs].max() <= LIMBS + 1e-9 and np.median(own[thighs]) < 0.015
    assert np.median(free[thighs]) > 1.5 * np.median(own[thighs])
