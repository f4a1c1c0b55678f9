"""Poses learned with the field: what is left of pose errors after alignment (capture/fit/align.py) is taken out
by gradients.

Section ends of a video's rays are canonical and cached, so a correction of a frame's pose has to move them there. With
small turns d_j of the joints (R_j exp d_j) and a shift s of the root, a point x that follows bone k moves, to first
order and in the canonical frame of that bone, by the twist

    -(w x x + v),   w = sum over j above k of a_jk,   v = R_k^T s - sum over j above k of a_jk x p_jk

with a_jk = R_k^T G_j d_j and p_jk = B_k^-1 p_j (G_j turn and p_j place of joint j in the world, B_k
posed_from_canonical of bone k, R_k its turn). Twists are linear in the increments, and their matrices are fixed: a step
costs one small product per frame and four blended twists per point, as skin weights blend bones.

The corrections of all frames have mean zero. A turn that is the same in every frame is not seen in any: the field would
turn against it, and the person would stand askew on its own skeleton.
"""

from dataclasses import replace

import numpy as np
import torch
from jaxtyping import Float, Int
from numpy import ndarray as Array
from torch import Tensor, nn

from avatar.kinematics import DESCENDS, turned
from avatar.rotation import axis_angle_from_matrix, matrix_from_axis_angle
from avatar.skeleton import joint_transforms, skin_transforms
from capture.fit.align import metres_of_a_pixel, moving_joints
from capture.folder import CaptureSubject, PartVideo

# degrees, and SPREAD centimetres of the root: standard deviation of what alignment leaves
SPREAD = 1.0


class PoseCorrection(nn.Module):
    """Increments of every frame's moving joints and root, learned by the losses of the field."""

    # (w, v) of each bone's points for unit increments
    twists: Float[Tensor, "frames bones 6 p"]
    moving: Int[Tensor, "m"]

    def __init__(self, video: PartVideo, subject: CaptureSubject):
        super().__init__()
        assert video.axis_angle is not None and video.root is not None
        moving = moving_joints(subject, video)
        twists = np.stack([
            frame_twists(a, root, subject.joints, moving) for a, root in zip(video.axis_angle, video.root)
        ])  # fmt: skip
        self.pixel = metres_of_a_pixel(video)
        self.register_buffer("twists", torch.as_tensor(twists, dtype=torch.float32), persistent=False)
        self.register_buffer("moving", torch.as_tensor(moving), persistent=False)
        self.increments = nn.Parameter(torch.zeros(len(twists), 3 * len(moving) + 3))

    def centred(self) -> Float[Tensor, "frames p"]:
        """The increments, less their mean over the frames: radians, last three metres."""
        return self.increments - self.increments.mean(0)

    def forward(
        self, points: Float[Tensor, "b e 3"], frame: Int[Tensor, "b"], joints: Int[Tensor, "b e 4"],
        weights: Float[Tensor, "b e 4"],
    ) -> Float[Tensor, "b e 3"]:  # fmt: skip
        """Canonical points of rays, where their frames' corrected poses put them."""
        each = torch.einsum("fkip,fp->fki", self.twists, self.centred())
        twist = (weights[..., None] * each[frame[:, None, None], joints]).sum(2)
        return points - torch.linalg.cross(twist[..., :3], points) - twist[..., 3:]

    def prior(self) -> Float[Tensor, ""]:
        """Mean square of the increments, counted in their standard deviations."""
        spread = self.increments.new_full(self.increments.shape[1:], np.radians(SPREAD))
        spread[-3:] = 0.01 * SPREAD
        return (self.centred() / spread).square().mean()

    @torch.no_grad()
    def corrected(self, video: PartVideo) -> PartVideo:
        assert video.axis_angle is not None and video.root is not None
        d, moving = self.centred().cpu().numpy().astype(np.float64), self.moving.cpu().numpy()
        R = matrix_from_axis_angle(video.axis_angle)
        R[:, moving] = turned(R[:, moving], d[:, :-3].reshape(len(d), -1, 3))
        return replace(video, axis_angle=axis_angle_from_matrix(R), root=video.root + d[:, -3:])

    @torch.no_grad()
    def moved(
        self, ends: Float[Tensor, "rays e 3"], frame: Int[Tensor, "rays"], row: Int[Tensor, "rays e"],
        joints: Int[Tensor, "samples 4"], weights: Float[Tensor, "samples 4"],
    ) -> Float[Tensor, "rays e 3"]:  # fmt: skip
        """The cached section ends of a whole video under the poses that were learned."""
        pieces = [
            self(e, f, joints[r], weights[r]) for e, f, r in zip(ends.split(4096), frame.split(4096), row.split(4096))
        ]
        return torch.cat(pieces)

    @torch.no_grad()
    def degrees(self) -> float:
        """Root mean square of the turns learned, degrees about an axis."""
        return float(np.degrees(self.centred()[:, :-3].square().mean().sqrt().item()))


def frame_twists(
    axis_angle: Float[Array, "52 3"], root: Float[Array, "3"], joints: Float[Array, "52 3"], moving: Int[Array, "m"]
) -> Float[Array, "52 6 p"]:  # fmt: skip
    """Of one pose: (w, v) of every bone for unit increments of the moving joints and of the root."""
    B, G = skin_transforms(axis_angle, joints, root), joint_transforms(axis_angle, joints, root)
    m = len(moving)
    into = np.swapaxes(B[:, :3, :3], 1, 2)  # R_k^T
    axes = np.einsum("kab,mbc->kmac", into, G[moving, :3, :3]) * DESCENDS[:, moving][:, :, None, None]
    places = np.einsum("kab,kmb->kma", into, G[moving][:, :3, 3] - B[:, None, :3, 3])
    out = np.zeros((52, 6, 3 * m + 3))
    out[:, :3, :-3] = axes.transpose(0, 2, 1, 3).reshape(52, 3, -1)
    # k m c a: -(a x p) for each column of a
    moments = -np.cross(np.swapaxes(axes, 2, 3), places[:, :, None])
    out[:, 3:, :-3] = moments.transpose(0, 3, 1, 2).reshape(52, 3, -1)
    out[:, 3:, -3:] = into
    return out
