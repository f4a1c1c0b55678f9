"""What a frame shows beyond the base color because of where it was seen from, so that textures hold the base alone.

The base color is the surface at its global view direction (Eq. 14); a shine that follows the eye is the view
network's. Left in the pixels it would be averaged into the texture, and the grid of pixels would show where frames
disagree.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from bake.cone import clamped_tangent, cone_direction
from bake.field import NumpyField
from bake.level import Charted, lifted

Array = np.ndarray


class ViewChange(NamedTuple):
    """The field's change of color with direction, at the vertices of a level."""

    field: NumpyField
    points: Float[Array, "corners 3"]  # canonical, on the zero set
    charted: Charted
    base: Float[Array, "corners 3"]  # sRGB at the global direction

    def seen_along(self, directions: Float[Array, "corners 3"]) -> Float[Array, "corners 3"]:
        """Color along unit canonical directions (away from the camera), pulled into the cone, less the base; sRGB."""
        cone = self.charted.cone
        along = cone_direction(clamped_tangent(directions, cone), cone)
        return self.field.color(self.points, along) - self.base


def view_change(field: NumpyField, charted: Charted) -> ViewChange:
    """The change of color at a level's vertices."""
    points, _ = lifted(field, charted.points, charted.normals)
    return ViewChange(field, points, charted, field.color(points, charted.cone.direction))
