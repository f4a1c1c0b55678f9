"""Files of PyTorch's (.pt, .pth) that someone else may have written: weights, checkpoints, prepared rays.

`torch.load` admits tensors and plain values alone (weights_only), and raises a dozen kinds of errors for a file that is
none. It also believes what a file says of sizes: packed members, and views of a small store, may be of any size.
"""

import zipfile
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from files.input_file import open_input, unusable

MAX_BYTES = 1 << 36


def read_weights(path: Path | str, what: str, device: torch.device | str = "cpu") -> Any:
    """What a file of PyTorch's holds: tensors and plain values; `what` names the expected content in messages.

    Raises:
        AssetError: absent, not a regular file, empty, damaged, of anything but data, or with tensors beyond its size.
    """
    with unusable(f"{path}: expected {what}, found"), open_input(path, what, most=MAX_BYTES) as file:
        size = Path(path).stat().st_size
        # torch believes the checksums of an archive, and unpacks what is packed; before 1.6 files were no archives
        archive = zipfile.ZipFile(file) if zipfile.is_zipfile(file) else None
        if archive and (any(member.compress_type for member in archive.infolist()) or archive.testzip()):
            raise ValueError("an archive that is packed or damaged")
        file.seek(0)
        content = torch.load(file, map_location=device, weights_only=True)
        if _bytes(content) > size:
            raise ValueError(f"tensors of {_bytes(content)} bytes in a file of {size}")
    return content


def _bytes(content: Any) -> int:
    """What the tensors of a file take, views spread out."""
    if isinstance(content, Tensor):
        return content.numel() * content.element_size()
    inner = content.values() if isinstance(content, dict) else content if isinstance(content, (list, tuple)) else ()
    return sum(_bytes(value) for value in inner)
