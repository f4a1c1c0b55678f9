"""Real captures: the authors' released folders and a user's own videos, written as capture folders (FRAMES)."""
