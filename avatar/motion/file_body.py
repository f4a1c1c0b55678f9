"""Where the pelvis of a pose file's own body rests: J0, which trans is counted from (trans + J0 = pelvis)."""

import numpy as np
from jaxtyping import Float

from avatar.body import Body, shaped

Array = np.ndarray

# J0 of SMPL(+H) bodies of mean shape, good to about 2 cm
USUAL_PELVIS = np.array([-0.002, -0.233, 0.028])
# coefficients of people lie within 5
LARGEST_BETA = 1e3


def given_pelvis(
    betas: Float[Array, "n"], body: Body | None, notes: list[str], *, what: str = "trans + J0"
) -> tuple[Float[Array, "3"], float] | None:
    """J0 and pelvis height of the user's model in the file's shape; None where no model of the user's is given."""
    if body is not None and not body.name.startswith("builtin"):
        used = min(len(betas), body.shape_directions.shape[2])
        own = shaped(body, betas[:used])
        notes.append(f"pelvis: {what} of {body.name} with {used} of the file's {len(betas)} betas")
        return own.origin, float(-own.vertices[:, 1].min())
    if np.any(betas):
        notes.append("betas ignored: they belong to SMPL's shape space, not to the built-in body's")
    return None


def usual_pelvis(notes: list[str], *, what: str = "trans +") -> Float[Array, "3"]:
    """The usual J0, for a file without `--body`."""
    notes.append(
        f"pelvis: {what} {tuple(USUAL_PELVIS.tolist())}, the usual J0 of SMPL+H (2 cm; --body gives it exactly)"
    )
    return USUAL_PELVIS
