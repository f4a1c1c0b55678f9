"""What the hands of a motion should be: the file's, flat, relaxed, or the mean pose of the user's own model."""

from dataclasses import replace

import numpy as np
from numpy import ndarray as Array

from avatar.body import Body
from avatar.motion.clip import Motion
from avatar.motion.fingers import relaxed_hands
from command.errors import AssetError

HANDS = ("file", "flat", "relaxed", "mean")


def with_hands(motion: Motion, choice: str, body: Body | None = None) -> Motion:
    """The motion with its hands replaced, and a note that says so; "file" leaves it as it is.

    flat     straight fingers, the zero pose
    relaxed  fingers slightly bent, the same for every body
    mean     MANO's mean hands (`hands_mean` of the body): what AMASS holds where no fingers were captured

    Raises:
        ValueError: an unknown choice.
        AssetError: "mean" without a model that has hands.
    """
    if choice not in HANDS:
        raise ValueError(f"hands should be one of {', '.join(HANDS)}, is {choice!r}")
    if choice == "file":
        return motion
    if choice != "mean":
        hands, name = relaxed_hands() if choice == "relaxed" else np.zeros((30, 3)), choice
    elif body is not None and body.hands is not None:
        hands, name = body.hands.mean.reshape(30, 3), f"the mean of {body.name}"
    else:
        found = "no model" if body is None else f"{body.name} without them"
        expected = "your SMPL+H model with hands_meanl and hands_meanr, given with --body"
        raise AssetError(f"--hands mean: expected {expected}, found {found}")

    def change(axis_angle: Array, root: Array) -> tuple[Array, Array]:
        axis_angle = axis_angle.copy()
        axis_angle[:, 22:] = hands
        return axis_angle, root

    kept = replace(motion, notes=tuple(n for n in motion.notes if not n.startswith("hands:")))
    return kept.changed(f"hands: {name}, in place of the file's", change)
