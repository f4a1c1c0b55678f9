"""A face for a baked avatar: shapes, a mouth behind lips that are cut, eyes that turn (avatar/face.py)."""
