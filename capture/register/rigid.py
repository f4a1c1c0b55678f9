"""The head is rigid: its field is learned from a video under one rigid motion a frame (TotalSelfScan, Eq. 4)."""

from dataclasses import replace

import numpy as np

from avatar.skeleton import JOINTS, PARTS
from avatar.skinning import dense_weights, strongest_four
from capture.folder import CaptureSubject
from capture.template.parts import part_boxes

HEAD = JOINTS.index("head")


def with_rigid_head(subject: CaptureSubject) -> CaptureSubject:
    """The template whose vertices follow only the head bone where only the head's field has a weight (Eq. 9).

    A body model's weights bend the jaw and the back of the head with the neck by a tenth or more; the head's
    video, seen as rigid, contradicts that. Over the upper half of the overlap (Eq. 9) the weights blend.
    """
    head = part_boxes(subject)[PARTS.index("head")]
    share = head.weight(subject.vertices)
    follows = np.clip(2 * share - 1, 0, 1)[:, None]
    weights = dense_weights(subject.skin)
    weights = weights * (1 - follows)
    weights[:, HEAD] += follows[:, 0]
    return replace(subject, skin=strongest_four(weights))
