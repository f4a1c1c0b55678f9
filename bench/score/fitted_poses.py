"""Poses of an estimated skeleton in held-out pictures: fitted to each picture, as a user would, without the truth.

Joint angles of a skeleton that was estimated mean other poses than the true one's. So body and head are placed, and
limbs and fingers bent, by what a detector and a mask say of the picture (its camera is known, as calibrated ones are):

1. the body's view: place, heading and 21 joints (capture/fit/picture.py);
2. a hand's close-up: where the hand is, wrist and fingers; the arm follows from the body's view of the same pose;
3. the head's close-up: where the head is;
4. each picture's outline again, now that of what was trained (bench/score/trained_outline.py).

Each picture is then drawn and measured in its own fit; the body's view takes the fingers of the close-ups of its pose.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from avatar.limits import limits
from avatar.rotation import axis_angle_from_matrix, matrix_from_axis_angle
from avatar.skeleton import JOINTS, LEFT_HAND, RIGHT_HAND, joint_transforms
from bench.score.trained_outline import TrainedOutline
from capture.fit import hand, head
from capture.fit.body import CUTS, hand_vertices
from capture.fit.directions import all_turns
from capture.fit.footage import Estimate, Footage, footage_of, unplaced
from capture.fit.outline_term import Outlines
from capture.fit.person import known_person
from capture.fit.picture import ONE_PICTURE, anyhow, fit_pose
from capture.fit.scan import posed_video
from capture.fit.solve import assemble, placed_rigidly, solve
from capture.folder import CaptureSubject
from capture.held_out import HeldOutView
from capture.read.template import TemplateMesh
from command.progress import progress

# degrees: how far each joint of the fingers is bent that a hand's fit begins from
CLOSED = (10.0, 40.0, 70.0)
# a finger's standard deviation is this share of its range
SHARE = 0.3
# relative standard deviation of a focal length that is known
KNOWN = 1e-4
# points of a close-up under which it says nothing, and the body's view stands
FEWEST = 4
FINGERS = {"left": LEFT_HAND, "right": RIGHT_HAND}


class Fitter:
    """Fits the poses of one template, which is a free body's (carved hair and clothes may follow its vertices)."""

    def __init__(self, subject: CaptureSubject):
        self.template = TemplateMesh(subject.rest, subject.faces, subject.skin, subject.joints, "")
        self.person = known_person(self.template)

    def fitted(self, views: Sequence[HeldOutView]) -> dict[str, HeldOutView]:
        """The views of one pose with poses as fitted, by part; `views` holds the body's."""
        by_part = {view.view: view for view in views}
        own = {"body": self._body(by_part["body"])}
        for side, fingers in FINGERS.items():
            view = by_part.get(f"hand_{side}")
            found = None if view is None else self._hand(view, side)
            if view is None or found is None:
                continue
            wrist = JOINTS.index(f"{side}_wrist")
            for fitted in own.values():
                fitted.axis_angle[fingers] = found.axis_angle[fingers]
            axis_angle = own["body"].axis_angle.copy()
            axis_angle[wrist] = found.axis_angle[wrist]
            own[view.view] = self._carried(replace(found, axis_angle=axis_angle), found, f"{side}_elbow")
        view = by_part.get("head")
        found = None if view is None else self._head(view)
        if view is not None and found is not None:
            own["head"] = self._carried(replace(found, axis_angle=own["body"].axis_angle.copy()), found, "head")
        placed = own["body"]
        return {part: own.get(part, replace(view, axis_angle=placed.axis_angle, root=placed.root))
                for part, view in by_part.items()}  # fmt: skip

    def _body(self, view: HeldOutView) -> HeldOutView:
        mask, focal = view.pixels("masks", "L"), float(view.camera.K[0, 0])
        camera, axis_angle, root = fit_pose(self.template, view.keypoints(), mask, focal=focal)
        return in_world(view, camera.camera_from_world, axis_angle, root)

    def _carried(self, posed: HeldOutView, found: HeldOutView, joint: str) -> HeldOutView:
        """The person in a pose, moved so that one joint stands as found."""
        joints, k = self.template.joints, JOINTS.index(joint)
        G = joint_transforms(posed.axis_angle, joints, posed.root)[k]
        T = joint_transforms(found.axis_angle, joints, found.root)[k] @ np.linalg.inv(G)
        return moved(posed, T)

    def _hand(self, view: HeldOutView, side: str) -> HeldOutView | None:
        """The hand of a close-up: its place, the wrist and the fingers; None: too few points of it were found."""
        moving = hand.hand_joints(side)
        footage = self._footage(view, hand.hand_names(side), moving)
        if (footage.sure > 0).sum() < FEWEST:
            return None
        priors, table, tried = anyhow(footage, SHARE), limits(), []
        for closed in CLOSED:
            angles = np.zeros((52, 3))
            angles[moving[1:], 0] = np.radians(closed)
            bent = np.clip(angles, table.low, table.high)
            estimate = hand.first_guess(self.person, np.zeros(0), footage, side, bent)
            tried.append(solve(estimate, footage, priors, cuts=(hand.FIRST, *CUTS), rounds=12))
        estimate = min(tried, key=lambda one: assemble(one, footage, priors, CUTS[-1], ())[1])
        chosen = hand_vertices(self.person, (side,))
        estimate = Outlines(footage).fit(estimate, footage, priors, chosen, hand.WEIGHTS, cut=CUTS[-1])
        return self._placed(view, estimate, footage)

    def _head(self, view: HeldOutView) -> HeldOutView | None:
        """The head of a close-up; None: too few points of it were found."""
        footage = self._footage(view, head.NAMES, np.zeros(0, np.int64))
        if (footage.sure > 0).sum() < FEWEST:
            return None
        # turned every way: heads of people who bow lie aslant, as those of videos never do
        estimate, _ = placed_rigidly(unplaced(self.person, np.zeros(0), footage), footage, head.HEAD, all_turns(),
                                     footage.sure > 0, slack=head.SLACK)  # fmt: skip
        priors = head.turning(estimate, footage)
        priors = replace(priors, bias=ONE_PICTURE * priors.bias)
        estimate = solve(estimate, footage, priors, cuts=(head.FIRST, *CUTS), rounds=10)
        chosen = head.head_vertices(self.person)
        estimate = Outlines(footage).fit(estimate, footage, priors, chosen, head.WEIGHTS, cut=CUTS[-1])
        return self._placed(view, estimate, footage)

    def _footage(self, view: HeldOutView, names: tuple[str, ...], moving: Array) -> Footage:
        mask, focal = view.pixels("masks", "L"), float(view.camera.K[0, 0])
        return footage_of(view.keypoints(), mask[None], names, moving, focal=focal, focal_sigma=KNOWN)

    def _placed(self, view: HeldOutView, estimate: Estimate, footage: Footage) -> HeldOutView:
        video = posed_video(estimate, footage, np.ones(1, bool), level=False)
        assert video.axis_angle is not None and video.root is not None
        return in_world(view, video.cameras[0].camera_from_world, video.axis_angle[0], video.root[0])


