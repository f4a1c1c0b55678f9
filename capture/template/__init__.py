"""The template of a capture: its surface, eyes, hull, clothes, layers, and Eq. 14's views."""
