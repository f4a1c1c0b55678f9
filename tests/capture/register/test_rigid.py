"""The head of the template follows only the head bone where only its field has a weight (Eq. 4)."""

import numpy as np
import pytest
import torch

from avatar.skinning import dense_weights
from capture.folder import read_capture
from capture.template.parts import HEAD, part_boxes, with_rigid_head
from train.fused import part_weight


@pytest.fixture(scope="module")
def subject(tiny_capture):
    return read_capture(tiny_capture).subject


def test_the_head_is_rigid_where_only_it_has_a_weight_and_nothing_changes_below_the_overlap(subject):
    share = part_weight(torch.as_tensor(subject.vertices), part_boxes(subject)[1]).numpy()
    before, after = dense_weights(subject.skin), dense_weights(with_rigid_head(subject).skin)
    alone, below = share == 1, share <= 0.5
    assert alone.sum() > 100 and below.sum() > 100
    assert np.abs(after[alone, HEAD] - 1).max() < 1e-6
    np.testing.assert_allclose(after[below], before[below], atol=1e-6)
    np.testing.assert_allclose(after.sum(1), 1, atol=1e-6)
    assert (before[alone, HEAD] < 0.99).any()  # the body model's own weights bend it
