"""The trained field without torch: RUN/fields.onnx (bake/field_onnx.py) asked through ONNX Runtime."""

from pathlib import Path

import numpy as np
import onnxruntime
from jaxtyping import Float

from avatar.errors import AssetError

INPUTS = {"points": ["n", 3], "directions": ["n", 3]}
OUTPUTS = {"distance": ["n"], "normal": ["n", 3], "color": ["n", 3]}
PIECE = 1 << 15  # points at once, so that memory stays bounded


class OnnxField:
    """The fused field of a run, canonical frame, metres; as train.fused.FusedField, in NumPy.

    Raises:
        AssetError: the file is absent or not such a field.
    """

    def __init__(self, path: Path | str, *, threads: int = 1):
        self.path = Path(path)
        if not self.path.is_file():
            raise AssetError(f"{path}: no such file; `selfscan bake` writes it into the run folder")
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = threads
        options.log_severity_level = 4  # what it has to say is in the exception
        try:
            self.session = onnxruntime.InferenceSession(
                self.path.read_bytes(), options, providers=["CPUExecutionProvider"]
            )
        except Exception as error:  # ONNX Runtime's exceptions have no common base
            found = str(error).splitlines()[0][:200]
            raise AssetError(f"{path}: expected the field of a run (ONNX), found: {found}") from None
        for what, asked, given in (
            ("inputs", INPUTS, self.session.get_inputs()),
            ("outputs", OUTPUTS, self.session.get_outputs()),
        ):
            found = {value.name: value.shape for value in given}
            if found != asked:
                raise AssetError(f"{path}: {what} should be {asked}, are {found}")

    def distance(self, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n"]:
        """Signed distance, metres, negative inside."""
        return self.ask("distance", points, np.zeros_like(points))  # no direction: no more than the distance

    def normal(self, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
        """Unit gradient of the distance."""
        return self.ask("normal", points, np.tile([0.0, 0.0, 1.0], (len(points), 1)))

    def color(
        self, points: Float[np.ndarray, "n 3"], directions: Float[np.ndarray, "n 3"]
    ) -> Float[np.ndarray, "n 3"]:
        """sRGB in [0, 1] of points seen along unit directions, from the camera to the point."""
        return self.ask("color", points, directions)

    def ask(
        self, output: str, points: Float[np.ndarray, "n 3"], directions: Float[np.ndarray, "n 3"]
    ) -> np.ndarray:
        pieces = []
        for start in range(0, max(len(points), 1), PIECE):
            asked = {
                name: np.ascontiguousarray(values[start : start + PIECE], np.float32)
                for name, values in (("points", points), ("directions", directions))
            }
            pieces.append(self.session.run([output], asked)[0])
        return np.concatenate(pieces).astype(np.float64)
