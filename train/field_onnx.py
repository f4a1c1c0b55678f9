"""RUN/fields.onnx: the fused field of a run as one graph of standard operators, to be drawn without torch.

    points (n, 3), directions (n, 3)  ->  distance (n), normal (n, 3), color (n, 3)

Canonical frame, metres, unit directions from the camera to the point, sRGB in [0, 1], float32. As FusedField
(train/fused.py), part by part, each evaluated only at the points where its weight (Eq. 9) is not 0; the gradient that
F_c (Eq. 2) and the normal need is taken by central differences, since a graph has no autograd. Where the direction is
zero only the distance is worked out: normal and colour stay zero. bench/onnx_field.py reads the file. Only the
tri-plane networks of the `demo` preset are known here.
"""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch

from avatar.files import whole_file
from train.eye_grid import OpenEyes
from train.field import PartField
from train.fused import FusedField
from train.networks.triplane import TriPlaneColor, TriPlaneGeometry
from train.parts import Part

# the first with look-ups on a volume
OPSET = 20
# Half the distance between the two samples of a difference. Smaller, float32's rounding of the distances shows
# (a few nanometres / STEP); larger, more differences reach across a kink of the planes, 2 mm apart on hands.
STEP = 2e-5


def is_exportable(field: Any) -> bool:
    """Whether this is a fused field of tri-plane networks, the only ones known here; its light no factor of its own."""
    return isinstance(field, FusedField) and not field.switch and field.seen is None and all(
        isinstance(part, PartField)
        and isinstance(part.geometry, TriPlaneGeometry)
        and isinstance(part.color_network, TriPlaneColor)
        for part in field.fields
    )  # fmt: skip


def write_field(path: Path, field: FusedField) -> None:
    """Write the graph, whole or not at all; the same field gives the same bytes.

    Raises:
        ValueError: the field's networks are not known here.
    """
    if not is_exportable(field):
        raise ValueError("only a fused field of tri-plane networks (preset demo) can be exported")
    data = FieldGraph().of(field)
    with whole_file(path, listed=True) as file:
        file.write(data)