def in_world(
    view: HeldOutView, camera_from_fit: Float[Array, "4 4"], axis_angle: Float[Array, "52 3"], root: Float[Array, "3"]
) -> HeldOutView:
    """The view with a pose that was fitted in its camera's own world, in the world of the truth: where the person is
    seen, not where it is."""
    world_from_fit = np.linalg.inv(view.camera.camera_from_world) @ camera_from_fit
    return moved(replace(view, axis_angle=axis_angle, root=root), world_from_fit)


def moved(view: HeldOutView, T: Float[Array, "4 4"]) -> HeldOutView:
    axis_angle = view.axis_angle.copy()
    axis_angle[0] = axis_angle_from_matrix(T[:3, :3] @ matrix_from_axis_angle(axis_angle[0]))
    return replace(view, axis_angle=axis_angle, root=T[:3, :3] @ view.root + T[:3, 3])


def fitted_views(
    subject: CaptureSubject, held_out: Mapping[str, Sequence[HeldOutView]], outlines: TrainedOutline | None = None
) -> dict[str, list[HeldOutView]]:
    """The views of all sets in the same order, in the poses that `subject`, a template, is fitted to them in, and then
    the surface that was trained from it, if there is one."""
    fitter, out = Fitter(subject), {}
    for name, views in held_out.items():
        groups: dict[int, list[HeldOutView]] = {}
        for view in views:
            groups.setdefault(view.pose_index, []).append(view)
        steps = progress(groups.items(), f"fitting {name}", len(groups))
        fitted = {index: fitter.fitted(group) for index, group in steps}
        out[name] = [fitted[view.pose_index][view.view] for view in views]
        if outlines is not None:
            out[name] = [outlines.refined(view) for view in progress(out[name], f"outlines of {name}", len(views))]
    return out
