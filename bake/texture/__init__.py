"""The atlas solved against the videos, and the field's own."""
