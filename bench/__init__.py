"""The commands that judge: eval, inspect and bench."""
