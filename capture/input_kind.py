"""What a reconstruction was given: numbers of different kinds never stand in one row."""

from typing import Any

from avatar.errors import AssetError

# given: template registered to the true mesh, its joints, exact poses and cameras; shape only: a free body's shape
# coefficients, estimated joints, no hair label; from pixels: raw videos and a detector's keypoints
INPUTS = ("given", "shape only", "from pixels")


def input_kind(facts: dict[str, Any], place: str = "capture.json") -> str:
    """The kind of a capture, by its capture.json; synthetic captures that say nothing are *given*.

    Raises:
        AssetError: another kind is named.
    """
    kind = str(facts.get("input", "from pixels" if "source" in facts else "given")).replace("_", " ")
    if kind not in INPUTS:
        raise AssetError(f"{place}: input should be one of {', '.join(INPUTS)}, is {facts['input']!r}")
    return kind
