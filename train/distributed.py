"""One training on several devices: `torchrun --nproc-per-node N -m selfscan train ...`.

Every rank draws the same batch from the same generator and takes every N-th of its rays. All terms of Eq. 10
are means over rays, so the batch's gradient is the mean of the ranks' gradients, weighted by their shares:

    grad = sum_r n_r / n grad_r        n_r rays of rank r, n of the batch

One process computes the same sum in another order. All ranks receive the same bits, hence take the same step and
stay equal without ever exchanging weights.
"""

import os
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeVar

import torch
import torch.distributed
from jaxtyping import Float, Shaped
from torch import Tensor, nn

from command.errors import AssetError

T = TypeVar("T")


@dataclass(frozen=True)
class Ranks:
    """Which of how many processes this one is."""

    rank: int = 0
    count: int = 1

    @property
    def writes(self) -> bool:
        """Only one rank writes files and prints."""
        return self.rank == 0

    def share(self, batch: Shaped[Tensor, "b"]) -> Shaped[Tensor, "n"]:
        return batch[self.rank :: self.count]

    def weight(self, size: int) -> float:
        """n_r / n for a batch of `size` rays."""
        return len(range(self.rank, size, self.count)) / size

    def combine(
        self, parameters: Sequence[nn.Parameter], weight: float, loss: Float[Tensor, ""], stop: bool
    ) -> tuple[Float[Tensor, ""], bool]:
        """Replace every gradient by the weighted sum over the ranks (one that no rank has stays None).

        Returns:
            the batch's loss, and whether any rank wants to stop: all stop after the same step or none does.
        """
        loss = loss.detach()
        if self.count == 1:
            return loss, stop
        missing = [p.grad is None for p in parameters]
        flat = [p.new_zeros(p.numel()) if p.grad is None else weight * p.grad.reshape(-1) for p in parameters]
        flat += [1.0 - torch.tensor(missing).to(flat[0]), (weight * loss).view(1), loss.new_full((1,), float(stop))]
        summed = torch.cat(flat)
        torch.distributed.all_reduce(summed)
        *pieces, has, loss, stops = summed.split([len(piece) for piece in flat])
        for p, piece, count in zip(parameters, pieces, has.tolist()):
            p.grad = piece.view_as(p) if count else None
        return loss[0], bool(stops.item())

    def mean(self, numbers: Sequence[float], weight: float, device: torch.device) -> list[float]:
        """Numbers of a step, averaged over the ranks."""
        if self.count == 1:
            return list(numbers)
        summed = weight * torch.tensor(numbers, dtype=torch.float64, device=device)
        torch.distributed.all_reduce(summed)
        return summed.tolist()

    def broadcast(self, thing: T) -> T:
        if self.count == 1:
            return thing
        holder = [thing]
        torch.distributed.broadcast_object_list(holder, src=0)
        return holder[0]


ONE_PROCESS = Ranks()


def join_ranks(device: str) -> tuple[Ranks, str]:
    """Which rank torchrun's environment makes this process, and this rank's device; one process without torchrun.

    Raises:
        AssetError: more ranks on this machine than it has CUDA devices.
    """
    count = int(os.environ.get("WORLD_SIZE", "1"))
    if "RANK" not in os.environ or count == 1:
        return ONE_PROCESS, device
    rank, local = int(os.environ["RANK"]), int(os.environ.get("LOCAL_RANK", "0"))
    if device == "cuda":
        if local >= torch.cuda.device_count():
            raise AssetError(
                f"--device cuda: this machine has {torch.cuda.device_count()} CUDA devices, "
                f"torchrun started rank {local} on it; --nproc-per-node should not exceed the devices"
            )
        device = f"cuda:{local}"
        torch.cuda.set_device(local)
    if not torch.distributed.is_initialized():
        torch.distributed.init_process_group("nccl" if device.startswith("cuda") else "gloo")
    return Ranks(rank, count), device


def leave_ranks() -> None:
    """End the exchange, if there is one."""
    if torch.distributed.is_available() and torch.distributed.is_initialized():
        torch.distributed.destroy_process_group()
