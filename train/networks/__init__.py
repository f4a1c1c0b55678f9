"""The networks of a part, Eq. 1-4: a geometry, a colour and a displacement network for each preset.

Every file here has a frozen record of sizes and `build`, which makes the three networks and the appearance codes.
All take points in the part's unit box, [-1, 1] in each axis (`PartField.unit`):

    geometry(unit)                                        -> signed distance in metres (n,), feature (n, z)
    color(unit, feature, normals, directions, code)       -> sRGB in [0, 1]
    displacement(unit, frame)                             -> T_nr in metres

A geometry with `over_template` gives the distance's correction of the template's, not the distance itself.
"""

from typing import NamedTuple

from torch import nn

from train.deform import Displacement


class PartNetworks(NamedTuple):
    """What a part is composed of."""

    geometry: nn.Module  # F_s, Eq. 1
    appearance: nn.Embedding  # l_i, one row per frame
    color: nn.Module  # F_c, Eq. 2
    # T_nr, Eq. 3 and 4
    displacement: Displacement


def frame_codes(frames: int, size: int) -> nn.Embedding:
    """Codes l_i or phi_i, one row per frame, near zero."""
    codes = nn.Embedding(frames, size)
    nn.init.normal_(codes.weight, std=0.1)
    return codes
