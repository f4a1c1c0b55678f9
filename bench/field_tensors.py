"""What a field of torch keeps in memory."""

from typing import Any

import torch


def tensors_of(field: Any) -> list:
    """Every tensor a field holds, wherever it keeps its networks."""
    found: dict[int, torch.Tensor] = {}
    waiting, visited = [field], set()
    while waiting:
        thing = waiting.pop()
        if id(thing) in visited:
            continue
        visited.add(id(thing))
        if isinstance(thing, torch.Tensor):
            found[thing.data_ptr()] = thing
        elif isinstance(thing, torch.nn.Module):
            waiting += [*thing.parameters(), *thing.buffers()]
        elif isinstance(thing, dict):
            waiting += list(thing.values())
        elif isinstance(thing, (list, tuple)):
            waiting += list(thing)
        elif hasattr(thing, "__dict__") and type(thing).__module__.split(".")[0] == "train":
            waiting += list(vars(thing).values())
    return list(found.values())
