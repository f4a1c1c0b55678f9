"""The 52 joints of a rigged humanoid that is filmed: all of them, or a refusal that names what is missing."""

from pathlib import Path

from avatar.errors import AssetError
from avatar.gltf.humanoid import find_naming
from avatar.skeleton import JOINTS


def find_joints(path: Path, gltf: dict) -> tuple[list[int], str]:
    """The node index of each of JOINTS, and the naming found ("VRM 1.0", "Mixamo", "SMPL+H").

    Raises:
        AssetError: no naming fits, or one fits and lacks joints; the message lists them.
    """
    naming = find_naming(path, gltf)
    missing = [f"{joint} ({naming.names[joint]})" for joint in JOINTS if joint not in naming.nodes]
    if len(missing) > len(JOINTS) // 2:
        raise AssetError(
            f"{path}: nodes: expected a humanoid rig with Mixamo, VRM or SMPL+H joint names, "
            f"found {len(JOINTS) - len(missing)} of {len(JOINTS)} joints"
        )
    if missing:
        raise AssetError(
            f"{path}: nodes: expected all {len(JOINTS)} joints of a {naming.name} rig with five fingers a hand, "
            f"missing {', '.join(missing)}"
        )
    found = [naming.nodes[joint] for joint in JOINTS]
    if len(set(found)) != len(found):
        raise AssetError(f"{path}: humanoid: expected {len(JOINTS)} different nodes, found {len(set(found))}")
    return found, naming.name
