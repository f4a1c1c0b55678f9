"""Videos as filmed: reading them, judging them, choosing frames, telling the person from the room behind."""
