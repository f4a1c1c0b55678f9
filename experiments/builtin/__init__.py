"""The built-in subject: the free body, dressed and painted by our own code. Everything about it is CC0."""

from experiments.builtin.person import builtin_subject

__all__ = ["builtin_subject"]