class FieldGraph:
    """Builds the graph: each method adds operators and returns the name of their result."""

    def __init__(self):
        self.nodes: list[Any] = []
        self.constants: dict[str, np.ndarray] = {}

    def of(self, field: FusedField) -> bytes:
        """The whole model, serialised."""
        import onnx
        from onnx import TensorProto, helper, numpy_helper

        shares = self.shares(field.parts)
        totals = {
            "distance": self.like("points", 1),
            "normal": self.like("points", 3),
            "color": self.like("points", 3),
        }
        looking = self("ReduceSumSquare", "directions", self.constant([1], np.int64), keepdims=0)
        looking = self("Greater", looking, self.constant(0.0))
        for index, share in enumerate(shares):
            weighs = self("Greater", share, self.constant(0.0))
            rows, own = self.chosen(weighs, share)
            distance = self("Mul", own, self.distance(field, index, self("GatherND", "points", rows)))
            totals["distance"] = self.added(totals["distance"], rows, distance)

            rows, own = self.chosen(self("And", weighs, looking), share)
            own = self("Unsqueeze", own, self.constant([1], np.int64))
            asked = self("GatherND", "points", rows), self("GatherND", "directions", rows)
            gradient, color = self.appearance(field, index, *asked)
            totals["normal"] = self.added(totals["normal"], rows, self("Mul", own, gradient))
            totals["color"] = self.added(totals["color"], rows, self("Mul", own, color))
        totals["normal"] = self.unit_normals(totals["normal"])
        for name, total in totals.items():
            self.nodes.append(helper.make_node("Identity", [total], [name]))

        def value(name: str, *shape: Any) -> Any:
            return helper.make_tensor_value_info(name, TensorProto.FLOAT, shape)

        graph = helper.make_graph(
            self.nodes,
            "fused_field",
            [value("points", "n", 3), value("directions", "n", 3)],
            [value("distance", "n"), value("normal", "n", 3), value("color", "n", 3)],
            [numpy_helper.from_array(values, name) for name, values in self.constants.items()],
        )
        opset = [helper.make_opsetid("", OPSET)]
        model = helper.make_model(graph, opset_imports=opset, ir_version=9, producer_name="selfscan")
        onnx.checker.check_model(model)
        return model.SerializeToString(deterministic=True)

    # -- the field, in the order of train/fused.py

    def shares(self, parts: Sequence[Part]) -> list[str]:
        """Eq. 9: weight of each part, the body first."""
        rest, weights = self.like("points", 1, 1.0), []
        for part in parts[1:]:
            assert part.blend_box is not None
            inner = self("Sub", "points", self.constant(part.blend_box.low))
            outer = self("Sub", self.constant(part.blend_box.high), "points")
            depth = self("ReduceMin", self("Min", inner, outer), self.constant([1], np.int64), keepdims=0)
            weights.append(
                self(
                    "Clip",
                    self("Div", depth, self.constant(part.overlap)),
                    self.constant(0.0),
                    self.constant(1.0),
                )
            )
            rest = self("Sub", rest, weights[-1])
        return [rest, *weights]

    def local(self, fused: FusedField, index: int, points: str) -> tuple[str, np.ndarray | None, float]:
        """Points in the part's own frame with the mean displacement added, rotation into that frame, its scale."""
        field, scale, turn = fused.field(index), 1.0, None
        if fused.parts[index].name == "head":
            transform = array(fused.head_from_canonical)
            scale = float(np.cbrt(np.linalg.det(transform[:3, :3].astype(np.float64))))
            turn = transform[:3, :3] / np.float32(scale)
            points = self("MatMul", points, self.constant(transform[:3, :3].T))
            points = self("Add", points, self.constant(transform[:3, 3]))
        mean_grid = array(field.displacement.mean_grid)
        return self("Add", points, self.volume(mean_grid, self.unit(field, points))), turn, scale

    def distance(self, fused: FusedField, index: int, points: str) -> str:
        """Signed distance of one part at its own points, canonical metres."""
        own, _, scale = self.local(fused, index, points)
        distance = self("Div", self.geometry(fused.field(index), own)[0], self.constant(scale))
        if fused.eyes is not None and fused.parts[index].name == "head":
            share, eyes = self.share_and_eyes(fused.eyes, points)
            distance = self("Add", distance, self("Mul", share, self("Sub", eyes, distance)))
        return distance

    def appearance(self, fused: FusedField, index: int, points: str, directions: str) -> tuple[str, str]:
        """The canonical gradient of one part's distance and its colour, at its own points."""
        field = fused.field(index)
        own, turn, scale = self.local(fused, index, points)
        (gradient,) = self.gradients(lambda around: self.geometry(field, around)[:1], own)
        if turn is not None:
            gradient = self("MatMul", gradient, self.constant(turn))
        if fused.eyes is not None and fused.parts[index].name == "head":
            distance = self("Div", self.geometry(field, own)[0], self.constant(scale))
            gradient = self.eyes_gradient(fused.eyes, points, distance, gradient)
        normals = self.unit_normals(gradient)
        if turn is not None:
            directions, normals = (self("MatMul", x, self.constant(turn.T)) for x in (directions, normals))
        _, feature = self.geometry(field, own)
        return gradient, self.color(field, self.unit(field, own), feature, normals, directions)

    def eyes_gradient(self, eyes: OpenEyes, points: str, distance: str, gradient: str) -> str:
        """The canonical gradient with the open eyes blended in, as OpenEyes.gradient."""
        share, values = self.share_and_eyes(eyes, points)
        rise, own = self.gradients(lambda around: self.share_and_eyes(eyes, around), points)
        column = lambda x: self("Unsqueeze", x, self.constant([1], np.int64))
        turned = self("Mul", column(share), self("Sub", own, gradient))
        risen = self("Mul", column(self("Sub", values, distance)), rise)
        return self("Add", gradient, self("Add", turned, risen))

    def unit(self, field: PartField, points: str) -> str:
        """The part's box scaled to [-1, 1]."""
        low, high = array(field.low), array(field.high)
        scaled = self("Mul", self("Sub", points, self.constant(low)), self.constant(2 / (high - low)))
        return self("Sub", scaled, self.constant(1.0))

    def geometry(self, field: PartField, points: str) -> tuple[str, str]:
        """F_s, Eq. 1: distance and feature."""
        network, unit = field.geometry, self.unit(field, points)
        assert isinstance(network, TriPlaneGeometry)
        hidden = self("Concat", self.planes(network.planes.planes, unit), self.encoded(unit, 4), axis=-1)
        for layer in (network.trunk[0], network.trunk[2]):
            scaled = self("Mul", self.linear(layer, hidden), self.constant(100.0))
            hidden = self("Mul", self("Softplus", scaled), self.constant(0.01))
        correction = self("Tanh", self.linear(network.correction, hidden))
        correction = self("Mul", self.flat(correction), self.constant(network.reach))
        template = self.grid(array(field.template.values), array(field.template.low), field.template.cell, points)
        return self("Add", template, correction), self.linear(network.feature, hidden)

    def share_and_eyes(self, eyes: OpenEyes, points: str) -> tuple[str, str]:
        """The share of the open eyes' distance, 0 outside of their box, and that distance."""
        last = np.asarray(eyes.values.shape, np.float32) - 1
        unit = self("Mul", self("Sub", points, self.constant(array(eyes.low))), self.constant(2 / (eyes.cell * last)))
        unit = self("Sub", unit, self.constant(1.0))
        both = self.volume(np.stack([array(eyes.share), array(eyes.values)]), unit)
        share, values = self("Split", both, results=2, axis=1, num_outputs=2)
        return self.flat(share), self.flat(values)

    def grid(self, values: np.ndarray, low: np.ndarray, cell: float, points: str) -> str:
        """Trilinear distance inside a box, outside it the border's plus the way there."""
        last = np.asarray(values.shape, np.float32) - 1
        unit = self("Mul", self("Sub", points, self.constant(low)), self.constant(2 / (cell * last)))
        unit = self("Sub", unit, self.constant(1.0))
        inside = self("Clip", unit, self.constant(-1.0), self.constant(1.0))
        beyond = self("Mul", self("Sub", unit, inside), self.constant(0.5 * cell * last))
        away = self("ReduceSumSquare", beyond, self.constant([1], np.int64), keepdims=0)
        away = self("Sub", self("Sqrt", self("Add", away, self.constant(1e-10))), self.constant(1e-5))
        return self("Add", self.flat(self.volume(values[None], inside)), away)

    def gradients(self, functions: Callable[[str], Sequence[str]], points: str) -> list[str]:
        """Gradients of functions of points by central differences, in the frame of the points."""
        steps = STEP * np.concatenate([np.eye(3), -np.eye(3)]).reshape(1, 6, 3)
        around = self("Add", self("Unsqueeze", points, self.constant([1], np.int64)), self.constant(steps))
        found = []
        for value in functions(self("Reshape", around, self.constant([-1, 3], np.int64))):
            ahead, behind = self("Split", self.shaped(value, -1, 6), results=2, axis=1, num_outputs=2)
            found.append(self("Div", self("Sub", ahead, behind), self.constant(2 * STEP)))
        return found

    def color(self, field: PartField, unit: str, feature: str, normals: str, directions: str) -> str:
        """F_c, Eq. 2, with the part's reference code."""
        network = field.color_network
        assert isinstance(network, TriPlaneColor)
        code = array(field.reference)
        codes = self("Add", self.like(unit, len(code), rows_of=True), self.constant(code))
        parts = [self.encoded(unit, 6), feature, normals, self.encoded(directions, 1), codes]
        hidden = self("Concat", *parts, self.planes(network.planes.planes, unit), axis=-1)
        for layer in (network.network[0], network.network[2]):
            hidden = self("Relu", self.linear(layer, hidden))
        return self("Sigmoid", self.linear(network.network[4], hidden))

    # -- pieces

    def chosen(self, mask: str, values: str) -> tuple[str, str]:
        """Where a mask is true, as indices (k, 1), and the values there."""
        rows = self("Transpose", self("NonZero", mask))
        return rows, self("GatherND", values, rows)

    def added(self, total: str, rows: str, values: str) -> str:
        return self("ScatterND", total, rows, values, reduction="add")

    def encoded(self, x: str, frequencies: int) -> str:
        """Positional encoding: x, sin(2^k pi x), cos(2^k pi x)."""
        scales = (np.pi * 2.0 ** np.arange(frequencies)).reshape(1, -1, 1)
        angles = self("Mul", self("Unsqueeze", x, self.constant([1], np.int64)), self.constant(scales))
        angles = self.shaped(angles, -1, 3 * frequencies)
        return self("Concat", x, self("Sin", angles), self("Cos", angles), axis=-1)

    def planes(self, planes: torch.Tensor, unit: str) -> str:
        """Bilinear look-ups on the planes xy, xz and yz, side by side."""
        values = array(planes)
        pairs = self("Gather", unit, self.constant([[0, 1], [0, 2], [1, 2]], np.int64), axis=1)  # (n, 3, 2)
        at = self("Unsqueeze", self("Transpose", pairs, perm=[1, 0, 2]), self.constant([2], np.int64))
        found = self("GridSample", self.constant(values), at, align_corners=1, padding_mode="border")
        # (3, c, n, 1) -> (n, 3, c, 1)
        found = self("Transpose", found, perm=[2, 0, 1, 3])
        return self.shaped(found, -1, 3 * values.shape[1])

    def volume(self, values: np.ndarray, unit: str) -> str:
        """Trilinear look-up of (c, x, y, z) values at points of the unit box, the border repeated: (n, c)."""
        turned = self("Gather", unit, self.constant([2, 1, 0], np.int64), axis=1)  # the last axis counts first
        at = self("Unsqueeze", turned, self.constant([0, 2, 3], np.int64))
        found = self("GridSample", self.constant(values[None]), at, align_corners=1, padding_mode="border")
        return self("Transpose", self.shaped(found, len(values), -1))

    def linear(self, layer: Any, x: str) -> str:
        weight, bias = self.constant(array(layer.weight)), self.constant(array(layer.bias))
        return self("Gemm", x, weight, bias, transB=1)

    def unit_normals(self, gradient: str) -> str:
        """train.field.unit_normals."""
        square = self("ReduceSumSquare", gradient, self.constant([1], np.int64), keepdims=1)
        return self("Div", gradient, self("Sqrt", self("Add", square, self.constant(1e-12))))

    def like(self, x: str, width: int, value: float = 0.0, *, rows_of: bool = False) -> str:
        """`value` for each row of x: (n,), or (n, width) for a width above 1 or with rows_of."""
        first = self("Shape", x, start=0, end=1)
        wide = width > 1 or rows_of
        shape = self("Concat", first, self.constant([width], np.int64), axis=0) if wide else first
        return self("Expand", self.constant(value), shape)

    def flat(self, x: str) -> str:
        return self("Reshape", x, self.constant([-1], np.int64))

    def shaped(self, x: str, *shape: int) -> str:
        return self("Reshape", x, self.constant(shape, np.int64))

    def constant(self, values: Any, dtype: Any = np.float32) -> str:
        """The name of an initialiser of these values, shared by all that ask for the same."""
        values = np.ascontiguousarray(values, dtype)
        values = values if np.ndim(values) or values.size != 1 else values.reshape(())
        for name, known in self.constants.items():
            if known.dtype == values.dtype and known.shape == values.shape and np.array_equal(known, values):
                return name
        name = f"c{len(self.constants)}"
        self.constants[name] = values
        return name

    def __call__(self, operator: str, *inputs: str, results: int = 1, **attributes: Any) -> Any:
        from onnx import helper

        names = [f"v{len(self.nodes)}_{i}" for i in range(results)]
        self.nodes.append(helper.make_node(operator, list(inputs), names, **attributes))
        return names[0] if results == 1 else names


def array(tensor: Any) -> np.ndarray:
    return tensor.detach().cpu().numpy().astype(np.float32)
