"""Checkpoints: all that a training needs to go on as if it had never stopped."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import torch
from torch import nn

from avatar.errors import AssetError
from avatar.files import whole_file


@dataclass
class Position:
    """How far a training is."""

    iteration: int = 0
    # steps that were not finite
    skipped: int = 0
    # of training, over all sittings
    seconds: float = 0.0


def save_checkpoint(
    path: Path,
    modules: Mapping[str, nn.Module],
    optimiser: torch.optim.Optimizer,
    generator: torch.Generator,
    position: Position,
) -> None:
    """Write weights, optimiser, random state and position, whole or not at all."""
    state = {
        "modules": {name: module.state_dict() for name, module in modules.items()},
        "optimiser": optimiser.state_dict(),
        "generator": generator.get_state(),
        "position": vars(position),
    }
    with whole_file(path) as file:
        torch.save(state, file)


def load_checkpoint(
    path: Path,
    modules: Mapping[str, nn.Module],
    optimiser: torch.optim.Optimizer,
    generator: torch.Generator,
    position: Position,
) -> None:
    """Put a checkpoint back, all in place.

    Raises:
        AssetError: the file is broken, or of another network.
    """
    try:
        state = torch.load(path, map_location="cpu", weights_only=True)
        if set(state["modules"]) != set(modules):
            raise ValueError(f"states of {sorted(state['modules'])}, not of {sorted(modules)}")
        for name, module in modules.items():
            module.load_state_dict(state["modules"][name])
        optimiser.load_state_dict(state["optimiser"])
        generator.set_state(state["generator"])
        position.__init__(**state["position"])
    except Exception as error:  # torch.load raises whatever the broken pickle or zip leads to
        message = (str(error).splitlines() or [type(error).__name__])[0][:200]
        raise AssetError(f"{path}: expected a checkpoint of this training, found: {message}") from None
