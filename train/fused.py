"""The whole person as one field: four parts, fused in space (TotalSelfScan, 3.3)."""

import copy
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from typing import Generic, TypeVar

import torch
from jaxtyping import Float
from torch import Tensor, nn

from capture.template.parts import Part
from geometry.isosurface import Detail
from train.eye_grid import OpenEyes
from train.field import FieldSample, PartField, unit_normals
from train.light import SeenLight

Points = TypeVar("Points")


@dataclass(frozen=True)
class CanonicalField(Generic[Points]):
    """A person as functions of canonical points (n, 3), metres: of torch in float32, or of NumPy (bake/field.py)."""

    # (n,), signed, metres
    distance: Callable[[Points], Points]
    # (n, 3), unit
    normal: Callable[[Points], Points]
    # (n, 3), sRGB of points seen along unit directions, from the camera to the point
    color: Callable[[Points, Points], Points]
    # (n, 2), mean S and H in that color, of points with their normals; None: light is no factor of its own
    seen_light: Callable[[Points, Points], Points] | None = None
    # (n, 3), the normals that this light fell on; None as well
    light_normal: Callable[[Points], Points] | None = None
    # where the surface has smaller features than a part's cells: the eyes
    details: tuple[Detail, ...] = ()


class FusedField(nn.Module):
    """F(x + mean over frames of T_nr(x, code)), distance and color blended with Eq. 9's weights.

    Everything is canonical, metres, float32. `head_from_canonical` is the correction of Eq. 5, a similarity: the head
    field lives where the landmarks (Eq. 6) put it; points, directions, normals and distances are moved there and back
    inside. Colors use each part's reference code. A person of one field (a single network) has weight 1 everywhere.

    Round the eyes the head's distance may be the template's (`eyes`, train/eye_grid.py).
    """

    head_from_canonical: Float[Tensor, "4 4"]

    def __init__(self, fields: Sequence[PartField], parts: Sequence[Part], head_from_canonical: Float[Tensor, "4 4"]):
        super().__init__()
        self.fields = nn.ModuleList(fields)
        self.parts = tuple(parts[: len(fields)])
        # None: the field's own distance everywhere
        self.eyes: OpenEyes | None = None
        # each part's video's, where the parts' colors are albedo; None: they are what was shown
        self.seen: tuple[SeenLight, ...] | None = None
        self.register_buffer("head_from_canonical", head_from_canonical.float())

    def functions(self) -> CanonicalField[Tensor]:
        """The person's functions alone, as baking takes them."""
        factor = self.seen is not None
        return CanonicalField(
            self.distance, self.normal, self.color, self.seen_light if factor else None,
            self.light_normal if factor else None, self.details(),
        )  # fmt: skip

    def with_templates(self, names: Collection[str]) -> "FusedField":
        """The person with these parts' surfaces as they were before anything was learned; networks are shared."""
        fields = []
        for index, part in enumerate(self.parts):
            field = copy.copy(self.field(index))
            field.keeps_template |= part.name in names
            fields.append(field)
        other = FusedField(fields, self.parts, self.head_from_canonical)
        other.eyes, other.seen = self.eyes, self.seen
        return other.eval().requires_grad_(False)

    def field(self, index: int) -> PartField:
        """The field of part `index`, in its own frame."""
        field = self.fields[index]
        assert isinstance(field, PartField)
        return field

    def shares(self, points: Float[Tensor, "n 3"]) -> Float[Tensor, "n p"]:
        """Eq. 9: weight of each part at canonical points; rows sum to 1."""
        return eq9_shares(points, self.parts)

    def blend(
        self, shares: Callable[[Tensor], Tensor], of_part: Callable[..., Tensor], *columns: Tensor,
        width: tuple[int, ...] = (3,), most: int = 32768,
    ) -> Tensor:  # fmt: skip
        """The sum over the parts of their shares times of_part(index, *columns), asked where a part has a share.

        The first of the columns are canonical points, `most` of which are asked at once; `width` is the values' shape.
        """
        out = []
        for piece in zip(*(column.split(most) for column in columns)):
            weights = shares(piece[0])
            total = piece[0].new_zeros(len(piece[0]), *width)
            for index in range(len(self.fields)):
                chosen = weights[:, index] > 0
                if chosen.any():
                    own = weights[chosen, index].view(-1, *(1 for _ in width))
                    values = of_part(index, *(column[chosen] for column in piece))
                    total = total.index_put((chosen,), own * values, True)
            out.append(total)
        return torch.cat(out)

    @torch.no_grad()
    def distance(self, points: Float[Tensor, "n 3"]) -> Float[Tensor, "n"]:
        """Signed distance, metres."""
        return self.blend(self.shares, self.part_distance, points, width=(), most=65536)

    def normal(self, points: Float[Tensor, "n 3"]) -> Float[Tensor, "n 3"]:
        """Unit gradient of the distance: the parts' gradients blended with Eq. 9's weights."""
        return unit_normals(self.blend(self.shares, lambda index, at: self.part_gradient(index, at)[1], points))

    def light_normal(self, points: Float[Tensor, "n 3"]) -> Float[Tensor, "n 3"]:
        """Unit normals that light falls on (PartField.light_normal), blended with Eq. 9's weights."""
        lit = lambda index, at: self._lit_at(index, at, self.part_gradient(index, at)[1])
        return unit_normals(self.blend(self.shares, lit, points))

    def _lit_at(self, index: int, points: Tensor, gradient: Tensor) -> Tensor:
        """PartField.light_normal of one part, the gradient of its F_s given; canonical."""
        with torch.no_grad():
            local, R = self.local(index, points)
            if R is None:
                return self.field(index).light_normal(local, gradient)
            return self.field(index).light_normal(local, gradient @ R.T) @ R

    def albedo(self, points: Float[Tensor, "n 3"], directions: Float[Tensor, "n 3"]) -> Float[Tensor, "n 3"]:
        """Color without its light, where that is a factor of its own, else `color`."""
        return self.blend(self.shares, self.part_color, points, directions)

    def seen_light(self, points: Float[Tensor, "n 3"], normals: Float[Tensor, "n 3"]) -> Float[Tensor, "n 2"]:
        """Mean S and H that surface points with these normals were seen under, where light is a factor of its own."""
        assert self.seen is not None
        each = torch.stack([one.at(normals) for one in self.seen], 1)
        return (self.shares(points)[:, :, None] * each).sum(1)

    def color(self, points: Float[Tensor, "n 3"], directions: Float[Tensor, "n 3"]) -> Float[Tensor, "n 3"]:
        """sRGB in [0, 1] of canonical points seen along unit directions (from the camera to the point).

        Where light is a factor of its own it is the mean of what the parts' videos saw (train/light.py).
        """
        return self.blend(self.shares, self.part_shown, points, directions)

    def part_distance(self, index: int, points: Float[Tensor, "n 3"]) -> Float[Tensor, "n"]:
        """Signed distance of one part, without the others, metres, at canonical points."""
        local, _ = self.local(index, points)
        distance = self.field(index)(local).distance / self.scale(index)
        if self.eyes is not None and self.parts[index].name == "head":
            distance = self.eyes.distance(points, distance)
        return distance

    def details(self) -> tuple[Detail, ...]:
        """Where the surface has smaller features than the parts' cells, canonical."""
        return () if self.eyes is None else self.eyes.details()

    @property
    def device(self) -> torch.device:
        """Where its points should lie."""
        return self.head_from_canonical.device

    def scale(self, index: int) -> Float[Tensor, ""] | float:
        """Length in the part's own frame of a canonical metre: a part's distance over this is in metres."""
        if self.parts[index].name != "head":
            return 1.0
        return torch.linalg.det(self.head_from_canonical[:3, :3]) ** (1 / 3)

    def part_shown(
        self, index: int, points: Float[Tensor, "n 3"], directions: Float[Tensor, "n 3"]
    ) -> Float[Tensor, "n 3"]:
        """Color of one part as its video showed it on average."""
        if self.seen is None:
            return self.part_color(index, points, directions)
        sample, gradient = self.part_gradient(index, points)
        albedo = self._asked(index, points, directions, self.field(index).reference, (sample, gradient))
        return self.seen[index].shown(albedo, self._lit_at(index, points, gradient))

    def part_color(
        self, index: int, points: Float[Tensor, "n 3"], directions: Float[Tensor, "n 3"],
        code: Float[Tensor, "l"] | None = None,
    ) -> Float[Tensor, "n 3"]:  # fmt: skip
        """F_c of one part (albedo, where light is a factor of its own); `code` replaces its reference code and may
        carry a gradient (Eq. 8)."""
        code = self.field(index).reference if code is None else code
        return self._asked(index, points, directions, code, self.part_gradient(index, points))

    def _asked(
        self, index: int, points: Tensor, directions: Tensor, code: Tensor, surface: tuple[FieldSample, Tensor]
    ) -> Tensor:
        """F_c of one part, F_s and its gradient given."""
        field, (sample, gradient) = self.field(index), surface
        local, R = self.local(index, points)
        normals = unit_normals(gradient)
        if R is not None:
            normals, directions = normals @ R.T, directions @ R.T
        with torch.set_grad_enabled(code.requires_grad):
            return field.color(local, sample.feature, normals, directions, code.expand(len(points), -1))

    def local(self, index: int, points: Tensor) -> tuple[Tensor, Tensor | None]:
        """Points in the part's own frame with the mean displacement added, and the rotation into that frame.

        What the part's networks are asked at. None stands for no rotation.
        """
        R = None
        if self.parts[index].name == "head":
            A = self.head_from_canonical[:3, :3]
            points = points @ A.T + self.head_from_canonical[:3, 3]
            R = A / self.scale(index)
        field = self.field(index)
        return points if field.keeps_template else points + field.displacement.mean(field.unit(points)), R

    def part_gradient(self, index: int, points: Tensor) -> tuple[FieldSample, Tensor]:
        """F_s of a part and its gradient turned back into the canonical frame."""
        with torch.no_grad():
            local, R = self.local(index, points)
        sample, gradient = self.field(index).with_gradient(local, create_graph=False)
        distance, gradient = sample.distance.detach() / self.scale(index), gradient.detach()
        gradient = gradient if R is None else gradient @ R
        if self.eyes is not None and self.parts[index].name == "head":
            distance, gradient = self.eyes.gradient(points, distance, gradient)
        return FieldSample(distance, sample.feature.detach()), gradient


def part_weight(points: Float[Tensor, "n 3"], part: Part) -> Float[Tensor, "n"]:
    """Eq. 9's share of a part: d / d_s with d the depth inside its box, 0 outside, 1 from d_s on."""
    assert part.blend_box is not None
    low = torch.as_tensor(part.blend_box.low, dtype=points.dtype, device=points.device)
    high = torch.as_tensor(part.blend_box.high, dtype=points.dtype, device=points.device)
    depth = torch.minimum(points - low, high - points).amin(-1)
    return (depth / part.overlap).clamp(0, 1)


def eq9_shares(points: Float[Tensor, "n 3"], parts: Sequence[Part]) -> Float[Tensor, "n p"]:
    """Eq. 9: weight of each of the parts, the body first, at canonical points; rows sum to 1."""
    weights = [part_weight(points, part) for part in parts[1:]]
    rest = torch.ones(len(points), dtype=points.dtype, device=points.device)
    for weight in weights:
        rest = rest - weight
    return torch.stack([rest, *weights], -1)
