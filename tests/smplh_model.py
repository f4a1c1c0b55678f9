"""The free body with the fields and types of an official SMPL+H model, hands included."""

from pathlib import Path

import numpy as np

from avatar.body import Body, builtin_body, read_body
from avatar.skeleton import PARENTS
from avatar.skinning import dense_weights

J0 = np.array([0.01, -0.24, 0.03])  # where the model puts its pelvis


def model_fields(*, hands: bool = True, components: int = 45) -> dict:
    """Fields of a model file; the shape moves the pelvis too."""
    body = builtin_body("male")
    count = len(body.vertices)
    rng = np.random.default_rng(0)
    shapes = body.shape_directions[:, :, :2] + [[[0.003], [0.002], [-0.004]]]
    nearest = ((body.vertices[None] - body.joints[:, None]) ** 2).sum(-1).argmin(1)
    regressor = np.zeros((52, count))
    regressor[np.arange(52), nearest] = 1
    fields = {
        "v_template": (body.vertices + J0).astype("f4"),
        "f": body.faces.astype("u4"),
        "weights": dense_weights(body.skin),
        "shapedirs": shapes,
        "kintree_table": np.array([np.where(PARENTS < 0, 4294967295, PARENTS), np.arange(52)], "u4"),
        "J": body.joints + J0,
        "J_regressor": regressor,
        "bs_style": "lbs",
    }
    if hands:
        fields |= {f"hands_mean{side}": 0.3 * rng.normal(size=45) for side in "lr"}
        fields |= {f"hands_components{side}": rng.normal(size=(components, 45)) for side in "lr"}
    return fields


def write_model(path: Path, change: dict | None = None, **options) -> Path:
    """The model as a file; `change` replaces fields, and takes away those that are None."""
    fields = model_fields(**options) | (change or {})
    np.savez(path, **{name: value for name, value in fields.items() if value is not None})
    return path


def model_body(folder: Path, **options) -> Body:
    """The same, written and read back."""
    return read_body(write_model(folder / "model.npz", **options))
