"""Is this capture usable? Each file asks one question of it; `verdict` weighs the answers."""

from capture.check.silhouette import MISALIGNED, misalignment, outline_errors

__all__ = ["MISALIGNED", "misalignment", "outline_errors"]
